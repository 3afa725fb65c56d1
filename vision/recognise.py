"""Recognition by description, at boot or for a lost prior (thesis chapter 5).

rectify -> segment -> regions -> correspond -> measure -> identify -> position
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.prior import Prior
from vision.describe import epipolar
from vision.describe.correspond import Match, Unmatched, correspond
from vision.describe.measure import Measured, measure
from vision.describe.regions import Limits, Region
from vision.describe.segment import Space
from vision.describe.survey import Settings, grey, segment_regions
from vision.identify import sightings
from vision.identify.catalogue import Catalogue, Sighting, catalogue
from vision.identify.constellation import Constellation, MemoryConfig
from vision.identify.identify import NONE, Identification, IdentifyConfig, identify
from vision.identify.partial import seen_corners
from vision.image.rectify import Image, Mask, Rectification, rectify
from vision.records.images import Images
from vision.records.reports import RegionReport, Result, nothing, report_of

_ROWS_PX: Final = 0.8  # rows that differ by less do no harm
_WIDER: Final = 4.0  # variances of the position where the search is: outlines of regions are not quite those of roofs
_TOO_FLAT: Final = "seen too flat to know its size"


@dataclass(frozen=True, slots=True)
class SegmentConfig:
    """least_px: of a region; most_landmarks: near the prior."""

    space: Space
    least_px: int
    most_regions: int
    most_landmarks: int
    identify: IdentifyConfig
    memory: MemoryConfig


@dataclass(frozen=True, slots=True)
class _Views:
    work: Image
    other: Image | None
    valid: Mask | None


@dataclass(frozen=True, slots=True)
class _Seen:
    regions: list[Region]
    sightings: list[Sighting]
    refused: list[RegionReport]
    metric: bool
    scale_sigma: float
    remark: str


@dataclass(frozen=True, slots=True)
class Identified:
    """A pose to examine; images that fit each other; posterior; reports per region."""

    images: Images
    posterior: Prior
    reports: list[RegionReport]


class SegmentPath:
    """Regions of images of one rig, identified as landmarks."""

    def __init__(self, rig: StereoRig, rectified: Rectification, config: SegmentConfig) -> None:
        self._rig, self._rectified, self._config = rig, rectified, config
        self._rows_sigma_px = _rows_sigma(rectified.rig)
        self._memory = Constellation(config.memory)

    def clear(self) -> None:
        """A fix was made: what is remembered has another error from now on."""
        self._memory.clear()

    def locate(self, images: Images, near: list[Landmark], t_ns: int, prior: Prior) -> Identified | Result:
        """Identified, or the reason; near: candidate landmarks."""
        if len(near) > self._config.most_landmarks:  # among some of them only, a wrong one may appear certain
            return nothing(t_ns, "prior_too_wide", f"{images.remark}{len(near)} landmarks may be in view")
        known = catalogue(near)
        views = self._views(images)
        regions = self._segment(views, near)
        if not regions:
            return nothing(t_ns, "no_region", images.remark)
        seen = self._measure(images, views, regions, prior, known)
        if isinstance(seen, str):
            return nothing(t_ns, "swapped", seen, len(regions))
        return self._decide(images, seen, known, t_ns, prior)

    def _views(self, images: Images) -> _Views:
        r = self._rectified
        maps = (r.right, r.left) if images.only_right else (r.left, r.right)
        raw = (images.right, None) if images.only_right else (images.left, images.right)
        assert raw[0] is not None
        other = None if raw[1] is None else rectify(raw[1], maps[1])
        return _Views(rectify(raw[0], maps[0]), other, maps[0].valid if maps[0] else None)

    def _segment(self, views: _Views, near: list[Landmark]) -> list[Region]:
        colours = tuple(sorted({m.colour_bgr for m in near if m.colour_bgr is not None}))
        limits = Limits(least_px=self._config.least_px, most=self._config.most_regions)
        return segment_regions(views.work, views.valid, Settings(colours, self._config.space, limits=limits))

    def _measure(self, images: Images, views: _Views, regions: list[Region], prior: Prior, known: Catalogue) -> _Seen | str:
        usable_regions = [r for r in regions if not r.touches_border or self._corners(views, r).sum() > 1]
        refused = [_cut_off(r) for r in regions if all(r is not one for one in usable_regions)]
        if views.other is None:
            return self._one_camera(images, views, usable_regions, prior, known, refused, images.remark)
        rig = self._rectified.rig
        matches = correspond(grey(views.work), grey(views.other), usable_regions, rig)
        if swapped := epipolar.pair_reason(matches, None):
            return swapped
        if rows := self._rows_off(views, matches):
            problem = f"rows differ by {rows:+.1f} px: wrong calibration, or images not taken together"
            return self._one_camera(
                images, views, usable_regions, prior, known, refused, f"{images.remark}right camera not used: {problem}; "
            )
        level = sightings.level(prior, rig)
        kept, seen, measured = list[Region](), list[Sighting](), list[Measured]()
        for match in matches:
            m = measure(match, rig, level=level) if isinstance(match, Match) else match
            if not isinstance(m, Measured):
                refused.append(_not_measured(m.region, m.reason))
                continue
            one = self._sighting(views, m.region, sightings.from_stereo(m, prior, rig), prior, rig, known)
            if isinstance(one, RegionReport):
                refused.append(one)
            else:
                kept.append(m.region)
                seen.append(one)
                measured.append(m)
        return _Seen(kept, seen, refused, True, sightings.shared_scale_sigma(measured), images.remark)

    def _rows_off(self, views: _Views, matches: Sequence[Match | Unmatched]) -> float:
        found = [m for m in matches if isinstance(m, Match)]
        limit = max(_ROWS_PX, 3.0 * self._rows_sigma_px)
        off = [m.vertical_px for m in found if abs(m.vertical_px) > limit + 3.0 * m.vertical_sigma_px]
        if off and 2 * len(off) >= len(found):
            return float(np.median(off))
        if views.other is not None and 2 * len(found) < len(matches):  # in doubt: searches further, and takes longer
            residual = epipolar.edge_residual(grey(views.work), grey(views.other), self._rectified.rig)
            if residual and abs(residual.vertical_px) > limit + 3.0 * residual.sigma_px:
                return residual.vertical_px
        return 0.0

    def _one_camera(
        self,
        images: Images,
        views: _Views,
        usable_regions: list[Region],
        prior: Prior,
        known: Catalogue,
        refused: list[RegionReport],
        remark: str,
    ) -> _Seen:
        rig = sightings.one_eyed(self._rectified.rig, right=images.only_right)
        roof_d = float(np.mean(known.position_n[:, 2]))
        kept, seen = list[Region](), list[Sighting]()
        for region in usable_regions:
            one = self._sighting(views, region, sightings.from_one_camera(region, prior, rig, roof_d), prior, rig, known)
            if isinstance(one, RegionReport):
                refused.append(one)
            else:
                kept.append(region)
                seen.append(one)
        return _Seen(kept, seen, refused, False, sightings.ONE_CAMERA_SCALE_SIGMA, remark)

    def _sighting(
        self, views: _Views, region: Region, one: Sighting | None, prior: Prior, rig: StereoRig, known: Catalogue
    ) -> Sighting | RegionReport:  # fmt: skip
        if one is None:
            return _not_measured(region, _TOO_FLAT)
        if region.touches_border:
            return sightings.cut_off(one, region, self._corners(views, region), prior, rig, known) or _cut_off(region)
        return one

    def _corners(self, views: _Views, region: Region) -> NDArray[np.bool_]:
        if region.corners is None:
            return np.zeros(len(region.outline), np.bool_)
        height, width = views.work.shape[:2]
        return seen_corners(region.corners, width, height, views.valid)

    def _decide(self, images: Images, seen: _Seen, known: Catalogue, t_ns: int, prior: Prior) -> Identified | Result:
        rig = sightings.one_eyed(self._rectified.rig, right=images.only_right)
        remembered = self._memory.recall(seen.sightings, t_ns, prior) if seen.metric else []
        every = seen.sightings + remembered
        found = identify(every, known, prior, rig, seen.scale_sigma, self._config.identify, metric=seen.metric)
        now = len(seen.sightings)
        reports = [*(_region(seen.regions[i], found, i, known, self._config.identify) for i in range(now)), *seen.refused]
        remark = f"{seen.remark}{_summary(found, now, len(remembered))}; "
        if not found.accepted[:now].any() or found.position_posterior < self._config.identify.fix_posterior:
            if seen.metric:
                self._memory.hold(seen.sightings, remembered, t_ns, prior)
            return Result(None, report_of(t_ns, _unsettled(found, now), remark, reports), tuple(reports))
        posterior = Prior(*prior.moved(found.x), _WIDER * found.covariance[:6, :6])
        right = images.right if seen.metric or images.only_right else None
        return Identified(replace(images, right=right, remark=remark), posterior, reports)


def _rows_sigma(rig: StereoRig) -> float:
    turn = 0.0 if rig.covariance_rc is None else float(rig.covariance_rc[3, 3]) * rig.left.fy**2
    return float(np.sqrt(turn + sum(float(c.covariance[3, 3]) for c in (rig.left, rig.right) if c.covariance is not None)))


def _cut_off(region: Region) -> RegionReport:
    return RegionReport("cut_off", region.bbox, reason="cut off by the image's edge")


def _not_measured(region: Region, reason: str) -> RegionReport:
    return RegionReport("not_measured", region.bbox, reason=reason)


def _region(region: Region, found: Identification, i: int, known: Catalogue, config: IdentifyConfig) -> RegionReport:
    landmark = found.landmark[i] if found.landmark[i] != NONE else found.best[i]
    name = known.ids[landmark] if landmark != NONE else ""
    posterior, candidates = float(found.posterior[i]), int(found.candidates[i])
    similarity = float(found.own_similarity[i] if found.landmark[i] != NONE else found.similarity[i])
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
    return RegionReport(state, region.bbox, name, similarity, posterior, candidates, reason)


def _unsettled(found: Identification, now: int) -> str:
    if not found.candidates[:now].any():
        return "no_candidate"
    return "ambiguous" if (found.landmark[:now] != NONE).any() else "not_in_map"


def _summary(found: Identification, now: int, remembered: int) -> str:
    count = int(found.accepted[:now].sum())
    before = f", {remembered} of earlier images" if remembered else ""
    return f"{count} of {now} regions identified{before}, position with probability {found.position_posterior:.5f}"
