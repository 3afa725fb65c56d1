"""From images to a LandmarkFix, or the reason for none; never raises.

    check -> predict and verify (predict.py)      where the prior is good enough
          -> all outlines as one pattern (pattern.py) where single outlines are too weak
          -> segment and identify (recognise.py)  at boot, where the prior is lost, or where that does not settle

One camera suffices.
"""

from dataclasses import replace
from typing import Final, Literal

import msgspec
import numpy as np

from models.camera import StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.describe.segment import Space
from vision.identify.ambiguity import steps_off
from vision.identify.constellation import MemoryConfig
from vision.identify.identify import IdentifyConfig
from vision.image.rectify import Image, rectification
from vision.pose.map_error import on_map, with_map_error
from vision.pose.pose import PoseConfig
from vision.predict.pattern import judged, refused
from vision.predict.predict import PredictConfig, PredictPath
from vision.recognise import Identified, SegmentConfig, SegmentPath
from vision.records.images import Images, usable
from vision.records.reports import RegionReport, Result, nothing, with_regions

__all__ = ["LandmarkPipeline", "PipelineConfig", "RegionReport", "Result"]

_ENOUGH, _MAJORITY = 4, 2.0 / 3.0  # landmarks, and part of those in view, that similar ones elsewhere match once in thousands,
_MINORITY = 1.0 / 3.0  # unless so many of them are in the map: of that part, and of fewer landmarks
_ODDS: Final = 1e3  # of the prior against another position, from which that one is out of the question
_WIDE: Final = 0.25  # of the limits of the search: from there on the prior is so wide that regions are tried as well


class PipelineConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """path: predict, segment, or auto: predict where the prior allows."""

    path: Literal["auto", "predict", "segment"] = "auto"
    space: Space = "hsv"
    least_px: int = 60  # of a region
    most_regions: int = 24
    farthest_m: float = 400.0  # of a landmark from the vehicle
    most_landmarks: int = 400  # near the prior; beyond it no region is identified
    identify: IdentifyConfig = IdentifyConfig()
    pose: PoseConfig = PoseConfig()
    memory: MemoryConfig = MemoryConfig()
    predict: PredictConfig = PredictConfig()


