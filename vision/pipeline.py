"""From a pair of pictures to a LandmarkFix, or the reason why there is none: the stages of the thesis' chapter 5 in their order.

    check -> rectify -> segment -> regions -> correspond -> measure -> identify -> pose -> tests of the fix

Nothing in here raises in flight. A picture that is missing or useless leaves the work to the other camera: known landmarks give
the scale, the fix says so, and its covariance shows it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from models import so3
from models.camera import StereoRig
from models.landmarks import Landmark, LandmarkMap
from models.messages import Array, LandmarkFix, Quat, VisionReport, vec3
from vision import epipolar
from vision import sightings as sight
from vision.check import pair_flaw, picture_flaw
from vision.constellation import Constellation, MemoryConfig
from vision.correspond import Match, Unmatched, correspond
from vision.identify import NONE, Identification, IdentifyConfig, Prior, identify
from vision.likelihood import Catalogue, Sighting, catalogue
from vision.measure import Measured, measure
from vision.pose import NoPose, PoseConfig, PoseEstimate, estimate_pose
from vision.rectify import Image, Mask, rectification, rectify
from vision.regions import Limits, Region
from vision.segment import Space
from vision.sensitivity import eyes
from vision.start import centroid_and_size, start_from_regions
from vision.survey import Settings, grey, segment_regions, to_8_bit

_INSIDE_9999: Final = 27.856  # chi-square of 6, 99.99 %
_ROWS_PX: Final = 0.8  # rows that differ by less do no harm
_TOO_FLAT: Final = "seen too flat to know its size"


class PipelineConfig(msgspec.Struct, frozen=True):
    """How pictures become fixes."""

    space: Space = "hsv"
    least_px: int = 60  # of a region
    most_regions: int = 24
    farthest_m: float = 400.0  # of a landmark from the vehicle
    most_landmarks: int = 400  # near the prior; beyond it nothing is identified
    identify: IdentifyConfig = IdentifyConfig()
    pose: PoseConfig = PoseConfig()
    memory: MemoryConfig = MemoryConfig()


class RegionReport(msgspec.Struct, frozen=True):
    """What became of one region.

    state: identified, open, not_in_map, not_measured, cut_off;  landmark: what it is, or its best candidate
    bbox: u0, v0, width, height in the rectified picture
    """

    state: str
    bbox: tuple[int, int, int, int]
    landmark: str = ""
    similarity: float = 0.0
    posterior: float = 0.0
    candidates: int = 0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Result:
    """fix or None, the report of why (not), one line for each region, and the pose fit behind the fix."""

    fix: LandmarkFix | None
    report: VisionReport
    regions: tuple[RegionReport, ...] = ()
    pose: PoseEstimate | None = None


@dataclass(frozen=True, slots=True)
class _Views:
    """The pictures that can be used, rectified (work) and as they came (raw); right: the only good one is the right one."""

    raw: tuple[Image | None, Image | None]
    work: Image
    other: Image | None
    valid: Mask | None
    right: bool
    remark: str


@dataclass(frozen=True, slots=True)
class _Seen:
    """Regions that can be identified with their sightings, and reports of those that cannot."""

    regions: list[Region]
    sightings: list[Sighting]
    refused: list[RegionReport]
    metric: bool
    scale_sigma: float
    remark: str


class LandmarkPipeline:
    """Pictures of one rig over one map. Raises ValueError for a rig whose pictures cannot be rectified."""

    def __init__(self, rig: StereoRig, landmarks: LandmarkMap, config: PipelineConfig | None = None) -> None:
        self._rig, self._map = rig, landmarks
        self._config = config or PipelineConfig()
        self._rectified = rectification(rig)
        self._rows_sigma_px = _rows_sigma(self._rectified.rig)
        self._memory = Constellation(self._config.memory)

    def process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        """One pair, or one picture (None: there is no other), taken at t_ns where prior says. Never raises."""
        try:
            with np.errstate(all="ignore"):
                return self._process(left, right, t_ns, prior)
        except Exception as error:  # whatever a picture trips over, the flight goes on
            return _nothing(t_ns, "internal", f"{type(error).__name__}: {error}")

    def _process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        if flaw := _prior_flaw(prior):
            return _nothing(t_ns, "no_prior", flaw)
        views = self._views(left, right)
        if isinstance(views, str):
            return _nothing(t_ns, "no_picture", views)
        near = self._near(prior)
        if not near:
            return _nothing(t_ns, "no_landmark_near", views.remark)
        if len(near) > self._config.most_landmarks:  # among some of them only, a wrong one may look sure
            return _nothing(t_ns, "prior_too_wide", f"{views.remark}{len(near)} landmarks may be in view")
        known = catalogue(near)
        regions = self._segment(views, near)
        if not regions:
            return _nothing(t_ns, "no_region", views.remark)
        seen = self._measure(views, regions, prior, known)
        if isinstance(seen, str):
            return _nothing(t_ns, "swapped", seen, len(regions))
        return self._decide(views, seen, near, known, t_ns, prior)

    def _views(self, left: Image | None, right: Image | None) -> _Views | str:
        """The usable pictures, or why there is none."""
        flaws = [
            "missing" if image is None else picture_flaw(image, camera)
            for image, camera in ((left, self._rig.left), (right, self._rig.right))
        ]
        if all(flaws):
            return f"left: {flaws[0]}; right: {flaws[1]}"
        if not any(flaws) and left is not None and right is not None and (flaw := pair_flaw(left, right)):
            flaws[1] = flaw
        remark = "".join(f"{name} camera not used: {flaw}; " for name, flaw in zip(("left", "right"), flaws, strict=True) if flaw)
        raw = None if flaws[0] else left, None if flaws[1] else right
        r = self._rectified
        first, second = (
            None if image is None else rectify(to_8_bit(image), m) for image, m in zip(raw, (r.left, r.right), strict=True)
        )
        only_right = first is None
        work = second if first is None else first
        assert work is not None
        maps = r.right if only_right else r.left
        return _Views(raw, work, None if only_right else second, maps.valid if maps else None, only_right, remark)

    def _near(self, prior: Prior) -> list[Landmark]:
        """Landmarks that may be in view: 4 sigma around what the left camera overlooks, nearest first."""
        sigma = 4.0 * float(np.sqrt(np.linalg.eigvalsh(prior.covariance[:2, :2])[-1]))
        p_nc, R_nc = self._rig.camera_pose(prior.p_n, prior.R_nb)
        c = self._rig.left
        corners = np.array([[0.0, 0.0], [c.width - 1.0, 0.0], [0.0, c.height - 1.0], [c.width - 1.0, c.height - 1.0]])
        rays = c.ray(corners) @ R_nc.T
        nearest = self._map.rows_near(p_nc[0], p_nc[1], self._config.farthest_m)[:50]
        floor = float(self._map.columns.base_d[nearest].max(initial=-np.inf))
        if not np.isfinite(floor):
            return []
        height = max(floor - p_nc[2], 1.0) + 4.0 * float(np.sqrt(prior.covariance[2, 2]))
        reach = [height * float(np.hypot(r[0], r[1])) / r[2] if r[2] > 0.1 else np.inf for r in rays]
        radius = min(1.2 * max(reach), self._config.farthest_m) + sigma
        return self._map.near(p_nc[0], p_nc[1], radius)

    def _segment(self, views: _Views, near: list[Landmark]) -> list[Region]:
        colours = tuple(sorted({m.colour_bgr for m in near if m.colour_bgr is not None}))
        limits = Limits(least_px=self._config.least_px, most=self._config.most_regions)
        return segment_regions(views.work, views.valid, Settings(colours, self._config.space, limits=limits))

    def _measure(self, views: _Views, regions: list[Region], prior: Prior, known: Catalogue) -> _Seen | str:
        """What the regions are in metres; a pair that contradicts its calibration counts as one camera, a swapped one as none."""
        whole = [r for r in regions if not r.touches_border]
        refused = [RegionReport("cut_off", r.bbox, reason="cut off by the picture's edge") for r in regions if r.touches_border]
        if views.other is None:
            return self._one_camera(views, whole, prior, known, refused, views.remark)
        rig = self._rectified.rig
        matches = correspond(grey(views.work), grey(views.other), whole, rig)
        if swapped := epipolar.pair_reason(matches, None):
            return swapped
        if rows := self._rows_off(views, matches):
            problem = f"rows differ by {rows:+.1f} px: wrong calibration, or pictures not taken together"
            return self._one_camera(views, whole, prior, known, refused, f"{views.remark}right camera not used: {problem}; ")
        level = sight.level(prior, rig)
        kept, seen, measured = list[Region](), list[Sighting](), list[Measured]()
        for match in matches:
            m = measure(match, rig, level=level) if isinstance(match, Match) else match
            if not isinstance(m, Measured):
                refused.append(_not_measured(m.region, m.reason))
            elif one := sight.from_stereo(m, prior, rig):
                kept.append(m.region)
                seen.append(one)
                measured.append(m)
            else:
                refused.append(_not_measured(m.region, _TOO_FLAT))
        return _Seen(kept, seen, refused, True, sight.shared_scale_sigma(measured), views.remark)

    def _rows_off(self, views: _Views, matches: Sequence[Match | Unmatched]) -> float:
        """By how much the rows of the pair differ beyond what its calibration allows [px], 0 where they fit."""
        found = [m for m in matches if isinstance(m, Match)]
        limit = max(_ROWS_PX, 3.0 * self._rows_sigma_px)
        off = [m.vertical_px for m in found if abs(m.vertical_px) > limit + 3.0 * m.vertical_sigma_px]
        if off and 2 * len(off) >= len(found):
            return float(np.median(off))
        if views.other is not None and 2 * len(found) < len(matches):  # in doubt: looks further, and takes longer
            residual = epipolar.edge_residual(grey(views.work), grey(views.other), self._rectified.rig)
            if residual and abs(residual.vertical_px) > limit + 3.0 * residual.sigma_px:
                return residual.vertical_px
        return 0.0

    def _one_camera(
        self, views: _Views, whole: list[Region], prior: Prior, known: Catalogue, refused: list[RegionReport], remark: str
    ) -> _Seen:
        rig = sight.one_eyed(self._rectified.rig, right=views.right)
        roof_d = float(np.mean(known.place_n[:, 2]))
        kept, seen = list[Region](), list[Sighting]()
        for region in whole:
            one = sight.from_one_camera(region, prior, rig, roof_d)
            if one is None:
                refused.append(_not_measured(region, _TOO_FLAT))
            else:
                kept.append(region)
                seen.append(one)
        return _Seen(kept, seen, refused, False, sight.ONE_CAMERA_SCALE_SIGMA, remark)

    def _decide(self, views: _Views, seen: _Seen, near: list[Landmark], known: Catalogue, t_ns: int, prior: Prior) -> Result:
        """Identify, and where that succeeds fit the pose; regions that stay open are kept for the next picture."""
        rig = sight.one_eyed(self._rectified.rig, right=views.right)
        remembered = self._memory.recall(seen.sightings, t_ns, prior) if seen.metric else []
        every = seen.sightings + remembered
        found = identify(every, known, prior, rig, seen.scale_sigma, self._config.identify, metric=seen.metric)
        now = len(seen.sightings)
        reports = [*(_region(seen.regions[i], found, i, known, self._config.identify) for i in range(now)), *seen.refused]
        chosen = [i for i in range(now) if found.accepted[i]]
        remark = seen.remark
        if not chosen or found.place_posterior < self._config.identify.fix_posterior:
            if seen.metric:
                self._memory.hold(seen.sightings, remembered, t_ns, prior)
            outcome = _unsettled(found, now)
            return Result(None, _report(t_ns, outcome, remark + _summary(found, now, len(remembered)), reports), tuple(reports))
        marks = [near[found.landmark[i]] for i in chosen]
        used = (views.raw[0], views.raw[1] if views.other is not None and seen.metric else None)
        pose = self._pose(used if not views.right else views.raw, [seen.regions[i] for i in chosen], marks, prior, views.right)
        flaw = f"{pose.reason} {pose.detail}".strip() if isinstance(pose, NoPose) else _fix_flaw(pose, prior, found)
        if flaw or isinstance(pose, NoPose):
            return Result(None, _report(t_ns, "no_pose", remark + flaw, reports), tuple(reports))
        self._memory.clear()
        q = so3.from_matrix(np.ascontiguousarray(pose.R_nb))
        fix = LandmarkFix(
            t_ns=t_ns,
            arrived_ns=t_ns,
            p_n=vec3(pose.p_n),
            q_nb_wxyz=_quat(q),
            covariance=pose.covariance,
            covariance_common=pose.covariance_common,
            landmarks=tuple(m.id for m in marks),
            similarity=float(np.mean([_similarity(found, i) for i in chosen])),
            residual_px=pose.residual_px,
            landmark_errors=pose.landmark_errors,
            covariance_rig=pose.covariance_rig,
        )
        report = _report(t_ns, "fixed", remark + _summary(found, now, len(remembered)), reports, pose.residual_px)
        return Result(fix, report, tuple(reports), pose)

    def _pose(
        self,
        raw: tuple[Image | None, Image | None],
        regions: Sequence[Region],
        marks: Sequence[Landmark],
        prior: Prior,
        right: bool,
    ) -> PoseEstimate | NoPose:
        """Start from the regions' places in the rectified picture, then fit the outlines in the pictures as they came."""
        eye = eyes(self._rectified.rig)[int(right)]
        described = [centroid_and_size(np.ascontiguousarray(r.outline)) for r in regions]
        centres, sizes = np.array([c for c, _ in described]), np.array([s for _, s in described])
        p_n, R_nb, shift = start_from_regions(eye, marks, centres, sizes, prior)
        views = [None if image is None else to_8_bit(image) for image in raw]
        return estimate_pose(self._rig, views, marks, (p_n, R_nb), prior, self._config.pose, shift)


