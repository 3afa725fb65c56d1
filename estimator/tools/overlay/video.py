"""A log's images with the map as a video, and the residuals."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import cv2
import msgspec
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from estimator.frontend.residuals import Moment, Overlay, OverlayResult, Summary, View
from estimator.tools.overlay.files import Scenery
from estimator.tools.overlay.log import Flight, images, views
from logs.evaluation.plots import BLACK, BLUE, GREEN, ORANGE
from logs.store.reader import LogError, check_output
from vision.image.rectify import Image
from vision.show.overlay import Canvas

_CODECS: Final = {".mp4": "mp4v", ".webm": "VP80", ".avi": "MJPG"}  # what OpenCV's own FFmpeg can always write
_PLOTS: Final = (".png", ".svg", ".pdf")
_SLOWEST, _FASTEST = 1.0, 60.0  # images a second


class Choice(msgspec.Struct, frozen=True):
    """Every n-th image from start_s for seconds; right: camera; everything: all landmarks."""

    every: int = 1
    start_s: float = 0.0
    seconds: float = float("inf")
    right: bool = False
    everything: bool = False


class _Video:
    def __init__(self, path: Path | None, rate_hz: float) -> None:
        self._path, self._rate_hz = path, rate_hz
        self._writer: cv2.VideoWriter | None = None
        if path is not None and path.suffix.lower() not in _CODECS:
            raise LogError(f"{path}: no kind of video that can be written (known: {', '.join(_CODECS)})")
        if path is not None:
            check_output(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._writer is not None:
            self._writer.release()  # the file is whole

    def write(self, canvas: Canvas) -> None:
        if self._path is None:
            return
        if self._writer is None:
            code = cv2.VideoWriter.fourcc(*_CODECS[self._path.suffix.lower()])
            self._writer = cv2.VideoWriter(str(self._path), code, self._rate_hz, canvas.shape[1::-1])
            if not self._writer.isOpened():
                raise LogError(f"{self._path}: cannot be written")
        self._writer.write(canvas)


def make(
    flight: Flight,
    topic: str,
    scenery: Scenery,
    choice: Choice,
    video: Path | None,
    plot: Path | None,
    progress: Callable[[float], None] = lambda _: None,
) -> OverlayResult:
    """Draw and measure the chosen images; video and plot where wanted. Raises LogError."""
    if plot:
        _check_plot(plot)
    seen_from = views(flight, topic, scenery.rig.time_offset_s)
    start_ns = min((view.t_ns for view in seen_from if view), default=0)
    wanted = {k: view for k, view in enumerate(seen_from) if view and _chosen(choice, k, (view.t_ns - start_ns) * 1e-9)}
    if not wanted:
        raise LogError(f"{flight.path}: of {len(seen_from)} images none is chosen, or none has an estimate at its exposure")
    measured = None if choice.everything or not flight.used else flight.used
    overlay = Overlay(scenery.rig, scenery.landmarks, start_ns, choice.right)
    moments: list[Moment] = []
    with _Video(video, _rate_hz(wanted)) as film:
        for done, (number, image) in enumerate(images(flight, topic, wanted)):
            progress(done / len(wanted))
            if image is not None:
                _check_size(flight.path, image, overlay)
                frame = overlay.frame(image, wanted[number], measured, draw=video is not None)
                moments.append(frame.moment)
                film.write(frame.canvas)
    if not moments:
        raise LogError(f"{flight.path}: none of the {len(wanted)} images can be read")
    if plot:
        draw(moments).savefig(plot)
    summary = Summary.of(moments)
    return OverlayResult(
        log=str(flight.path),
        video=str(video or ""),
        plot=str(plot or ""),
        images=len(moments),
        without_estimate=seen_from.count(None),
        unreadable=len(wanted) - len(moments),
        measured="landmarks that a fix identified" if measured else "all landmarks in view",
        landmarks=overlay.rows(),
        moments=tuple(moments),
        residual_px=summary.residual_px,
        with_fix_px=summary.with_fix_px,
        without_fix_px=summary.without_fix_px,
        ratio=summary.ratio,
    )


def _check_plot(path: Path) -> None:
    if path.suffix.lower() not in _PLOTS:
        raise LogError(f"{path}: no kind of picture that can be written (known: {', '.join(_PLOTS)})")
    check_output(path)


def _check_size(log: Path, image: Image, overlay: Overlay) -> None:
    if image.shape[1::-1] != (overlay.camera.width, overlay.camera.height):
        raise LogError(
            f"{log}: images of {image.shape[1]} x {image.shape[0]}, a calibration for "
            f"{overlay.camera.width} x {overlay.camera.height}: not the same camera"
        )


def _chosen(choice: Choice, number: int, t_s: float) -> bool:
    return number % choice.every == 0 and choice.start_s <= t_s < choice.start_s + choice.seconds


def _rate_hz(wanted: dict[int, View]) -> float:
    t_ns = [view.t_ns for view in wanted.values()]
    step_s = float(np.median(np.diff(t_ns))) * 1e-9 if len(t_ns) > 1 else 1.0
    return float(np.clip(1.0 / max(step_s, 1e-9), _SLOWEST, _FASTEST))


def draw(moments: list[Moment]) -> Figure:
    """Residual over time, expected one, number of landmarks."""
    figure = Figure(figsize=(9.0, 5.5), dpi=120, layout="constrained", facecolor="white")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
    t = np.array([m.t_s for m in moments])
    residual = np.array([m.residual_px if m.residual_px is not None else np.nan for m in moments])
    expected = np.array([m.expected_px if m.expected_px is not None else np.nan for m in moments])
    fixed = np.array([m.identified > 0 for m in moments])
    above.plot(t, expected, color=BLUE, linewidth=1.0, label="expected, 1 sigma")
    for chosen, colour, marker, label in (
        (fixed, GREEN, "o", "residual, vision made a fix"),
        (~fixed, ORANGE, "x", "residual, no fix"),
    ):
        if np.isfinite(residual[chosen]).any():
            above.plot(t[chosen], residual[chosen], marker, color=colour, markersize=4, label=label)
    above.set_yscale("log")
    above.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    above.yaxis.set_major_formatter("{x:g}")
    above.yaxis.set_minor_formatter(NullFormatter())
    above.set_ylabel("reprojection residual [px]")
    above.grid(alpha=0.25, which="both")
    above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, fontsize=8, ncols=3)  # where no residual is
    below.step(t, [m.in_view for m in moments], where="mid", color=BLACK, linewidth=0.8, label="in view")
    below.step(t, [m.seen for m in moments], where="mid", color=GREEN, linewidth=1.5, label="measured and seen")
    below.set_ylabel("landmarks")
    below.set_xlabel("time [s]")
    below.set_ylim(0, None)
    below.grid(alpha=0.25)
    below.legend(loc="upper left", fontsize=8, ncols=2)
    return figure
