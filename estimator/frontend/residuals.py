"""Overlay test: the map projected from the estimate against image edges.

Residual of an image: median over landmarks of Residuals.spread_px.
"""

from collections import defaultdict
from collections.abc import Collection
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from vision.describe.survey import to_8_bit
from vision.show.overlay import Canvas, Residuals, add_strip, draw_overlay, expected_px, in_view, outline_residuals

_REACH_M = 300.0  # landmarks further off are too small to be measured
_LEAST_REACH_PX, _MOST_REACH_PX = 6.0, 30.0  # edges are searched for so far at least, and at most
_SIGMAS = 3.0  # edges are searched for within so many expected standard deviations
_LEAST_FOUND, _LEAST_POINTS = 0.5, 8  # a landmark is seen if so many points of its outline have an edge near


class View(NamedTuple):
    """Estimate at exposure; covariance (6, 6) about the axes of n; identified: landmarks of its fix."""

    t_ns: int
    p_n: Array
    R_nb: Array
    covariance: Array
    radius95_m: float
    mode: str
    identified: frozenset[str]


class Moment(msgspec.Struct, frozen=True):
    """One image: the estimate, and how well its outlines lie."""

    t_s: Annotated[float, Meta(description="since the estimate began")]
    mode: str
    radius95_m: float
    identified: int
    in_view: int
    seen: int
    residual_px: float | None
    expected_px: float | None


class Spread(msgspec.Struct, frozen=True):
    """Of n residuals, px."""

    n: int
    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: list[float]) -> "Spread | None":
        """None of none."""
        if not values:
            return None
        median, p95, most = (float(x) for x in np.percentile(values, [50, 95, 100]))
        return cls(len(values), median, p95, most)


class LandmarkRow(msgspec.Struct, frozen=True):
    """One landmark over the flight: images in view, images seen, residuals."""

    id: str
    name: str
    in_view: int
    residual_px: Spread | None


class Summary(NamedTuple):
    """with_fix: residuals of images with a fix."""

    residual_px: Spread | None
    with_fix_px: Spread | None
    without_fix_px: Spread | None
    ratio: float | None

    @classmethod
    def of(cls, moments: list[Moment]) -> "Summary":
        """Images without a residual do not count."""
        seen = [(m.residual_px, m.expected_px, m.identified > 0) for m in moments if m.residual_px is not None]
        ratios = [residual / expected for residual, expected, _ in seen if expected]
        return cls(
            Spread.of([residual for residual, _, _ in seen]),
            Spread.of([residual for residual, _, fixed in seen if fixed]),
            Spread.of([residual for residual, _, fixed in seen if not fixed]),
            float(np.median(ratios)) if ratios else None,
        )


class OverlayResult(msgspec.Struct, frozen=True):
    """ratio: median of residual / expected, 1: consistent."""

    log: str
    video: str
    plot: str
    images: int
    without_estimate: int
    unreadable: int
    measured: str
    residual_px: Spread | None
    with_fix_px: Spread | None
    without_fix_px: Spread | None
    ratio: float | None
    landmarks: tuple[LandmarkRow, ...]
    moments: tuple[Moment, ...]


class Frame(NamedTuple):
    """An image with the map in it, and its numbers."""

    canvas: Canvas
    moment: Moment


class Overlay:
    """Draws and measures images in order; times from start_ns."""

    def __init__(self, rig: StereoRig, landmarks: LandmarkMap, start_ns: int, right: bool = False) -> None:
        self._rig, self._landmarks, self._start_ns, self._right = rig, landmarks, start_ns, right
        self._in_view: defaultdict[str, int] = defaultdict(int)
        self._residuals: defaultdict[str, list[float]] = defaultdict(list)

    @property
    def camera(self) -> CameraModel:
        """The images' camera."""
        return self._rig.right if self._right else self._rig.left

    def frame(
        self,
        image: NDArray[np.uint8] | NDArray[np.uint16],
        view: View,
        measured: Collection[str] | None = None,
        draw: bool = True,
    ) -> Frame:
        """The image; measured: landmark ids, None: all in view."""
        canvas = np.asarray(to_8_bit(image), np.uint8)
        place = self._rig.right_camera_pose if self._right else self._rig.camera_pose
        p_nc, R_nc = place(view.p_n, view.R_nb)
        near = in_view(self.camera, p_nc, R_nc, self._landmarks.near(p_nc[0], p_nc[1], _REACH_M))
        expected = {mark.id: expected_px(self.camera, view.p_n, p_nc, R_nc, view.covariance, mark) for mark in near}
        residuals = self._measure(canvas, p_nc, R_nc, near, expected, measured)
        moment = self._moment(view, len(near), residuals, expected)
        if draw:
            canvas = draw_overlay(canvas, self.camera, p_nc, R_nc, near, view.identified, residuals)
            canvas = add_strip(canvas, _strip(moment))
        return Frame(canvas, moment)

    def rows(self) -> tuple[LandmarkRow, ...]:
        """A row per landmark, the most seen first."""
        made = [LandmarkRow(i, self._landmarks[i].name, n, Spread.of(self._residuals[i])) for i, n in self._in_view.items()]
        return tuple(sorted(made, key=lambda row: (-(row.residual_px.n if row.residual_px else 0), row.id)))

    def _measure(
        self,
        canvas: Canvas,
        p_nc: Array,
        R_nc: Array,
        near: list[Landmark],
        expected: dict[str, float],
        measured: Collection[str] | None,
    ) -> list[Residuals]:
        off = _SIGMAS * np.median([sigma for sigma in expected.values() if np.isfinite(sigma)] or [0.0])
        reach_px = float(np.clip(off, _LEAST_REACH_PX, _MOST_REACH_PX))
        seen = []
        for residual in outline_residuals(canvas, self.camera, p_nc, R_nc, near, reach_px):
            wanted = measured is None or residual.id in measured
            if wanted and len(residual.px) >= _LEAST_POINTS:
                self._in_view[residual.id] += 1
                if residual.found >= _LEAST_FOUND:
                    self._residuals[residual.id].append(residual.spread_px)
                    seen.append(residual)
        return seen

    def _moment(self, view: View, in_sight: int, residuals: list[Residuals], expected: dict[str, float]) -> Moment:
        return Moment(
            t_s=(view.t_ns - self._start_ns) * 1e-9,
            mode=view.mode,
            radius95_m=view.radius95_m,
            identified=len(view.identified),
            in_view=in_sight,
            seen=len(residuals),
            residual_px=float(np.median([r.spread_px for r in residuals])) if residuals else None,
            expected_px=float(np.median([expected[r.id] for r in residuals])) if residuals else None,
        )


def _strip(moment: Moment) -> list[str]:
    residual = "residual -" if moment.residual_px is None else f"residual {moment.residual_px:.2f} px"
    expected = "" if moment.expected_px is None else f" (expected {moment.expected_px:.2f})"
    mode = moment.mode.replace("_", " ") or "mode unknown"
    return [f"{moment.t_s:.1f} s", mode, f"95 %: {moment.radius95_m:.2f} m", residual + expected]