def _rows_sigma(rig: StereoRig) -> float:
    """By how much rows may differ for all that the calibration knows [px]: f drx, and both principal points."""
    turn = 0.0 if rig.covariance_rc is None else float(rig.covariance_rc[3, 3]) * rig.left.fy**2
    return float(np.sqrt(turn + sum(float(c.covariance[3, 3]) for c in (rig.left, rig.right) if c.covariance is not None)))


def _nothing(t_ns: int, outcome: str, detail: str, regions: int = 0) -> Result:
    return Result(None, VisionReport(t_ns, t_ns, outcome, detail.removesuffix("; "), regions))


def _prior_flaw(prior: Prior) -> str | None:
    p, q, cov = np.asarray(prior.p_n), np.asarray(prior.q_nb_wxyz), np.asarray(prior.covariance)
    if p.shape != (3,) or q.shape != (4,) or cov.shape != (6, 6):
        return "prior of the wrong shape"
    if not (np.isfinite(p).all() and np.isfinite(q).all() and np.isfinite(cov).all()):
        return "prior is not finite"
    if abs(float(np.linalg.norm(q)) - 1.0) > 1e-3:
        return "prior attitude is not a unit quaternion"
    if not np.allclose(cov, cov.T, rtol=1e-6, atol=1e-9) or float(np.linalg.eigvalsh(cov)[0]) <= 0.0:
        return "prior covariance is not positive definite"
    return None


