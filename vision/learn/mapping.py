"""Landmarks learned from a flight: a roof seen repeatedly, with its covariance.

    z_i = l + n_i + F_i s,   n_i ~ N(0, R_i) anew in each image,   s ~ N(0, I) the same in all of them
    l    = C (Lambda_0 l_0 + sum S_i^-1 z_i),   C = (Lambda_0 + sum S_i^-1)^-1,   S_i = R_i + n d_i d_i^T
    cov  = C (Lambda_0 + sum S_i^-1 R_i S_i^-1) C + F F^T,    F = sum C S_i^-1 F_i

F_i: pose, mounting, lens, depth (column d_i); l_0: some metres above ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import gammaincinv

from models import so3
from models.camera import StereoRig
from models.maps import outline as polygon
from models.messages import Array
from models.prior import Prior
from vision.describe.measure import Measured
from vision.describe.regions import Region

_BLIND_M = 1e3  # along a ray whose length is not measured
_SHALLOW = 0.25  # sine of a ray against the ground, below which a region is seen too flat
_VAGUE = 0.3  # relative error of a distance that is none any more
_NOT = 1e6  # cost of what is excluded


class MappingConfig(msgspec.Struct, frozen=True):
    """roof_m: prior roof height; centre_px, side_px: sigma of a region; fresh_share: of the pose variance, new per image;
    drift_m: along a flight; uneven: varying part of the rig's disparity error.
    """

    roof_m: float = 4.0
    roof_sigma_m: float = 6.0
    centre_px: float = 0.3
    side_px: float = 0.5
    log_size_floor: float = 0.08
    fresh_share: float = 0.1
    drift_m: float = 0.2
    uneven: float = 0.3
    gate: float = 0.999


@dataclass(frozen=True, slots=True)
class Observation:
    """A region in one image: z (3,) m in n, R (3, 3), F (3, k), depth (3,): rig's depth column.

    rays (K, 3): of the outline, down 1; log_sides, log_sigma (2,): width, length; ray (3, 3): information of the ray without its
    length, 1 / m^2.
    """

    frame: int
    z: Array
    R: Array
    F: Array
    depth: Array
    p_nc: Array
    rays: Array
    log_sides: Array
    log_sigma: Array
    pixel_m: float
    colour_bgr: tuple[float, float, float]
    ray: Array

    def outline_at(self, down: float) -> Array:
        """(K, 2) north, east, anticlockwise from above."""
        points = np.ascontiguousarray((self.p_nc + self.rays * (down - self.p_nc[2]))[:, :2])
        return points if polygon.area(points) > 0.0 else np.ascontiguousarray(points[::-1])


def observe(
    frame: int, region: Region, measured: Measured | None, prior: Prior, rig: StereoRig, ground_d: float, config: MappingConfig
) -> Observation | None:
    """A region from its image's pose (rectified rig); None where too flat."""
    p_nc, R_nc = rig.camera_pose(prior.p_n, prior.R_nb)
    rays = rig.left.ray(region.outline) @ R_nc.T
    down = ground_d - config.roof_m - float(p_nc[2])
    if not np.isfinite(rays).all() or rays[:, 2].min() < _SHALLOW or down < 1.0:
        return None
    rays /= rays[:, 2:]
    x_c, own, shared = _arm(region, measured, rig, down, R_nc[2], config)
    along = R_nc @ x_c
    distance = float(np.linalg.norm(along))
    F_pose = np.hstack((np.eye(3), -so3.skew(p_nc + along - prior.p_n))) @ _root(prior.covariance)
    fresh = (config.centre_px * distance / rig.left.fx) ** 2 * np.eye(3) + config.fresh_share * F_pose @ F_pose.T
    lasting = np.sqrt(1.0 - config.fresh_share) * F_pose
    sides, pixel_m = _sides(rays * down), down / rig.left.fx
    return Observation(
        frame=frame,
        z=p_nc + along,
        R=fresh + own**2 * np.outer(along, along),
        F=np.hstack((lasting, _of_rig(x_c, prior.R_nb, R_nc, rig), shared * along[:, None])),
        depth=shared * along,
        p_nc=p_nc,
        rays=rays,
        log_sides=np.log(sides),
        log_sigma=np.hypot(config.log_size_floor, np.sqrt(2.0) * config.side_px * pixel_m / sides),
        pixel_m=pixel_m,
        colour_bgr=region.colour_bgr,
        ray=np.asarray(np.linalg.inv(fresh + (_BLIND_M / distance) ** 2 * np.outer(along, along))),
    )


