"""Which recogniser processes an image, by need and by cost (table in docs/vision_orthophoto.md).

The image is one landmark, named as its file. Results depend on the requests alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import Array, VisionReport
from models.prior import Prior
from vision.ground.features import FeatureConfig, FeatureMap, NotRecognised, Recognised, recognise
from vision.ground.image import GroundImage
from vision.ground.learned import Learned, recognise_learned
from vision.ground.peak import PeakConfig, edges_agree, fit_peak, fit_ridge
from vision.ground.registration import Registered, register
from vision.ground.search import NotRegistered, Peak, RegistrationConfig
from vision.identify.sightings import one_eyed
from vision.image.check import image_flaw
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose.pose import PoseEstimate
from vision.records.reports import Result, fix_of, pose_flaw

_SAME_99 = 11.345  # chi-square of 3, 99 %
_LIKELY_VIEWS, _PEAK_VIEWS = 2, 3  # that agree: a clear peak is wrong in one oblique image of fifty or so
_NEW_VIEW = 0.25  # of what an image shows, by its length: by so much another one must have moved on to confirm it


class RecogniserConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of each recogniser."""

    pipeline: PipelineConfig = PipelineConfig()
    registration: RegistrationConfig = RegistrationConfig()
    features: FeatureConfig = FeatureConfig()
    peak: PeakConfig = PeakConfig()
    memory_s: Annotated[
        float, Meta(ge=0, description="s: how long a likely position waits for another view that says the same")
    ] = 10.0


@dataclass(frozen=True, slots=True)
class MapImage:
    """A georeferenced image and its keypoints, found once."""

    image: GroundImage
    features: FeatureMap
    learned: Learned | None = None

    @classmethod
    def of(cls, image: GroundImage, config: FeatureConfig | None = None) -> "MapImage":
        """Takes about a second for each million pixels."""
        return cls(image, FeatureMap.of(image, config))


@dataclass(frozen=True, slots=True)
class _Likely:
    """One image's error of the prior: offset_n (3,), covariance, prior's variance.

    shown_n: middles (2,) of agreeing views.
    """

    t_ns: int
    offset_n: Array
    covariance: Array
    prior: Array
    shown_n: tuple[Array, ...]
    length_m: float

    def shows_the_same(self, other: "_Likely") -> bool:
        """Whether too little of the view is new: a false match would recur."""
        apart = [np.linalg.norm(self.shown_n[0] - shown) for shown in other.shown_n]
        return bool(min(apart) < _NEW_VIEW * self.length_m)

    def agrees(self, before: "_Likely") -> bool:
        apart = self.offset_n - before.offset_n
        drift = np.diag(np.maximum(self.prior - before.prior, 0.0))
        return bool(apart @ np.linalg.solve(self.covariance + before.covariance + drift, apart) < _SAME_99)