def _not_measured(region: Region, reason: str) -> RegionReport:
    return RegionReport("not_measured", region.bbox, reason=reason)


def _similarity(found: Identification, i: int) -> float:
    return float(found.own_similarity[i] if found.landmark[i] != NONE else found.similarity[i])


def _region(region: Region, found: Identification, i: int, known: Catalogue, config: IdentifyConfig) -> RegionReport:
    """One line of the why-not."""
    landmark = found.landmark[i] if found.landmark[i] != NONE else found.best[i]
    name = known.ids[landmark] if landmark != NONE else ""
    posterior, candidates = float(found.posterior[i]), int(found.candidates[i])
    if found.accepted[i]:
        state, reason = "identified", ""
    elif candidates == 0:
        state, reason = "not_in_map", f"no landmark near is {config.min_similarity:.0%} similar"
    elif found.landmark[i] == NONE and posterior >= config.accept_posterior:
        state, reason = "not_in_map", "something like it, but not where a landmark is"
    elif found.landmark[i] == NONE:
        state, reason = "open", f"probably not in the map ({posterior:.4f}), {candidates} candidates"
    else:
        state, reason = "open", f"ambiguous: probability {posterior:.4f}, {candidates} candidates"
    return RegionReport(state, region.bbox, name, _similarity(found, i), posterior, candidates, reason)