def _arm(
    region: Region, measured: Measured | None, rig: StereoRig, down: float, down_c: Array, config: MappingConfig
) -> tuple[Array, float, float]:
    outline = np.ascontiguousarray(region.outline)
    middle = polygon.describe(outline, np.array([0, len(outline)]))[:, [polygon.NORTH, polygon.EAST]]
    ray = rig.left.ray(middle)[0]
    if measured is None or np.hypot(measured.disparity_sigma_px, measured.rig_sigma_px) > _VAGUE * measured.disparity_px:
        distance = down / float(down_c @ ray)
        return distance * ray, _BLIND_M / distance, 0.0
    own = float(np.hypot(measured.disparity_sigma_px, config.uneven * measured.rig_sigma_px)) / measured.disparity_px
    return measured.distance_m * ray, own, measured.rig_sigma_px / measured.disparity_px


def _sides(points: Array) -> Array:
    outline = np.ascontiguousarray(points[:, :2])
    if polygon.area(outline) < 0.0:
        outline = np.ascontiguousarray(outline[::-1])
    described: Array = polygon.describe(outline, np.array([0, len(outline)]))[0]
    return described[[polygon.WIDTH, polygon.LENGTH]]


def _of_rig(x_c: Array, R_nb: Array, R_nc: Array, rig: StereoRig) -> Array:
    """Effect (3, 10) of mounting and left lens errors, of variance 1, on a point of n."""
    moved = np.zeros((3, 10))
    if rig.covariance_bc is not None:
        moved[:, :6] = R_nb @ np.hstack((np.eye(3), -so3.skew(rig.R_bc @ x_c))) @ _root(rig.covariance_bc)
    if rig.left.covariance is not None:
        x, y, depth = x_c[0] / x_c[2], x_c[1] / x_c[2], x_c[2]
        by_lens = -depth / rig.left.fx * np.array([[x, 0.0, 1.0, 0.0], [0.0, y, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
        moved[:, 6:] = R_nc @ by_lens @ _root(rig.left.covariance[:4, :4])
    return moved


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


@dataclass(slots=True)
class Track:
    """One object, and where its rays meet: information (3, 3), vector (3,)."""

    information: Array
    vector: Array
    log_sides: Array
    observations: list[Observation] = field(default_factory=list)

    def add(self, one: Observation) -> None:
        """One more observation of it."""
        self.information = self.information + one.ray
        self.vector = self.vector + one.ray @ one.z
        self.observations.append(one)
        self.log_sides = np.median([k.log_sides for k in self.observations], axis=0)

    @property
    def position(self) -> Array:
        """l (3,)."""
        return np.asarray(np.linalg.solve(self.information, self.vector))


@dataclass(frozen=True, slots=True)
class Position:
    """Position l (3,) with own (3, 3) and common F (3, k) errors; chi2: per degree of freedom."""

    position_n: Array
    own: Array
    F: Array
    chi2: float

    @property
    def covariance(self) -> Array:
        """(3, 3) of the whole error."""
        return self.own + self.F @ self.F.T


class Mapper:
    """Associates the observations of successive images. ground_d: down of the ground."""

    def __init__(self, ground_d: float, config: MappingConfig | None = None) -> None:
        self.config = config or MappingConfig()
        self.tracks: list[Track] = []
        self._roof_d = ground_d - self.config.roof_m
        self._prior = np.diag([0.0, 0.0, self.config.roof_sigma_m**-2])

    def add(self, observations: Sequence[Observation]) -> None:
        """Add one image's observations to known objects, or as new ones."""
        chosen = self._associated(observations)
        for one, k in zip(observations, chosen, strict=True):
            if k < 0:
                self.tracks.append(Track(self._prior.copy(), self._prior @ [0.0, 0.0, self._roof_d], one.log_sides))
            self.tracks[k].add(one)

    def position(self, track: Track) -> Position:
        """Position of an object with covariance."""
        inverses = [np.linalg.inv(one.R + len(track.observations) * np.outer(one.depth, one.depth)) for one in track.observations]
        C = np.linalg.inv(self._prior + np.sum(inverses, axis=0))
        weights = [C @ S_inverse for S_inverse in inverses]
        l_n = C @ self._prior @ [0.0, 0.0, self._roof_d] + sum(
            W @ one.z for W, one in zip(weights, track.observations, strict=True)
        )
        own = C @ self._prior @ C + sum(W @ one.R @ W.T for W, one in zip(weights, track.observations, strict=True))
        residuals = [one.z - l_n for one in track.observations]
        square = sum(float(r @ S_inverse @ r) for r, S_inverse in zip(residuals, inverses, strict=True))
        numbers = sum(3 if one.depth.any() else 2 for one in track.observations)
        chi2 = square / max(numbers - 3, 1)
        F = np.sum([W @ one.F for W, one in zip(weights, track.observations, strict=True)], axis=0)
        return Position(l_n, max(chi2, 1.0) * own, F, chi2)

    def same(self, a: Track, b: Track) -> bool:
        """Whether two tracks may be one object."""
        off, sides = a.position - b.position, a.log_sides - b.log_sides
        if float(np.hypot(off[0], off[1])) > np.exp(max(a.log_sides[0], b.log_sides[0])):  # no part in common
            return False
        S = self.position(a).own + self.position(b).own + self.config.drift_m**2 * np.eye(3)
        sigma = np.minimum(a.observations[0].log_sigma, b.observations[0].log_sigma)
        return float(off @ np.linalg.solve(S, off) + np.sum(sides**2 / (2.0 * sigma**2))) < _quantile(self.config.gate, 5)

    def _associated(self, observations: Sequence[Observation]) -> list[int]:
        if not observations or not self.tracks:
            return [-1] * len(observations)
        gate = _quantile(self.config.gate, 4)
        cost = np.full((len(observations), len(self.tracks) + len(observations)), _NOT)
        cost[:, len(self.tracks) :] = gate
        positions = np.array([track.position for track in self.tracks])
        for i, one in enumerate(observations):
            ray = (one.z - one.p_nc) / (one.z[2] - one.p_nc[2])
            at = one.p_nc + ray * (positions[:, 2:] - one.p_nc[2])
            for j in np.flatnonzero(np.hypot(*(positions - at)[:, :2].T) < np.exp(one.log_sides[1])).tolist():
                cost[i, j] = self._distance(one, self.tracks[j], positions[j])
        rows, columns = linear_sum_assignment(cost)
        chosen = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if j < len(self.tracks) and cost[i, j] < gate}
        self._keep_joint(observations, chosen)
        return [chosen.get(i, -1) for i in range(len(observations))]

    def _distance(self, one: Observation, track: Track, position: Array) -> float:
        S = np.linalg.inv(track.information) + np.linalg.inv(one.ray) + one.F @ one.F.T
        off, sides = one.z - position, one.log_sides - track.log_sides
        return float(off @ np.linalg.solve(S, off) + np.sum(sides**2 / (2.0 * one.log_sigma**2)))

    def _keep_joint(self, observations: Sequence[Observation], chosen: dict[int, int]) -> None:
        while len(chosen) > 1:
            pairs = list(chosen.items())
            off = np.concatenate([observations[i].z - self.tracks[j].position for i, j in pairs])
            F = np.concatenate([observations[i].F for i, _ in pairs])
            V = F @ F.T
            for k, (i, j) in enumerate(pairs):
                rows = slice(3 * k, 3 * k + 3)
                V[rows, rows] += np.linalg.inv(observations[i].ray) + np.linalg.inv(self.tracks[j].information)
            weighted = np.linalg.solve(V, off)
            if float(off @ weighted) < _quantile(self.config.gate, 2 * len(pairs)):
                return
            inverse = np.linalg.inv(V)
            gains = []
            for k in range(len(pairs)):
                rows = slice(3 * k, 3 * k + 3)
                gains.append(float(weighted[rows] @ np.linalg.solve(inverse[rows, rows], weighted[rows])))
            del chosen[pairs[int(np.argmax(gains))][0]]


def _quantile(probability: float, degrees: int) -> float:
    return float(2.0 * gammaincinv(0.5 * degrees, probability))
