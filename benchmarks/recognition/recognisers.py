"""Landmark recognition by landfix, the plain method of the thesis, and SIFT + FLANN.

Recognised: named, in place. Wrong: misnamed, or out of place. Silent: gets the next pair.
"""

import itertools
import time
from collections.abc import Callable
from typing import Final, Literal, NamedTuple, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmarks.recognition.views import Reference, Sample
from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array, LandmarkFix
from models.prior import Prior
from vision.describe.correspond import Match, correspond
from vision.describe.measure import Measured, measure
from vision.describe.survey import Settings, grey, segment_regions
from vision.identify import sightings
from vision.identify.catalogue import Sighting, catalogue
from vision.identify.likelihood import similarities
from vision.image.rectify import Image, rectification, rectify
from vision.pipeline import LandmarkPipeline, PipelineConfig, Result

Verdict: TypeAlias = Literal["recognised", "wrong", "silent"]
Points: TypeAlias = NDArray[np.float32]

OFF_M: Final = 3.0  # a position this far off is wrong, unless its own 99.99 % ellipsoid holds the truth
_INSIDE_9999: Final = 21.108  # chi-square of 3
_NEXT_NS: Final = 500_000_000
_NEAR_M: Final = 50.0  # of the prior: landmarks of the database that is compared with
_RATIO, _RANSAC_PX, _INLIERS = 0.75, 3.0, 10
METHODS: Final = ("landfix", "thesis", "SIFT+FLANN", "SIFT+FLANN, ground")
_ROOF_PX: Final = 3  # around a roof within which its key points lie


class Answer(msgspec.Struct, frozen=True):
    """cpu_ms: for the first pair; pair: from 1."""

    verdict: Verdict
    cpu_ms: float | None
    error_m: float | None = None
    note: str = ""
    pair: int = 1


Method: TypeAlias = Callable[[Sample, bool], Answer]  # of a pair; timed or not


def until_heard(method: Method, sample: Sample, timed: bool, pairs: int) -> Answer:
    """A method's first answer that is not silent, else its last."""
    answer = method(sample, timed)
    cpu_ms = answer.cpu_ms
    while answer.verdict == "silent" and answer.pair < pairs:
        sample = sample.next
        answer = msgspec.structs.replace(method(sample, False), cpu_ms=cpu_ms, pair=answer.pair + 1)
    return answer


def landfix(sample: Sample, config: PipelineConfig | None = None, timed: bool = True, pairs: int = 2) -> Answer:
    """Our pipeline, with memory of the pair 0.5 s before."""
    pipeline, again = (LandmarkPipeline(sample.scene.rig_calibrated, sample.scene.map, config) for _ in range(2))
    stamps = itertools.count(0, _NEXT_NS)

    def method(seen: Sample, timed: bool) -> Answer:
        if timed:
            again.process(seen.left, seen.right, 0, seen.prior)  # tables of colours, as in a flight's first image
        begin = time.process_time()
        result = pipeline.process(seen.left, seen.right, next(stamps), seen.prior)
        return judged(result, seen, 1e3 * (time.process_time() - begin) if timed else None)

    return until_heard(method, sample, timed, pairs)


def judged(result: Result, sample: Sample, cpu_ms: float | None) -> Answer:
    """By the present truth."""
    if result.fix is None:
        return Answer("silent", cpu_ms, None, f"{result.report.outcome}: {result.report.detail}")
    p_n, covariance = fused(sample.prior, result.fix)
    error = sample.p_n - p_n
    off_m, squared = float(np.linalg.norm(error)), float(error @ np.linalg.solve(covariance, error))
    there = {m.id for m in sample.scene.world.landmarks}
    if not there.issuperset(result.fix.landmarks):
        return Answer("wrong", cpu_ms, off_m, "named a landmark that is gone")
    if off_m > OFF_M and squared > _INSIDE_9999:
        return Answer("wrong", cpu_ms, off_m, f"{off_m:.1f} m off, squared distance {squared:.0f}")
    if sample.target not in result.fix.landmarks:
        return Answer("silent", cpu_ms, off_m, "named others only")
    return Answer("recognised", cpu_ms, off_m, f"squared distance {squared:.1f}")


def fused(prior: Prior, fix: LandmarkFix) -> tuple[Array, Array]:
    """p_n = p_0 + (K d)_p, K = P (P + R)^-1, d = fix (-) prior, and covariance (3, 3)."""
    R = fix.covariance + (0.0 if fix.covariance_common is None else fix.covariance_common)
    turn = so3.quat_log(so3.multiply(np.array(fix.q_nb_wxyz), so3.conjugate(np.ascontiguousarray(prior.q_nb_wxyz))))
    K = np.linalg.solve(prior.covariance + R, prior.covariance).T
    joint = (np.eye(6) - K) @ prior.covariance
    return prior.p_n + (K @ np.concatenate((np.array(fix.p_n) - prior.p_n, turn)))[:3], joint[:3, :3]


