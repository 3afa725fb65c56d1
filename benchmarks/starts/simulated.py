"""Simulated vehicles whose acceleration shows no heading: a boat, a hover, straight flight, twenty minutes of rest.

With GNSS alone, with its course, with a magnetometer, with two antennas. The IMU is that of a flight controller, GNSS has 5 Hz.

    begins, heading: s from the first position to the first estimate, and to the first with a heading
    NEES: e' P^-1 e / k of the seconds since, in expectation 1; yaw: e^2 / sigma^2
"""

import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import Final, NamedTuple

import msgspec
import numpy as np

from benchmarks.tables import Table, number
from estimator.filter.alignment import InitialiseConfig
from estimator.fusion import Fusion, FusionConfig
from models import so3
from models.messages import Array, Estimate, GnssFix, Input, Mode
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES
from models.state import E, X, local
from tests.scenarios.senses import HOME, Ride, heading, loops, magnetometer, ride

SEEDS: Final = (1, 2)
_SECOND_NS: Final = 1_000_000_000
_ON_S: Final = 5.0  # when the sensors are switched on: a vehicle in motion has its speed
_Path = Callable[[Array], Array]


def boat(t: Array) -> Array:
    """3 m/s along the nose, in wide turns."""
    yaw = 0.4 * np.sin(0.03 * t)
    steps = 3.0 * np.gradient(t) if len(t) > 1 else np.zeros_like(t)
    return np.column_stack([np.cumsum(steps * np.cos(yaw)), np.cumsum(steps * np.sin(yaw)), np.zeros_like(t), yaw])


def hover(t: Array) -> Array:
    """Within a decimetre of a point, the nose drifting by a few degrees."""
    return np.column_stack([0.1 * np.sin(0.5 * t), 0.1 * np.cos(0.4 * t) - 0.1, np.zeros_like(t), 0.05 * np.sin(0.1 * t)])


def straight(t: Array) -> Array:
    """20 m/s to the north."""
    return np.column_stack([20.0 * t, np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)])


class _Scene(NamedTuple):
    rest_s: float
    moving_s: float
    path: _Path


SCENES: Final = {
    "boat": _Scene(0.0, 60.0, boat),
    "hover": _Scene(0.0, 60.0, hover),
    "straight flight": _Scene(0.0, 60.0, straight),
    "rest of 20 min, then loops": _Scene(1200.0, 40.0, loops),
}
SENSES: Final = ("GNSS", "GNSS with its course", "magnetometer", "two antennas")


class _Start(NamedTuple):
    begins_s: float
    heading_s: float
    error_m: float  # horizontal, rms since there is a heading, or an estimate
    position: float  # NEES / 3
    attitude: float  # NEES / 3
    yaw: float


def _readings(journey: Ride, sense: str, seed: int) -> list[Input]:
    if sense == "magnetometer":
        return list(magnetometer(journey.truth, seed=seed))
    return list(heading(journey.truth, seed=seed)) if sense == "two antennas" else []


def start(job: tuple[str, str, int]) -> _Start:
    """One run."""
    scene, sense, seed = SCENES[job[0]], job[1], job[2]
    journey = ride(scene.rest_s, scene.moving_s, seed=seed, yaw=0.0, path=scene.path)
    config = FusionConfig(imu=GRADES["flight_controller"].noise, origin=HOME.lla)
    if sense == "GNSS with its course":
        config = msgspec.structs.replace(config, initialise=InitialiseConfig(course_sigma_deg=5.0))
    heard = sorted([*journey.messages, *_readings(journey, sense, seed)], key=lambda m: m.arrived_ns)
    messages = [m for m in heard if m.t_ns - EPOCH_NS > _ON_S * _SECOND_NS]
    fusion = Fusion(config)
    estimates = [out for m in messages for out in fusion.handle(m) if isinstance(out, Estimate)]
    return judged(estimates, journey, next(m.t_ns for m in messages if isinstance(m, GnssFix)))


def judged(estimates: list[Estimate], journey: Ride, first_ns: int) -> _Start:
    """What an estimate is worth, once a second."""
    if not estimates:
        return _Start(*[math.nan] * 6)
    aligned = [e for e in estimates if e.mode is not Mode.ALIGNING_HEADING]
    rows = []
    next_ns = 0
    for e in estimates:
        if e.t_ns < next_ns:
            continue
        next_ns = e.t_ns + _SECOND_NS
        rows.append(_errors(e, journey))
    begins, is_aligned = estimates[0].t_ns, bool(aligned)
    heading_s = (aligned[0].t_ns - first_ns) * 1e-9 if is_aligned else math.nan
    horizontal, position, attitude, yaw = np.mean(rows, axis=0).tolist()
    return _Start((begins - first_ns) * 1e-9, heading_s, math.sqrt(horizontal), position, attitude, yaw)


def _errors(e: Estimate, journey: Ride) -> tuple[float, float, float, float]:
    """Squared horizontal error, NEES/3 of position and attitude, squared error of the yaw in sigma."""
    truth = journey.truth
    k = int(np.searchsorted(truth.t_ns, e.t_ns))
    x = np.concatenate([truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], truth.gyro_bias[k], truth.accel_bias[k]])
    off = local(e.nav, x)
    nees = [float(off[part] @ np.linalg.solve(e.covariance[part, part], off[part])) / 3.0 for part in (E.P, E.THETA)]
    down = so3.matrix(e.nav[X.Q])[2]
    yaw = float(down @ off[E.THETA]) ** 2 / float(down @ e.covariance[E.THETA, E.THETA] @ down)
    return float(off[0] ** 2 + off[1] ** 2), nees[0], nees[1], yaw


def table(pool: ProcessPoolExecutor) -> Table:
    """A row for each scene and sense: the latest begin of the seeds, means of the rest."""
    jobs = list(product(SCENES, SENSES, SEEDS))
    found: dict[tuple[str, str, int], _Start] = {}
    for job, result in zip(jobs, pool.map(start, jobs), strict=True):
        found[job] = result
        print(*job, *map(number, result), sep="  ", flush=True)
    rows = []
    for scene, sense in product(SCENES, SENSES):
        runs = np.array([found[scene, sense, seed] for seed in SEEDS])
        worst = runs[:, :2].max(axis=0).tolist()
        means = runs[:, 2:].mean(axis=0).tolist()
        rows.append((scene, sense, *map(number, [*worst, *means])))
    columns = ("scene", "with", "begins [s]", "heading [s]", "error [m]", "position NEES/3", "attitude NEES/3", "yaw NEES")
    return Table("Starts without a heading", columns, rows)
