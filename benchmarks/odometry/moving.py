"""A scene of which half moves, in an outage, in a closed loop.

Fixes end at OUTAGE_S, and from then on half of the image moves: a deck (one half of the image), a truck (the middle of it, 2 m
high), water (one half, two waves over each other). Each scene draws its texture, height, speed and direction from its own seed.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmarks.flights.tasks import INSIDE95
from benchmarks.odometry.closed_loop import Rendered, Times, Views, error, flown
from benchmarks.odometry.sets import ground_of
from benchmarks.tables import Table
from models.messages import Array
from models.sim.scenario import EPOCH_NS, Simulation, simulate
from models.sim.scenario_file import loads
from vision.synthetic import make_rig

OUTAGE_S, ENDS_S = 24.0, (10.0, 30.0)
_TIMES: Final = Times(21.0, OUTAGE_S)
_HEIGHTS_M, _SPEEDS_M_S = (20.0, 30.0, 45.0, 60.0), (0.1, 0.2, 0.35, 0.6, 1.2, 3.0)
_TRUCK_M: Final = 2.0  # its height
SCENES: Final = 16
KINDS: Final = ("still", "deck", "truck", "water")


@dataclass(frozen=True)
class Drawn:
    """A scene: moving_m_s: velocity of what moves, north and east; side: which half of the image, 0 to 3."""

    seed: int
    kind: str
    texture: str
    height_m: float
    moving_m_s: Array
    side: int


@dataclass(frozen=True)
class End:
    """After so many seconds of the outage: errors [m] with odometry and of the IMU alone, 1-sigma [m], NEES/3, reasons."""

    scene: Drawn
    after_s: float
    error_m: float
    alone_m: float
    sigma_m: float
    ratio: float
    reasons: dict[str, int]


def drawn(number: int) -> Drawn:
    """The scene of this number; kinds take turns."""
    rng = np.random.default_rng(7000 + number)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    kind, speed = KINDS[number % len(KINDS)], float(rng.choice(_SPEEDS_M_S))
    velocity = np.zeros(2) if kind == "still" else speed * np.array([np.cos(angle), np.sin(angle)])
    texture = str(rng.choice(["village", "grass", "forest"]))
    return Drawn(7000 + number, kind, texture, float(rng.choice(_HEIGHTS_M)), velocity, int(rng.integers(4)))


def run(scene: Drawn, *, height_given: bool = False) -> list[End]:
    """The outage with odometry, and without."""
    text = (
        f"duration_s = {OUTAGE_S + ENDS_S[-1] + 1.0}\n[vehicle]\nkind = 'multirotor'\nspeed_m_s = 5.0\narea_m = 60.0\n"
        f"height_m = {scene.height_m}\n[imu]\nrate_hz = 100.0\ngrade = 'flight_controller'\n[pose_fix]\nrate_hz = 2.0\n"
    )
    simulation = simulate(loads(text), scene.seed)
    ends = [EPOCH_NS + round((OUTAGE_S + after_s) * 1e9) for after_s in ENDS_S]
    carried, reasons = flown(simulation, _HalfMoves(simulation, scene), _TIMES, height_given=height_given)
    alone, _ = flown(simulation, None, _TIMES, height_given=height_given)
    made = []
    for after_s, t_ns in zip(ENDS_S, ends, strict=True):
        e, other = (error(simulation, estimates, t_ns) for estimates in (carried, alone))
        ratio = float(e[0] @ np.linalg.solve(e[1], e[0])) / 3.0
        error_m, alone_m = (float(np.linalg.norm(x[0])) for x in (e, other))
        made.append(End(scene, after_s, error_m, alone_m, float(np.sqrt(np.trace(e[1]))), ratio, dict(reasons)))
    return made


class _HalfMoves(Rendered):
    """After OUTAGE_S half of each image shows ground that moves."""

    def __init__(self, simulation: Simulation, scene: Drawn) -> None:
        rig = make_rig()
        world = ground_of(scene.texture, 130.0 + 3.0 * scene.height_m, rig, scene.seed).world
        super().__init__(simulation.truth, world, rig, rig)
        self._drawn = scene

    def images(self, t_ns: int) -> Views:
        """The pair of a time."""
        k = int(np.searchsorted(self._truth.t_ns, t_ns))
        moved_s = max((t_ns - EPOCH_NS) * 1e-9 - OUTAGE_S, 0.0)
        p, still = self._truth.p_n[k], self.rendered(k, self._truth.p_n[k])
        if not moved_s or self._drawn.kind == "still":
            return still
        north, east = (moved_s * self._drawn.moving_m_s).tolist()
        shift = np.array([north, east, 0.0])
        nearer_m = _TRUCK_M if self._drawn.kind == "truck" else 0.0
        moving = self.rendered(k, p - shift + np.array([0.0, 0.0, nearer_m]))
        if self._drawn.kind == "water":  # a second wave, to the side of the first
            across = np.array([7.0 - east, 3.0 + north, 0.0])
            moving = _mixed(moving, self.rendered(k, p - across))
        left, right = (np.where(self._mask()[:, :, None], b, a) for a, b in zip(still, moving, strict=True))
        return left, right

    def _mask(self) -> Array:
        """Which pixels show what moves: half of them."""
        height, width = self._rig.left.height, self._rig.left.width
        v, u = np.mgrid[0:height, 0:width]
        if self._drawn.kind == "truck":
            inside: Array = (abs(v / height - 0.5) < 0.354) & (abs(u / width - 0.5) < 0.354)
            return inside
        halves = (u < width // 2, u >= width // 2, v < height // 2, v >= height // 2)
        return np.asarray(halves[self._drawn.side])


def _mixed(a: Views, b: Views) -> Views:
    left, right = (np.asarray(cv2.addWeighted(x, 0.5, y, 0.5, 0.0), np.uint8) for x, y in zip(a, b, strict=True))
    return left, right


def table(ends: Iterable[End]) -> Table:
    """A row for each kind and length of the outage."""
    rows = []
    those = list(ends)
    for kind in KINDS:
        for after_s in ENDS_S:
            some = [e for e in those if e.scene.kind == kind and e.after_s == after_s]
            if some:
                rows.append((kind, f"{after_s:.0f} s", str(len(some)), *_figures(some)))
    head = (
        "half of the image",
        "outage",
        "scenes",
        "alone m",
        "median m",
        "max m",
        "sigma m",
        "NEES/3",
        "largest",
        "inside 95 %",
    )
    return Table("Outages over scenes of which half moves", head, rows)


def _figures(ends: list[End]) -> tuple[str, ...]:
    of: Callable[[str], Array] = lambda name: np.array([getattr(e, name) for e in ends])  # noqa: E731
    errors, ratios = of("error_m"), of("ratio")
    return (
        f"{np.median(of('alone_m')):.1f}", f"{np.median(errors):.2f}", f"{errors.max():.1f}", f"{np.median(of('sigma_m')):.1f}",
        f"{ratios.mean():.2f}", f"{ratios.max():.1f}", f"{100.0 * (3.0 * ratios < INSIDE95).mean():.0f}",
    )  # fmt: skip