def thesis(sample: Sample, timed: bool = True) -> Answer:
    """The thesis' chapter 5: best similarity (eq. 5.5) >= 75 %."""
    near = sample.scene.map.near(float(sample.prior.p_n[0]), float(sample.prior.p_n[1]), _NEAR_M)
    if all(m.id != sample.target for m in near):  # a view askew reaches farther
        near += [m for m in sample.scene.map if m.id == sample.target]
    if timed:
        _measured(sample, near)  # tables of colours
    begin = time.process_time()
    known = catalogue(near)
    seen = _measured(sample, near)
    like = similarities(seen, known, np.ones((len(seen), len(near))))
    asked = known.ids.index(sample.target)
    best = int(like[:, asked].argmax()) if len(seen) else -1
    cpu_ms = 1e3 * (time.process_time() - begin) if timed else None
    if best < 0 or like[best, asked] < 0.75 or like[best].argmax() != asked:
        return Answer("silent", cpu_ms, None, f"{len(seen)} regions, none of them like it")
    off_m = float(np.linalg.norm(known.position_n[asked] - seen[best].arm_n - sample.p_n))
    return Answer("recognised" if off_m <= OFF_M else "wrong", cpu_ms, off_m, f"{like[best, asked]:.0%} similar")


def _measured(sample: Sample, near: list[Landmark]) -> list[Sighting]:
    made = rectification(sample.scene.rig_calibrated)
    left, right = rectify(sample.left, made.left), rectify(grey(sample.right), made.right)
    colours = tuple(sorted({m.colour_bgr for m in near if m.colour_bgr is not None}))
    regions = segment_regions(left, made.left.valid if made.left else None, Settings(colours))
    matches = correspond(grey(left), right, regions, made.rig)
    found = [measure(m, made.rig, level=sightings.level(sample.prior, made.rig)) for m in matches if isinstance(m, Match)]
    several = [sightings.from_stereo(m, sample.prior, made.rig) for m in found if isinstance(m, Measured)]
    return [s for s in several if s is not None]


class Looked(NamedTuple):
    """SIFT keypoints (N, 2) px, descriptors (N, 128), time."""

    points: Points
    descriptors: Points
    cpu_ms: float


def sift_points(image: Image) -> Looked:
    """All key points of an image."""
    begin = time.process_time()
    points, descriptors = _sift().detectAndCompute(grey(image), np.array([]))
    cpu_ms = 1e3 * (time.process_time() - begin)
    positions = np.array([p.pt for p in points], np.float32).reshape(-1, 2)
    return Looked(positions, np.asarray(descriptors if points else (), np.float32).reshape(-1, 128), cpu_ms)


def sift_and_flann(sample: Sample, looked: Looked, surroundings: bool) -> Answer:
    """SIFT of the left image against the landmark's reference (roof alone, or with surroundings): ratio 0.75, RANSAC homography
    at 3 px, >= 10 inliers.
    """
    if sample.reference is None:
        return Answer("silent", None, None, "no image of the landmark")
    reference = _key_points(sample.reference, surroundings)
    begin = time.process_time()
    H = homography(reference, looked)
    cpu_ms = looked.cpu_ms + 1e3 * (time.process_time() - begin)
    if H is None:
        return Answer("silent", cpu_ms, None, f"{len(reference.points)} key points in the reference, too few agree")
    off_m = _off_m(sample, H)
    return Answer("recognised" if off_m <= OFF_M else "wrong", cpu_ms, off_m)


def homography(reference: Looked, looked: Looked) -> Array | None:
    """Reference -> image (3, 3); None: fewer than ten keypoints agree."""
    if len(reference.points) < 2 or len(looked.points) < 2:
        return None
    matcher = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 5}, {"checks": 50})
    pairs = matcher.knnMatch(reference.descriptors, looked.descriptors, k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < _RATIO * p[1].distance]
    if len(good) < _INLIERS:
        return None
    source, target = reference.points[[m.queryIdx for m in good]], looked.points[[m.trainIdx for m in good]]
    H, inliers = cv2.findHomography(source, target, cv2.RANSAC, _RANSAC_PX)
    return None if not np.size(H) or int(inliers.sum()) < _INLIERS else np.asarray(H, np.float64)


def _sift() -> cv2.SIFT:
    return cv2.SIFT.create()


def _key_points(reference: Reference, surroundings: bool) -> Looked:
    looked = sift_points(reference.image)
    if surroundings:
        return looked
    roof = cv2.dilate(reference.mask, np.ones((2 * _ROOF_PX + 1, 2 * _ROOF_PX + 1), np.uint8)) > 0
    u, v = looked.points.round().astype(int).T
    return Looked(looked.points[roof[v, u]], looked.descriptors[roof[v, u]], looked.cpu_ms)


def _off_m(sample: Sample, H: Array) -> float:
    assert sample.reference is not None
    x = H @ np.append(sample.reference.centre_px, 1.0)
    mark = next(m for m in sample.scene.world.landmarks if m.id == sample.target)
    camera, (p_nc, R_nc) = sample.scene.rig.left, sample.scene.rig.camera_pose(sample.p_n, sample.R_nb)
    x_c = (np.array([(*mark.centre_n, d) for d in (mark.roof_d, mark.base_d)]) - p_nc) @ R_nc
    off_px = np.hypot(*(camera.project(x_c) - x[:2] / x[2]).T)
    return float((off_px * x_c[:, 2]).min()) / camera.fx


def ask(sample: Sample, looked: Looked, timed: bool, pairs: int) -> dict[str, Answer]:
    """Answers by METHODS' names."""
    key_points = {sample.numbers: looked}

    def sift(surroundings: bool) -> Answer:
        def method(seen: Sample, _timed: bool) -> Answer:
            if seen.numbers not in key_points:
                key_points[seen.numbers] = sift_points(seen.left)
            return sift_and_flann(seen, key_points[seen.numbers], surroundings)

        return until_heard(method, sample, timed, 1 if sample.reference is None else pairs)

    answers = landfix(sample, None, timed, pairs), until_heard(thesis, sample, timed, pairs), sift(False), sift(True)
    return dict(zip(METHODS, answers, strict=True))
