"""Which recogniser processes an image, by need and by cost.

    landmarks by description   always, where the map has any: pipeline.py
    registration               where they gave nothing, the map holds an image, and the prior limits the search: registration.py
    features                   where the prior is too wide for that, or registration found no certain position: features.py
    peak                       where neither succeeded: position by the peak of registration's search, peak.py

All of them end in a LandmarkFix; the image counts as one landmark, named as its file, with the errors of its georeference.
The result depends on the requests since the run began and on nothing else: a replay takes the same decisions.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import Array, VisionReport
from vision.ground.features import FeatureConfig, FeatureMap, NotRecognised, recognise
from vision.ground.image import GroundImage
from vision.ground.peak import PeakConfig, fit_peak
from vision.ground.registration import NotRegistered, Peak, Registered, RegistrationConfig, register
from vision.identify.identify import Prior
from vision.identify.sightings import one_eyed
from vision.image.check import image_flaw
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose.pose import PoseEstimate
from vision.records.reports import Result, fix_of, pose_flaw

_SAME_99 = 11.345  # chi-square of 3, 99 %
_NEW_VIEW = 0.25  # of what an image shows, by its length: by so much another one must have moved on to confirm it


class RecogniserConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of each recogniser, and how long a likely position waits to be confirmed."""

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

    @classmethod
    def of(cls, image: GroundImage, config: FeatureConfig | None = None) -> "MapImage":
        """Takes about a second for each million pixels."""
        return cls(image, FeatureMap.of(image, config))


@dataclass(frozen=True, slots=True)
class _Likely:
    """What one image said of the prior's error: offset_n (3,), its covariance, and the prior's variance then.

    shown_n (2,): the middle of what it shows; length_m: of that, at most.
    """

    t_ns: int
    offset_n: Array
    covariance: Array
    prior: Array
    shown_n: Array
    length_m: float

    def shows_the_same(self, other: "_Likely") -> bool:
        """Whether too little of what it shows is new: a false match on the ground would be there again."""
        return bool(np.linalg.norm(self.shown_n - other.shown_n) < _NEW_VIEW * self.length_m)


