"""Draws docs/images/demo.webp, ten seconds of what `landfix demo` wrote:  python -m docs.draw_demo [FOLDER]

Left what the camera saw with the map drawn in from the estimate; right the way flown, and the error with the reported 95 %
radius.
"""

import sys
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from estimator.frontend.residuals import Overlay, View
from estimator.tools.demo import carried_by
from estimator.tools.overlay.files import scenery
from estimator.tools.overlay.log import images, read, views
from logs.evaluation.collected import Collected
from logs.evaluation.collected import read as read_evidence
from logs.evaluation.evaluate import compare, find_outages
from logs.evaluation.plots import BLACK, BLUE, ORANGE
from models.maps.landmarks import LandmarkMap

OUT: Final = Path(__file__).parent / "images" / "demo.webp"
_EVERY, _PLAYED_MS, _HEIGHT = 2, 140, 372  # of the images; each is shown so long; px
_MOST_BYTES: Final = 1_500_000
_TAIL_MS: Final = 2500  # the last image stays
_MARGIN_M, _WIDE = 25.0, 2.0  # of the map: around the way; its width to its height


class Panel:
    """The right half: drawn once, then moved along."""

    def __init__(self, log: Path, landmarks: LandmarkMap, flown: list[View]) -> None:
        collected = read_evidence(log)
        compared = compare(collected.estimate, collected.truth)
        self._start_ns = int(collected.estimate.t_ns[0])
        self._t = (compared.estimate.t_ns - self._start_ns) * 1e-9
        self._error = np.linalg.norm(compared.p_error[:, :2], axis=1)
        self._flown = flown
        figure = Figure(figsize=(4.6, _HEIGHT / 100.0), dpi=100, layout="constrained", facecolor="white")
        self._canvas: Any = FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, height_ratios=(1.7, 1.0))
        self._draw_map(above, landmarks)
        self._draw_error(below, collected)

    def _draw_map(self, at: Any, landmarks: LandmarkMap) -> None:
        way = np.array([view.p_n for view in self._flown])
        for landmark in landmarks:
            ring = np.vstack((landmark.outline_n, landmark.outline_n[:1]))
            at.fill(ring[:, 1], ring[:, 0], facecolor="#d9d4c8", edgecolor="#8b8677", linewidth=0.5)
        at.plot(way[:, 1], way[:, 0], color="0.75", linewidth=1.0)
        (self._way,) = at.plot([], [], color=BLUE, linewidth=1.6)
        (self._here,) = at.plot([], [], "o", color=ORANGE, markersize=6)
        (self._ring,) = at.plot([], [], color=ORANGE, linewidth=1.2)
        middle = (way.min(axis=0) + way.max(axis=0)) / 2.0
        half_north = (way.max(axis=0) - way.min(axis=0))[:2].max() / 2.0 / _WIDE + _MARGIN_M
        at.set_ylim(middle[0] - half_north, middle[0] + half_north)
        at.set_xlim(middle[1] - _WIDE * half_north, middle[1] + _WIDE * half_north)
        at.set_aspect("equal")
        at.set_xticks([])
        at.set_yticks([])
        at.set_title("position and 95 % radius", fontsize=9)

    def _draw_error(self, at: Any, collected: Collected) -> None:
        outages = find_outages(collected.aids, collected.health, collected.estimate, 5.0)
        t = np.array([(view.t_ns - self._start_ns) * 1e-9 for view in self._flown])
        radius = np.array([view.radius95_m for view in self._flown])
        at.plot(t, radius, color="0.8", linewidth=1.0)
        (self._radius,) = at.plot([], [], color=ORANGE, linewidth=1.4, label="reported, 95 %")
        (self._line,) = at.plot([], [], color=BLUE, linewidth=1.4, label="error")
        for begin, end in outages["all"].spans:
            at.axvspan((begin - self._start_ns) * 1e-9, (end - self._start_ns) * 1e-9, color="0.9", linewidth=0.0)
            begin_s, words = (begin - self._start_ns) * 1e-9, carried_by(collected, (begin, end))
            at.text(begin_s, 0.78, words, va="top", fontsize=7, transform=at.get_xaxis_transform())
        off = (outages["/gnss"].spans[0][0] - self._start_ns) * 1e-9
        at.axvline(off, color=BLACK, linestyle="--", linewidth=0.9)
        at.text(off, 0.95, " GPS cut off", va="top", fontsize=8, transform=at.get_xaxis_transform())
        at.set(xlim=(0.0, t[-1]), ylim=(0.0, 1.1 * radius[t > 5.0].max()))
        at.set_xlabel("time [s]", fontsize=8)
        at.set_ylabel("horizontal [m]", fontsize=8)
        at.tick_params(labelsize=8)
        at.legend(loc="upper left", fontsize=7, frameon=False)
        self._when, self._reported = t, radius

    def at(self, number: int) -> np.ndarray[Any, Any]:
        """The panel when the vehicle is at view `number`."""
        way = np.array([view.p_n for view in self._flown[: number + 1]])
        now, radius = self._when[number], self._reported[number]
        angle = np.linspace(0.0, 2.0 * np.pi, 60)
        self._way.set_data(way[:, 1], way[:, 0])
        self._here.set_data(way[-1:, 1], way[-1:, 0])
        self._ring.set_data(way[-1, 1] + radius * np.sin(angle), way[-1, 0] + radius * np.cos(angle))
        self._radius.set_data(self._when[: number + 1], self._reported[: number + 1])
        shown = self._t <= now
        self._line.set_data(self._t[shown][::20], self._error[shown][::20])
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


def main(folder: Path) -> None:
    """Write the image."""
    log = folder / "estimate.mcap"
    flight = read(log)
    around = scenery(log, flight.attachments, folder / "demo.toml")
    topic = flight.topic_of(("/left/image",))
    seen_from = {k: view for k, view in enumerate(views(flight, topic, around.rig.time_offset_s)) if view and k % _EVERY == 0}
    numbers = sorted(seen_from)
    panel = Panel(log, around.landmarks, [seen_from[k] for k in numbers])
    overlay = Overlay(around.rig, around.landmarks, seen_from[numbers[0]].t_ns)
    frames = []
    for number, image in images(flight, topic, numbers):
        assert image is not None
        drawn = cv2.cvtColor(overlay.frame(image, seen_from[number]).canvas, cv2.COLOR_BGR2RGB)
        size = (round(drawn.shape[1] * _HEIGHT / drawn.shape[0]), _HEIGHT)
        drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        frames.append(Image.fromarray(np.hstack((drawn, panel.at(numbers.index(number))))))
    shown_ms = [_PLAYED_MS] * (len(frames) - 1) + [_TAIL_MS]
    for quality in (70, 60, 50, 40, 30):
        frames[0].save(OUT, save_all=True, append_images=frames[1:], duration=shown_ms, loop=0, quality=quality, method=4)
        if OUT.stat().st_size < _MOST_BYTES:
            break
    print(f"{OUT}: {len(frames)} images of {frames[0].width} x {frames[0].height}, quality {quality}, {OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo"))