def _unsettled(found: Identification, now: int) -> str:
    if not found.candidates[:now].any():
        return "no_candidate"
    return "ambiguous" if (found.landmark[:now] != NONE).any() else "not_in_map"


def _summary(found: Identification, now: int, remembered: int) -> str:
    count = int(found.accepted[:now].sum())
    before = f", {remembered} of earlier pictures" if remembered else ""
    return f"{count} of {now} regions identified{before}, place sure to {found.place_posterior:.5f}"


def _report(
    t_ns: int, outcome: str, detail: str, reports: Sequence[RegionReport], residual_px: float = float("nan")
) -> VisionReport:
    candidates = [r for r in reports if r.candidates > 0]
    return VisionReport(
        t_ns, t_ns, outcome, detail.removesuffix("; "), len(reports), len(candidates), tuple(r.landmark for r in candidates),
        tuple(r.similarity for r in candidates), residual_px,
    )  # fmt: skip


def _fix_flaw(pose: PoseEstimate, prior: Prior, found: Identification) -> str:
    """Why a fitted pose is not believed: not a number, not where the prior may be, not where the regions said."""
    total = pose.covariance + pose.covariance_common
    if not (np.isfinite(pose.p_n).all() and np.isfinite(pose.R_nb).all() and np.isfinite(total).all()):
        return "the fit is not finite"
    if float(np.linalg.eigvalsh(total)[0]) <= 0.0:
        return "the fit's covariance is not positive definite"
    distance = _squared_distance(pose.p_n, pose.R_nb, prior.p_n, prior.q_nb_wxyz, prior.covariance + total)
    if distance > _INSIDE_9999:
        return f"the prior excludes it: squared distance {distance:.0f}, 99.99 % are below {_INSIDE_9999:.0f}"
    p_n, q = prior.moved(found.x)
    distance = _squared_distance(pose.joint_p_n, pose.joint_R_nb, p_n, q, found.covariance[:6, :6] + pose.joint_covariance)
    if distance > _INSIDE_9999:
        return f"outlines and regions disagree: squared distance {distance:.0f}, 99.99 % are below {_INSIDE_9999:.0f}"
    return ""


def _squared_distance(p_n: Array, R_nb: Array, of_p_n: Array, of_q: Array, covariance: Array) -> float:
    """Squared Mahalanobis distance of two poses."""
    turn = so3.quat_log(so3.multiply(so3.from_matrix(np.ascontiguousarray(R_nb)), so3.conjugate(np.ascontiguousarray(of_q))))
    e = np.concatenate((p_n - of_p_n, turn))
    return float(e @ np.linalg.solve(covariance, e))


def _quat(q: Array) -> Quat:
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])
