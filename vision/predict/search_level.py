"""One reduced image of the coarse search, and its voting points."""

import math
from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.image.reduced import Level
from vision.outline.visibility import Prisms
from vision.pose.pose import Pose
from vision.pose.sensitivity import Eye
from vision.predict.edge_points import chromas, edge_points
from vision.predict.landmark_shifts import motions
from vision.predict.motion import Motion
from vision.predict.rigid_votes import Window, rigid_votes
from vision.predict.votes import aim, vote

Indices = NDArray[np.int64]
_OPEN = 2.0  # standard deviations of a landmark's position and size on the map
_FLOOR = 0.5  # of the median gradient of the image
_NOWHERE = -(1 << 20)  # a pixel that nothing brings into the image


class SearchLevel:
    """A level of `eye`'s image with about `points` voting points within reach_px.

    free, sides (L,): map's openness of position and sides, px of the level; growth_m (K, L): sizes to search, mapped first.
    """

    def __init__(
        self, level: Level, eye: Eye, landmarks: Sequence[Landmark], motion: Motion, expected: float, reach_px: float, points: int
    ) -> None:
        """expected: support per length that speaks neither for nor against a position."""
        self.level, self._motion, self._expected = level, motion, expected
        self._eye = Eye(level.camera, eye.R_kb, eye.p_bk, eye.right)
        pose, body = motion.pose(np.zeros(6)), Prisms.of(landmarks)
        self.edge_points = edge_points(self._eye, body, chromas(landmarks), pose, reach_px / level.size, points)
        depth = body.base_d - body.height_m - self._eye.pose(*pose)[0][2]
        metre_px = level.camera.fx / np.maximum(depth, 1.0)
        map_sigma, outline_sigma = (np.array(s) for s in zip(*((m.sigma_m, m.outline_sigma_m) for m in landmarks), strict=True))
        self.free, self.sides = np.rint(_OPEN * map_sigma * metre_px), np.rint(_OPEN * outline_sigma * metre_px)
        self.growth_m = _growths(_OPEN * outline_sigma, metre_px)
        self._floor = _FLOOR * level.typical() + 0.5

    @property
    def camera(self) -> Array:
        """fx fy cx cy of the level."""
        c = self.level.camera
        return np.array([c.fx, c.fy, c.cx, c.cy])

    def aimed(self, pose: Pose, shift_m: Array | None = None) -> Array:
        """Points (N, 11) for vote(), from a pose, landmarks off the map by shift_m (L, M)."""
        assert self.edge_points is not None
        return self.edge_points.aimed(self._eye, pose, self._motion.gain[:, :2], shift_m)

    def middles(self, pose: Pose) -> Array:
        """The middles (L, 11) of each landmark's points, as aimed."""
        middle_n, gain, c = self._middle_n, self._motion.gain[:, :2], self.level.camera
        return aim(middle_n, np.ones_like(middle_n), pose[0], gain, *self._eye.pose(*pose), c.fx, c.fy)

    @cached_property
    def _middle_n(self) -> Array:
        assert self.edge_points is not None
        return self.edge_points.middles(len(self.free))

    def own_radius(self) -> float:
        """px of the image: of the largest landmark, as Motion.radius of all."""
        assert self.edge_points is not None
        mark, pose = self.edge_points.mark_of_point, self._motion.pose(np.zeros(6))
        r = _seen(self.aimed(pose)) - _seen(self.middles(pose))[mark]
        square = np.bincount(mark, np.sum((r * self.camera[:2]) ** 2, axis=1)) / np.maximum(np.bincount(mark), 1)
        return max(1.3 * math.sqrt(float(np.nanmax(square))), 1.0) * self.level.size

    def vote(self, aimed: Array, su: Array, sv: Array) -> tuple[Array, Array]:
        """Votes and length in view (L, U, V) px of the level at shifts of aimed points."""
        assert self.edge_points is not None
        v, marks = self.edge_points, len(self.free)
        field = self.level.field(aimed, (float(su[0]), float(su[-1])), (float(sv[0]), float(sv[-1])))
        support, length = vote(field, self.camera, aimed, v.first, v.mark, v.length, v.chroma, marks, self._floor, su, sv)
        return support - self._expected * length, length

    def rigid_votes(self, aimed: Array, window: Window) -> Array:
        """Best votes (L, rows, columns) within each landmark's map error, for whole-pixel shifts of a window."""
        assert self.edge_points is not None
        v, c, most = self.edge_points, self.camera, int(self.free.max())
        px = np.where(aimed[:, 2:3] > 0.0, np.rint(_seen(aimed) * c[:2] + c[2:]), _NOWHERE).astype(np.int64)
        wide = (window[0] - most, window[1] + most, window[2] - most, window[3] + most)
        field = self.level.around(np.repeat(px, 2, axis=1) + wide)
        votes = rigid_votes(
            field, px, np.ascontiguousarray(aimed[:, 9:]), v.first, v.mark, v.length, v.chroma, len(self.free), self._floor,
            self._expected, wide,
        )  # fmt: skip
        for one, radius in zip(votes, self.free.astype(int).tolist(), strict=True):
            if radius:
                one[:] = cv2.dilate(one, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
        return np.ascontiguousarray(votes[:, most : votes.shape[1] - most, most : votes.shape[2] - most])

    def motions(self, pose: Pose, shift_m: Array) -> Array:
        """Motion (L, 2, 6) with the pose of landmarks off by shift_m (L, M), px."""
        assert self.edge_points is not None
        v, c, marks = self.edge_points, self.level.camera, len(self.free)
        p_nk, R_nk = self._eye.pose(*pose)
        return np.asarray(motions(v.moved(shift_m), pose[0], p_nk, R_nk, v.mark_of_point, marks, c.fx, c.fy) * self.level.size)

    def across(self, q: Array) -> Array:
        """M (4, 4): outlines at q and q' are (dq^T M dq)^(1/2) px apart across edges, RMS."""
        assert self.edge_points is not None
        aimed, c = self.aimed(self._motion.pose(self._motion.gain @ q)), self.level.camera
        return np.asarray(_across(aimed, self.camera, c.width, c.height, self.level.size, self._motion.middle + q[:2]))


def _seen(aimed: Array) -> Array:
    return np.asarray(aimed[:, :2] / aimed[:, 2:3])


@njit(cache=True)
def _across(aimed: Array, camera: Array, width: int, height: int, size: int, middle: Array) -> Array:
    """Mean of (n^T B)^T (n^T B) (4, 4) over points in view; n: normals, B (2, 4) = similarity(r)."""
    M, row, count = np.zeros((4, 4)), np.empty(4), 0
    for i in range(len(aimed)):
        x, y, z = aimed[i, 0], aimed[i, 1], aimed[i, 2]
        if z <= 0.0:
            continue
        u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            continue
        ru, rv = (u + 0.5) * size - 0.5 - middle[0], (v + 0.5) * size - 0.5 - middle[1]
        row[0], row[1] = aimed[i, 9], aimed[i, 10]
        row[2], row[3] = row[1] * ru - row[0] * rv, row[0] * ru + row[1] * rv
        count += 1
        for j in range(4):
            for k in range(4):
                M[j, k] += row[j] * row[k]
    return M / max(count, 1)


def _growths(open_m: Array, metre_px: Array) -> Array:
    """Growths (K, L) m up to open_m (L,), none first, in steps of a pixel."""
    n = math.ceil(max(float(np.max(open_m * metre_px)) / 2.0 - 0.5, 0.0))
    return np.array(sorted(range(-n, n + 1), key=abs))[:, None] * (open_m / max(n, 1))