class Recognisers:
    """Images of one rig over one map. Raises ValueError."""

    def __init__(
        self, rig: StereoRig, landmarks: LandmarkMap, known: MapImage | None = None, config: RecogniserConfig | None = None
    ) -> None:
        self._rig, self._known, self._config = rig, known, config or RecogniserConfig()
        self._pipeline = LandmarkPipeline(rig, landmarks, self._config.pipeline)
        self._has_landmarks = len(landmarks) > 0
        self._likely: _Likely | None = None

    def process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        """A pair, or one image, of t_ns near the prior. Never raises."""
        right = None if self._rig.one_camera else right
        described = self._pipeline.process(left, right, t_ns, prior)
        if self._known is None or described.fix is not None or described.report.outcome in {"no_prior", "no_image", "internal"}:
            return described
        try:
            with np.errstate(all="ignore"):
                seen = self._look(self._known, left, right, t_ns, prior)
        except Exception as error:  # whatever an image trips over, the flight goes on
            seen = _refused(t_ns, "internal", f"{type(error).__name__}: {error}")
        return _both(described, seen) if self._has_landmarks else seen

    def _look(self, known: MapImage, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        use_right = left is None or image_flaw(left, self._rig.left) is not None
        image, rig = (right if use_right else left), one_eyed(self._rig, right=use_right)
        assert image is not None  # the pipeline found one of them good
        found = register(rig, image, prior, known.image, self._config.registration)
        laid = self._laid(known, found, t_ns, prior)
        if laid.fix is not None or laid.report.outcome == "no_ground":
            return laid
        peak = self._by_peak(known, rig, found, prior, laid)
        if peak.fix is not None:
            return peak
        for other in self._by_points(known, rig, image, prior, found.peak, t_ns):
            if other.fix is not None:
                self._likely = None
                return other
            peak = replace(peak, report=_with_detail(peak.report, other.report.detail))
        last = peak if peak.pose is None else self._agreed(known, found, peak, prior)
        return last if last.fix is not None else self._across(known, rig, found, last, prior)

    def _by_peak(self, known: MapImage, rig: StereoRig, found: Registered | NotRegistered, prior: Prior, laid: Result) -> Result:
        peak, config = found.peak, self._config.peak
        if peak is None:
            return laid
        pose = fit_peak(rig, prior, known.image, peak, config)
        flaw = pose if isinstance(pose, str) else pose_flaw(pose, prior)
        if flaw or isinstance(pose, str):
            return replace(laid, report=_with_detail(laid.report, str(flaw)))
        evidence = (
            f"{known.image.name}: position by the peak of the search alone, {peak.ratio:.2f} times the second, "
            f"correlation {peak.correlation:.2f}, of the edges' directions {peak.oriented:.2f}; {laid.report.detail}"
        )
        fixed = _fixed(laid.report.t_ns, known.image.name, pose, (1, 1), evidence, peak.correlation)
        likely = isinstance(found, Registered) and found.is_likely(self._config.registration)
        blocks = likely and laid.report.outcome == "ambiguous"
        if edges_agree(peak, config) or blocks:
            self._likely = None
            return fixed
        return replace(fixed, fix=None, report=msgspec.structs.replace(fixed.report, outcome="waiting", candidates=0))

    def _across(self, known: MapImage, rig: StereoRig, found: Registered | NotRegistered, last: Result, prior: Prior) -> Result:
        peak, config = found.peak, self._config.peak
        pose = "" if peak is None else fit_ridge(rig, prior, known.image, peak, config)
        if isinstance(pose, str) or pose_flaw(pose, prior):
            return last
        assert peak is not None
        assert peak.ridge is not None
        evidence = (
            f"{known.image.name}: position across a line alone, {peak.ridge.ratio:.2f} times the best beside it, "
            f"correlation {peak.correlation:.2f}; {last.report.detail}"
        )
        return _fixed(last.report.t_ns, known.image.name, pose, (1, 1), evidence, peak.correlation)

    def _agreed(self, known: MapImage, found: Registered | NotRegistered, weak: Result, prior: Prior) -> Result:
        assert weak.pose is not None
        assert found.peak is not None
        if self._is_confirmed(weak.pose, found.peak, weak.report.t_ns, prior, _PEAK_VIEWS):
            self._likely = None
            detail = f"{weak.report.detail}; other views agree"
            return _fixed(weak.report.t_ns, known.image.name, weak.pose, (1, 1), detail, found.peak.correlation)
        return replace(weak, pose=None, report=_with_detail(weak.report, "images of other views must agree"))

    def _laid(self, known: MapImage, found: Registered | NotRegistered, t_ns: int, prior: Prior) -> Result:
        if isinstance(found, NotRegistered):
            return _refused(t_ns, found.reason, f"{known.image.name}: {found.detail}")
        evidence = (
            f"{known.image.name}: {found.agreed} of {found.tried} blocks agree, peak {found.ratio:.2f} times the second, "
            f"correlation {found.correlation:.2f}"
        )
        if flaw := pose_flaw(found.pose, prior):
            return _refused(t_ns, "no_pose", f"{evidence}; {flaw}", (found.tried, found.agreed))
        config = self._config.registration
        likely = found.is_likely(config) and self._is_confirmed(found.pose, found.peak, t_ns, prior, _LIKELY_VIEWS)
        if not (found.is_sure(config) or likely):
            return _refused(t_ns, "ambiguous", evidence, (found.tried, found.agreed))
        self._likely = None
        return _fixed(t_ns, known.image.name, found.pose, (found.tried, found.agreed), evidence)

    def _is_confirmed(self, pose: PoseEstimate, peak: Peak, t_ns: int, prior: Prior, views: int) -> bool:
        """Whether `views` views show the same prior error; a repeated view confirms nothing."""
        variance, length_m = np.diag(prior.covariance)[:3], peak.q * self._config.registration.coarse
        now = _Likely(t_ns, pose.joint_p_n - prior.p_n, pose.joint_covariance[:3, :3], variance, (peak.shown_n,), length_m)
        before = self._likely
        if before is not None and not 0 < t_ns - before.t_ns <= self._config.memory_s * 1e9:
            before = None
        if before is not None and now.shows_the_same(before):
            return False
        if before is not None and now.agrees(before):
            now = replace(now, shown_n=(*now.shown_n, *before.shown_n))
        self._likely = now
        return len(now.shown_n) >= views

    def _by_points(
        self, known: MapImage, rig: StereoRig, image: Image, prior: Prior, peak: Peak | None, t_ns: int
    ) -> Iterator[Result]:
        yield _pointed(known.image.name, recognise(rig, image, prior, known.features, self._config.features), "", t_ns, prior)
        if known.learned is not None:
            for near in ([] if peak is None else [(peak.p_n, peak.R_nb)]) + [None]:
                found = recognise_learned(known.learned, rig, image, prior, known.image, near)
                yield _pointed(known.image.name, found, "learned ", t_ns, prior)


def _pointed(name: str, found: Recognised | NotRecognised, kind: str, t_ns: int, prior: Prior) -> Result:
    if isinstance(found, NotRecognised):
        return _refused(t_ns, found.reason, f"{name}: {kind}{found.detail}")
    evidence, counts = f"{name}: {found.inliers} of {found.matched} {kind}features agree", (found.matched, found.inliers)
    if flaw := pose_flaw(found.pose, prior):
        return _refused(t_ns, "no_pose", f"{evidence}; {flaw}", counts)
    return _fixed(t_ns, name, found.pose, counts, evidence)


def _both(described: Result, seen: Result) -> Result:
    detail = f"landmarks: {described.report.outcome} {described.report.detail}".strip() + f"; image: {seen.report.detail}"
    return replace(seen, report=msgspec.structs.replace(seen.report, detail=detail), regions=described.regions)


def _with_detail(report: VisionReport, detail: str) -> VisionReport:
    added: VisionReport = msgspec.structs.replace(report, detail=f"{report.detail}; {detail}")
    return added


def _refused(t_ns: int, outcome: str, detail: str, counts: tuple[int, int] = (0, 0)) -> Result:
    return Result(None, VisionReport(t_ns, t_ns, outcome, detail, *counts))


def _fixed(
    t_ns: int, name: str, pose: PoseEstimate, counts: tuple[int, int], detail: str, similarity: float | None = None
) -> Result:
    share = counts[1] / counts[0] if similarity is None else similarity
    report = VisionReport(t_ns, t_ns, "fixed", detail, *counts, (name,), (share,), pose.residual_px)
    return Result(fix_of(pose, t_ns, (name,), share), report, pose=pose)