class Recognisers:
    """Images of one rig over one map. Raises ValueError for a rig whose images cannot be rectified."""

    def __init__(
        self, rig: StereoRig, landmarks: LandmarkMap, known: MapImage | None = None, config: RecogniserConfig | None = None
    ) -> None:
        self._rig, self._known, self._config = rig, known, config or RecogniserConfig()
        self._pipeline = LandmarkPipeline(rig, landmarks, self._config.pipeline)
        self._has_landmarks = len(landmarks) > 0
        self._likely: _Likely | None = None

    def process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        """One pair, or one image (None: there is no other), taken at t_ns where prior says. Never raises."""
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
        """The image's turn, with the left camera or, where that gave nothing, with the right one."""
        use_right = left is None or image_flaw(left, self._rig.left) is not None
        image, rig = (right if use_right else left), one_eyed(self._rig, right=use_right)
        assert image is not None  # the pipeline found one of them good
        found = register(rig, image, prior, known.image, self._config.registration)
        laid = self._laid(known, found, t_ns, prior)
        if laid.fix is not None or laid.report.outcome == "no_ground":
            return laid
        other = self._by_features(known, rig, image, t_ns, prior)
        if other.fix is not None:
            self._likely = None
            return other
        laid = replace(laid, report=msgspec.structs.replace(laid.report, detail=f"{laid.report.detail}; {other.report.detail}"))
        return laid if found.peak is None else self._by_peak(known, rig, found.peak, prior, laid)

    def _by_peak(self, known: MapImage, rig: StereoRig, peak: Peak, prior: Prior, laid: Result) -> Result:
        """What the search alone says, where it is clear; else what became of the blocks."""
        report = laid.report
        found = fit_peak(rig, prior, known.image, peak, self._config.peak)
        flaw = found if isinstance(found, str) else pose_flaw(found, prior)
        if flaw or isinstance(found, str):
            return replace(laid, report=msgspec.structs.replace(report, detail=f"{report.detail}; {flaw}"))
        evidence = (
            f"{known.image.name}: position by the peak of the search alone, {peak.ratio:.2f} times the second, "
            f"correlation {peak.correlation:.2f}; {report.detail}"
        )
        return _fixed(report.t_ns, known.image.name, found, (1, 1), evidence, peak.correlation)

    def _laid(self, known: MapImage, found: Registered | NotRegistered, t_ns: int, prior: Prior) -> Result:
        """What registration found, judged."""
        if isinstance(found, NotRegistered):
            return _refused(t_ns, found.reason, f"{known.image.name}: {found.detail}")
        evidence = (
            f"{known.image.name}: {found.agreed} of {found.tried} blocks agree, peak {found.ratio:.2f} times the second, "
            f"correlation {found.correlation:.2f}"
        )
        if flaw := pose_flaw(found.pose, prior):
            return _refused(t_ns, "no_pose", f"{evidence}; {flaw}", (found.tried, found.agreed))
        if not (found.is_sure(self._config.registration) or self._is_confirmed(found, t_ns, prior)):
            return _refused(t_ns, "ambiguous", evidence, (found.tried, found.agreed))
        self._likely = None
        return _fixed(t_ns, known.image.name, found.pose, (found.tried, found.agreed), evidence)

    def _is_confirmed(self, found: Registered, t_ns: int, prior: Prior) -> bool:
        """Whether an earlier image of another view said the same of the prior's error; if not, this one waits for the next.

        An image of the same view confirms nothing, and the earlier one waits on.
        """
        if not found.is_likely(self._config.registration):
            return False
        pose, variance = found.pose, np.diag(prior.covariance)[:3]
        length_m = found.peak.q * self._config.registration.coarse
        now = _Likely(
            t_ns, pose.joint_p_n - prior.p_n, pose.joint_covariance[:3, :3], variance, found.peak.shown_n, length_m
        )  # fmt: skip
        before = self._likely
        if before is not None and not 0 < t_ns - before.t_ns <= self._config.memory_s * 1e9:
            before = None
        if before is not None and now.shows_the_same(before):
            return False
        self._likely = now
        if before is None:
            return False
        apart = now.offset_n - before.offset_n
        drift = np.diag(np.maximum(now.prior - before.prior, 0.0))
        return bool(apart @ np.linalg.solve(now.covariance + before.covariance + drift, apart) < _SAME_99)

    def _by_features(self, known: MapImage, rig: StereoRig, image: Image, t_ns: int, prior: Prior) -> Result:
        found = recognise(rig, image, prior, known.features, self._config.features)
        if isinstance(found, NotRecognised):
            return _refused(t_ns, found.reason, f"{known.image.name}: {found.detail}")
        evidence, counts = (
            f"{known.image.name}: {found.inliers} of {found.matched} features agree",
            (found.matched, found.inliers),
        )
        if flaw := pose_flaw(found.pose, prior):
            return _refused(t_ns, "no_pose", f"{evidence}; {flaw}", counts)
        return _fixed(t_ns, known.image.name, found.pose, counts, evidence)


def _both(described: Result, seen: Result) -> Result:
    """One report of both: the outcome is the image's, what became of the regions is kept."""
    detail = f"landmarks: {described.report.outcome} {described.report.detail}".strip() + f"; image: {seen.report.detail}"
    return replace(seen, report=msgspec.structs.replace(seen.report, detail=detail), regions=described.regions)


def _refused(t_ns: int, outcome: str, detail: str, counts: tuple[int, int] = (0, 0)) -> Result:
    return Result(None, VisionReport(t_ns, t_ns, outcome, detail, *counts))


def _fixed(
    t_ns: int, name: str, pose: PoseEstimate, counts: tuple[int, int], detail: str, similarity: float | None = None
) -> Result:
    share = counts[1] / counts[0] if similarity is None else similarity
    report = VisionReport(t_ns, t_ns, "fixed", detail, *counts, (name,), (share,), pose.residual_px)
    return Result(fix_of(pose, t_ns, (name,), share), report, pose=pose)
