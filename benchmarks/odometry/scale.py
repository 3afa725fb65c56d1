"""What a rig that is not as calibrated costs in an outage, with its scale learnt before and without.

Flights over village, grass and forest with a rig drawn from its covariance (0.6 px of disparity). Learnt: odometry runs for
LEARNT_S beside the fixes before they end. Not learnt: it begins when they end. The error of the position is in % of the way.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.flights.tasks import INSIDE95
from benchmarks.odometry.closed_loop import Rendered, Times, error, flown
from benchmarks.odometry.sets import ground_of
from benchmarks.tables import Table
from models.sim.scenario import EPOCH_NS, simulate
from models.sim.scenario_file import loads
from vision.synthetic import make_rig

LEARNT_S, BEGIN_S = 60.0, 20.0
OUTAGE_S: Final = BEGIN_S + LEARNT_S
ENDS_S: Final = (30.0, 60.0)
TEXTURES: Final = ("village", "grass", "forest")
HEIGHTS_M: Final = (30.0, 45.0, 60.0)
WAYS: Final = {"scale learnt": (True, False), "not learnt": (False, False), "learnt, height given": (True, True)}
FLIGHTS: Final = 9


@dataclass(frozen=True)
class End:
    """After so many seconds of the outage: way [m], error [m], 1-sigma [m], NEES/3."""

    flight: str
    way: str
    after_s: float
    flown_m: float
    error_m: float
    sigma_m: float
    ratio: float
    reasons: dict[str, int]


def run(number: int, ways: Iterable[str] = WAYS) -> list[End]:
    """The flight of this number."""
    texture, height_m = TEXTURES[number % 3], HEIGHTS_M[number // 3 % 3]
    rng = np.random.default_rng(9000 + number)
    course, turn = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-1.0, 1.0)
    legs = [(OUTAGE_S + t, 350.0 * np.array([np.cos(course + a), np.sin(course + a)])) for t, a in ((-8.0, 0.0), (30.0, turn))]
    visits = [[t, *(p * k).tolist()] for k, (t, p) in enumerate(legs, start=1)]
    text = (
        f"duration_s = {OUTAGE_S + ENDS_S[-1] + 1.0}\n[vehicle]\nkind = 'multirotor'\nspeed_m_s = 10.0\narea_m = 120.0\n"
        f"height_m = {height_m}\nvisits = {visits}\n[imu]\nrate_hz = 100.0\n"
        "grade = 'flight_controller'\n[pose_fix]\nrate_hz = 2.0\n"
    )
    simulation = simulate(loads(text), 9000 + number)
    rig = make_rig()
    scene = ground_of(texture, 800.0, rig, 9000 + number)
    truth, ends = simulation.truth, []
    for way in ways:
        is_learnt, height_given = WAYS[way]
        times = Times(BEGIN_S if is_learnt else OUTAGE_S - 0.5, OUTAGE_S)
        camera = Rendered(truth, scene.world, rig, scene.rig)
        estimates, reasons = flown(simulation, camera, times, height_given=height_given)
        for after_s in ENDS_S:
            begin_ns, t_ns = (EPOCH_NS + round(s * 1e9) for s in (OUTAGE_S, OUTAGE_S + after_s))
            e, covariance = error(simulation, estimates, t_ns)
            along = truth.p_n[slice(*np.searchsorted(truth.t_ns, (begin_ns, t_ns)))]
            flown_m = float(np.linalg.norm(np.diff(along, axis=0), axis=1).sum())
            ratio = float(e @ np.linalg.solve(covariance, e)) / 3.0
            sigma_m, error_m = float(np.sqrt(np.trace(covariance))), float(np.linalg.norm(e))
            ends.append(
                End(f"{texture} {height_m:.0f} m", way, after_s, flown_m, error_m, sigma_m, ratio, dict(Counter(reasons)))
            )
    return ends


def table(ends: Iterable[End]) -> Table:
    """A row for each way and length of the outage."""
    those, rows = list(ends), []
    for way in WAYS:
        for after_s in ENDS_S:
            some = [e for e in those if e.way == way and e.after_s == after_s]
            if some:
                ratios = np.array([e.ratio for e in some])
                shares = 100.0 * np.array([e.error_m / e.flown_m for e in some])
                flown_m, error_m, sigma_m = (np.median([getattr(e, k) for e in some]) for k in ("flown_m", "error_m", "sigma_m"))
                figures = (
                    f"{flown_m:.0f}",
                    f"{error_m:.1f}",
                    f"{np.median(shares):.2f}",
                    f"{shares.max():.1f}",
                    f"{sigma_m:.1f}",
                )
                inside = f"{100.0 * (3.0 * ratios < INSIDE95).mean():.0f}"
                rows.append((way, f"{after_s:.0f} s", str(len(some)), *figures, f"{ratios.mean():.2f}", inside))
    head = (
        "stereo, rig drawn",
        "outage",
        "flights",
        "way m",
        "median m",
        "% of the way",
        "largest %",
        "sigma m",
        "NEES/3",
        "inside 95 %",
    )
    return Table("Outages at 10 m/s, 30 to 60 m high, rig drawn from its covariance", head, rows)
