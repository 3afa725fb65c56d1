"""One image, one map of footprints, one prior: the pipeline's answer beside where the footprints are."""

import functools
import math
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.aerial.trials import Case, Spread, Trial, nadir_rig, run
from benchmarks.flights.tasks import data_folder
from benchmarks.houses.tiles import FOCAL_PX, Tile, elsewhere, shifted, tiles
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from models.radius import horizontal_radius
from vision.image.rectify import Image
from vision.pose.pose import combine
from vision.show.overlay import draw_overlay

OUT = Path(__file__).resolve().parents[2] / "out" / "houses"
DECOYS = ("turned", "mirrored", "moved", "another town")
ALL_OFF, THIRD_OFF = IN_ERROR = ("all shifted", "a third shifted")  # the first map says so (common_sigma_m), the second does not
OFF_M = 3.0  # of maps in error
SPREAD = Spread(15.0, 2.0, math.radians(1.0), math.radians(3.0))
SIZES = (3, 10)  # footprints of a map; and all
_MARGIN = 0.1  # of the image: the middle of the set's first footprint is not nearer to the border


class Answer(msgspec.Struct, frozen=True):
    """What became of a trial. kind: of the map. off_m: how far the footprints are put from where they are; error_m: horizontal
    error of fix and prior; squared: its square over the covariance; radius_m: what is claimed (95 %); naive_m: as off_m, of
    naive().
    """

    group: str
    tile: str
    kind: str
    size: int
    outcome: str
    detail: str
    cpu_s: float
    off_m: float | None = None
    error_m: float | None = None
    squared: float | None = None
    radius_m: float | None = None
    naive_m: float | None = None

    @property
    def accepted(self) -> bool:
        """Whether there is a fix."""
        return self.outcome == "fixed"


Job = tuple[str, str, str, int, int, bool]  # group, name, kind of the map, footprints, number, whether an overlay is drawn


def answer(job: Job) -> Answer:
    """One trial."""
    cv2.setNumThreads(1)
    group, name, kind, size, k, drawn = job
    every = every_tile()
    tile = next(t for t in every if (t.group, t.name) == (group, name))
    rng = np.random.default_rng([k, zlib.crc32(f"{group} {name} {size}".encode())])
    open_m = math.hypot(0.5 * SPREAD.radius_m, SPREAD.level_sigma_rad * FOCAL_PX * tile.step_m)  # the tilt moves the ground too
    marks = elsewhere(tile, kind, [t for t in every if t.group != group], rng, open_m) if kind in DECOYS else tile.marks
    marks = _some(tile, marks, size, rng)
    rig, prior = nadir_rig(tile.camera), SPREAD.draw(rng, tile.p_n, np.eye(3))
    mapped = shifted(marks, rng, OFF_M, together=kind == ALL_OFF) if kind in IN_ERROR else marks
    landmarks = tile.landmarks(mapped, OFF_M if kind == ALL_OFF else 0.0)
    case = Case(group, name, tile.image, rig, landmarks, tile.p_n, np.eye(3), (), lambda *_: math.nan)
    outcome, result = run(Trial(case, k, prior), "predict")
    base = Answer(group, name, kind, len(marks), outcome.outcome, outcome.detail, outcome.cpu_s)
    if kind not in DECOYS:
        base = msgspec.structs.replace(base, naive_m=_off(tile, marks, naive(tile.image, rig, mapped, prior), prior.R_nb))
    if drawn:
        pose = (prior.p_n, prior.R_nb) if result.pose is None else (result.pose.joint_p_n, result.pose.joint_R_nb)
        image = draw_overlay(tile.image, rig.left, *rig.camera_pose(*pose), list(case.landmarks), (), (), [outcome.outcome])
        cv2.imwrite(str(OUT / f"{outcome.outcome} {group} {name} {kind} {size} {k}.png".replace(" ", "_")), image)
    if result.pose is None or result.fix is None:
        return base
    common = result.fix.covariance_common  # with the map's, which no image shows
    assert common is not None
    fit, directions = result.pose, (result.fix.directions, result.fix.readings)
    p_n, R_nb, covariance = combine(prior, fit.p_n, fit.R_nb, fit.covariance + common, *directions)
    e, P = (p_n - tile.p_n)[:2], covariance[:2, :2]
    return msgspec.structs.replace(
        base, off_m=_off(tile, marks, p_n, R_nb), error_m=float(np.linalg.norm(e)), squared=float(e @ np.linalg.solve(P, e)),
        radius_m=float(horizontal_radius(P[None])[0]),
    )  # fmt: skip