class LandmarkPipeline:
    """Images of one rig over one map. Raises ValueError."""

    def __init__(self, rig: StereoRig, landmarks: LandmarkMap, config: PipelineConfig | None = None) -> None:
        c = config or PipelineConfig()
        self._rig, self._map, self._config = rig, landmarks, c
        segment = SegmentConfig(c.space, c.least_px, c.most_regions, c.most_landmarks, c.identify, c.memory)
        self._segment = SegmentPath(rig, rectification(rig), segment)
        gone = c.identify.assumptions.gone_fraction
        self._predict = PredictPath(rig, c.predict, c.pose, gone, alone=not landmarks.automatic)

    def process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        """A pair, or one image, of t_ns near the prior. Never raises."""
        try:
            with np.errstate(all="ignore"):
                result = self._process(left, right, t_ns, prior)
                return result if result.fix is None else replace(result, fix=with_map_error(result.fix, self._map.common_sigma_m))
        except Exception as error:  # whatever an image trips over, the flight goes on
            return nothing(t_ns, "internal", f"{type(error).__name__}: {error}")

    def _process(self, left: Image | None, right: Image | None, t_ns: int, prior: Prior) -> Result:
        if flaw := _prior_flaw(prior):
            return nothing(t_ns, "no_prior", flaw)
        images = usable(left, right, self._rig)
        if isinstance(images, str):
            return nothing(t_ns, "no_image", images)
        prior = on_map(prior, self._map.common_sigma_m)
        near = self._near(prior)
        if not near:
            return nothing(t_ns, "no_landmark_near", images.remark)
        if images.one_channel:  # thermal or grey: what a colour looks like there is not known, not even its polarity
            near = [msgspec.structs.replace(mark, colour_bgr=None) for mark in near]
        predicted = "" if self._config.path == "segment" else self._predicted(images, near, t_ns, prior)
        if isinstance(predicted, Result):
            return predicted
        found = self._segment.locate(images, near, t_ns, prior)
        result = found if isinstance(found, Result) else self._verified(found, near, t_ns, prior)
        return result if result.fix is not None or not predicted else _with_remark(result, predicted)

    def _verified(self, found: Identified, near: list[Landmark], t_ns: int, prior: Prior) -> Result:
        moves = self._predict.moves(found.images, near, found.posterior)
        if moves is None:
            return nothing(t_ns, "no_pose", found.images.remark)
        result = self._predict.locate(found.images, *moves, t_ns, prior)
        if result.fix is not None:
            self._segment.clear()
        return with_regions(result, found.reports)

    def _predicted(self, images: Images, near: list[Landmark], t_ns: int, prior: Prior) -> Result | str:
        only = self._config.path == "predict"
        moves = self._predict.moves(images, near, prior)
        if moves is None:
            return nothing(t_ns, "no_landmark_near", f"{images.remark}predicted: none comes into view") if only else ""
        marks, move = moves
        if not only and (wide := self._predict.too_wide(images, move)):
            return f"outlines not searched: {wide}"
        located = self._predict.locate(images, marks, move, t_ns, prior)
        doubtful = self._may_be_the_next_house(located, images, near, prior)
        if doubtful:
            located = refused(located, "ambiguous", "it may show the neighbouring landmark, which looks alike")
        all_together = self._predict.moves(images, near, prior, self._config.predict.most_together) or moves
        coarse, alone = self._config.predict.coarse, not self._map.automatic
        result = judged(located, self._rig, images, *all_together, coarse, alone=alone)
        if result.fix is not None:
            self._segment.clear()
        settled = result.fix is not None or result.report.outcome == "waiting"  # a likely one is not overruled, but confirmed
        narrow = not doubtful and self._predict.narrow(images, move, _WIDE)
        return result if only or settled or narrow else ""

    def _may_be_the_next_house(self, located: Result, images: Images, near: list[Landmark], prior: Prior) -> bool:
        steps = _to_the_next_house(located, self._config.predict.most_fitted, near, prior)
        if located.pose is None or not len(steps):
            return False
        return not self._predict.stands_out(images, near, located.pose, steps, prior)

    def _near(self, prior: Prior) -> list[Landmark]:
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


def _with_remark(result: Result, remark: str) -> Result:
    report = msgspec.structs.replace(result.report, detail="; ".join(text for text in (result.report.detail, remark) if text))
    return replace(result, report=report)


def _to_the_next_house(result: Result, most: int, near: list[Landmark], prior: Prior) -> Array:
    """Steps (S, 3) to positions that look the same by the fix' landmarks (`most` are fitted).

    An outline found counts 12, one missed 1 / 2.6.
    """
    if result.fix is None or result.pose is None:
        return np.zeros((0, 3))
    used, shown = len(result.fix.landmarks), min(len(result.regions), most)
    marks = [mark for mark in near if mark.id in result.fix.landmarks]
    if not marks:
        return np.zeros((0, 3))
    share = _MAJORITY if used >= _ENOUGH and used > _MAJORITY * shown else _MINORITY
    return steps_off(result.pose.joint_p_n, marks, near, prior.p_n, prior.covariance, _ODDS, share)


def _prior_flaw(prior: Prior) -> str | None:
    p, q, cov = np.asarray(prior.p_n), np.asarray(prior.q_nb_wxyz), np.asarray(prior.covariance)
    if p.shape != (3,) or q.shape != (4,) or cov.shape != (6, 6):
        return "prior of the wrong shape"
    if not (np.isfinite(p).all() and np.isfinite(q).all() and np.isfinite(cov).all()):
        return "prior is not finite"
    if abs(float(np.linalg.norm(q)) - 1.0) > 1e-3:
        return "prior attitude is not a unit quaternion"
    if np.any(np.abs(cov - cov.T) > 1e-9 + 1e-6 * np.abs(cov.T)) or float(np.linalg.eigvalsh(cov)[0]) <= 0.0:
        return "prior covariance is not positive definite"
    return None