def naive(image: Image, rig: StereoRig, marks: Sequence[Landmark], prior: Prior) -> Array:
    """p_n where the outlines, drawn from the prior, correlate best with the image's Sobel magnitude, within 3 sigma: no check."""
    camera, R_nc = rig.left, rig.camera_pose(prior.p_n, prior.R_nb)[1]
    scale = float(np.median([mark.base_d for mark in marks]) - prior.p_n[2]) / camera.fx
    reach = math.ceil(3.0 * math.sqrt(float(prior.covariance[0, 0])) / scale)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    slope = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    lines = np.zeros(grey.shape, np.uint8)
    for mark in marks:
        roof = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        px = camera.project((roof - prior.p_n) @ R_nc)
        cv2.polylines(lines, [np.rint(px).astype(np.int32)], isClosed=True, color=255, thickness=2)
    padded = cv2.copyMakeBorder(slope, reach, reach, reach, reach, cv2.BORDER_REFLECT)
    match = np.nan_to_num(cv2.matchTemplate(padded, lines.astype(np.float32), cv2.TM_CCOEFF_NORMED))
    v, u = np.unravel_index(int(np.argmax(match)), match.shape)
    step = scale * np.array([u - reach, v - reach, 0.0]) @ R_nc.T
    found: Array = prior.p_n - np.array([step[0], step[1], 0.0])
    return found


def _some(tile: Tile, marks: tuple[Landmark, ...], size: int, rng: np.random.Generator) -> tuple[Landmark, ...]:
    """One footprint well in the image and its nearest neighbours; all of them for size 0."""
    if not size:
        return marks
    middle = np.array([m.centre_n for m in marks])
    half_m = (0.5 - _MARGIN) * tile.step_m * np.array(tile.image.shape[:2])
    inside = np.flatnonzero((np.abs(middle) < half_m).all(axis=1))
    first = middle[rng.choice(inside if len(inside) else np.arange(len(marks)))]
    return tuple(marks[i] for i in np.argsort(np.linalg.norm(middle - first, axis=1))[:size])


def _off(tile: Tile, marks: tuple[Landmark, ...], p_n: Array, R_nb: Array) -> float:
    """Mean distance [m] of the footprints' middles in the image from where the file has them."""
    middle = np.array([(*m.centre_n, m.roof_d) for m in marks])
    rig = nadir_rig(tile.camera)
    px = [rig.left.project((middle - p) @ R) for p, R in (rig.camera_pose(p_n, R_nb), rig.camera_pose(tile.p_n, np.eye(3)))]
    return float(tile.step_m * np.linalg.norm(px[0] - px[1], axis=1).mean())


@functools.cache
def every_tile() -> list[Tile]:
    """All images, read once."""
    return list(tiles(data_folder()))


def jobs(every: list[Tile], seed: int, priors: int, decoys: int, *, drawn: bool, in_error: bool = False) -> Iterator[Job]:
    """Every image with every number of footprints that it has; in_error: maps in error as well."""
    for tile in every:
        for size in (*(s for s in SIZES if s < len(tile.marks)), 0):
            for kind in ("true", *(IN_ERROR if in_error else ())):
                for k in range(priors):
                    yield (tile.group, tile.name, kind, size, 1000 * seed + k, drawn)
            for kind in DECOYS:
                for k in range(decoys):
                    yield (tile.group, tile.name, kind, size, 1000 * seed + k, False)
