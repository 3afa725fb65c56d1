"""Recorded flights and native logs from their beginning: when the estimate begins, and how good it is from then on.

python -m benchmarks.flights.starts

    before: s from the first position to the first estimate with a heading by GNSS alone, all that was published once
    begins, heading: the same to the first estimate, and to the first with a heading
    of the first 180 s since a position:
    error: horizontal, rms;   NEES = e' P^-1 e / 3 of position and attitude, once a second, in expectation 1

Each log as its import configures it; without the autopilot's attitude; and without its magnetometer, too. A car and a plane
besides with the course of GNSS. Reference is the log's own truth: RTK, or the autopilot's estimate, which has the same sensors.
The heading of umn_thor75's is wrong by up to 180 degrees until it takes off after 190 s.
"""

import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number
from estimator.config import Config, parse
from estimator.fusion import Fusion
from logs import importers
from logs.evaluation.trajectory import nearest
from logs.importers import Recording, Truth
from models.messages import Array, Estimate, GnssFix, Input, Mode
from models.state import E, X, local

_SECOND_NS: Final = 1_000_000_000
_NEAR_NS: Final = 60_000_000  # of an attitude of the reference
_HOLE_NS: Final = 600_000_000  # between two positions of it
_NEVER_S: Final = 1e6
_LONGEST_S: Final = 180.0  # from the first position on
_GLITCH: Final = "f450_glitch, copter"
_UNTIL_S: Final = {_GLITCH: 110.0}  # then its receiver fails

_THOR: Final = "umn_thor75, plane"
LOGS: Final = {
    "log171, copter": ("dataflash", "native_logs/ardupilot_log171.bin"),
    "quad106, copter": ("csv", "flights/inertialnav_logs/quad106"),
    _GLITCH: ("csv", "flights/inertialnav_logs/f450_glitch"),
    "flight_a, copter": ("csv", "flights/quad_rtk_dot/flight_a"),
    _THOR: ("csv", "flights/umn_thor75"),
    "drive_0708, car": ("csv", "flights/rtk_drive_walk/drive_0708"),
    "px4_sitl_v115": ("ulog", "native_logs/px4_sitl_v115_31s.ulg"),
    "px4_fmuv6c, in the hand": ("ulog", "native_logs/px4_fmuv6c_6s.ulg"),
}
_BY_RECEIVER: Final = frozenset({"drive_0708, car"})  # the reference is the receiver's, on its clock
_COURSES_DEG: Final = {_THOR: 15.0, "drive_0708, car": 5.0}  # the wind is 6 m/s

Change = Callable[[Config], Config]


class Recorded(NamedTuple):
    """A run: s, s, m, and NEES / 3."""

    begins_s: float
    heading_s: float
    error_m: float
    position: float
    attitude: float


def _inputs(**topics: tuple[str, ...]) -> Change:
    return lambda c: msgspec.structs.replace(c, inputs=msgspec.structs.replace(c.inputs, **topics))


def _begins(**keys: float) -> Change:
    return lambda c: msgspec.structs.replace(c, initialise=msgspec.structs.replace(c.initialise, **keys))


def _gnss_alone(config: Config) -> Config:
    return _inputs(attitude=(), magnetometer=(), heading=())(config)


def arms(name: str, config: Config) -> dict[str, Change]:
    """The configurations of a log; those that change nothing in it are left out."""
    found: dict[str, Change] = {"before": lambda c: _begins(publish_after_s=_NEVER_S)(_gnss_alone(c))}
    if config.inputs.attitude:
        found["as imported"] = lambda c: c
    if config.inputs.magnetometer:
        found["magnetometer"] = _inputs(attitude=())
    found["GNSS alone"] = _gnss_alone
    if name in _COURSES_DEG:
        found["GNSS with its course"] = lambda c: _begins(course_sigma_deg=_COURSES_DEG[name])(_gnss_alone(c))
    return found


def _read(name: str) -> tuple[Recording, Config]:
    kind, path = LOGS[name]
    source = data_folder() / path
    recording = importers.read(kind, source)
    return recording, parse(recording.settings.toml(kind, Path(source.name), tuple(s.topic for s in recording.streams)))


def jobs() -> list[tuple[str, str]]:
    """Logs and arms."""
    return [(name, arm) for name in LOGS for arm in arms(name, _read(name)[1])]


def start(job: tuple[str, str]) -> Recorded:
    """One run."""
    name, arm = job
    recording, config = _read(name)
    config = arms(name, config)[arm](config)
    given = config.inputs
    left_out = {"attitude": not given.attitude, "magnetometer": not given.magnetometer, "heading": not given.heading}
    messages = [m for m in recording if not isinstance(m, Truth) and not left_out.get(getattr(m, "kind", ""), False)]
    if not given.attitude:
        messages = [m for m in messages if type(m).__name__ != "AttitudePrior"]
    truth = [m for m in recording if isinstance(m, Truth)]
    if name == _THOR:
        truth = [msgspec.structs.replace(m, q_nb_wxyz=(math.nan,) * 4) for m in truth]
    if name in _BY_RECEIVER:
        late_ns = round(config.gnss.delay_s * 1e9)
        truth = [msgspec.structs.replace(m, t_ns=m.t_ns - late_ns) for m in truth]
    return _judged(messages, config, truth, _UNTIL_S.get(name, _LONGEST_S))


def _judged(messages: list[Input], config: Config, truth: list[Truth], until_s: float) -> Recorded:
    fusion, seconds = Fusion(config.fusion()), list[Estimate]()
    begins_s = heading_s = math.nan
    first_ns = next((m.t_ns for m in messages if isinstance(m, GnssFix) and m.status >= 0), None)
    for message in messages:
        if first_ns is None or message.arrived_ns > first_ns + round(until_s * 1e9):
            break
        for out in fusion.handle(message):
            if not isinstance(out, Estimate):
                continue
            since_s = (out.t_ns - first_ns) * 1e-9
            begins_s = since_s if math.isnan(begins_s) else begins_s
            if math.isnan(heading_s) and out.mode is not Mode.ALIGNING_HEADING:
                heading_s = since_s
            if not seconds or out.t_ns >= seconds[-1].t_ns + _SECOND_NS:
                seconds.append(out)
    return Recorded(begins_s, heading_s, *_errors(seconds, truth, has_origin=config.map.origin is not None))


def _errors(estimates: list[Estimate], truth: list[Truth], *, has_origin: bool) -> tuple[float, float, float]:
    """Horizontal error, and NEES/3 of position and attitude, where the reference gives them."""
    if not truth or not estimates:
        return math.nan, math.nan, math.nan
    t_ns = np.array([m.t_ns for m in truth], np.int64)
    p, q = np.array([m.p_n for m in truth]), np.array([m.q_nb_wxyz for m in truth])
    at_ns = np.array([e.t_ns for e in estimates], np.int64)
    squares, positions, attitudes = list[float](), list[float](), list[float]()
    with_p, with_q = np.isfinite(p).all(axis=1), np.isfinite(q).all(axis=1)
    row, near = (
        nearest(t_ns[with_q], at_ns, _NEAR_NS) if with_q.any() else (np.zeros(len(at_ns), int), np.zeros(len(at_ns), bool))
    )
    for k, e in enumerate(estimates):
        if near[k]:
            true = e.nav.copy()
            true[X.Q] = q[with_q][row[k]]
            attitudes.append(_nees(local(e.nav, true)[E.THETA], e.covariance[E.THETA, E.THETA]))
        after = int(np.searchsorted(t_ns[with_p], e.t_ns))
        if has_origin and 0 < after < with_p.sum() and t_ns[with_p][after] - t_ns[with_p][after - 1] < _HOLE_NS:
            ends = slice(after - 1, after + 1)
            off = e.nav[X.P] - [
                np.interp(float(e.t_ns - at_ns[0]), t_ns[with_p][ends] - at_ns[0], p[with_p][ends, i]) for i in range(3)
            ]
            squares.append(float(off[0] ** 2 + off[1] ** 2))
            positions.append(_nees(off, e.covariance[E.P, E.P]))
    rms = math.sqrt(float(np.mean(squares))) if squares else math.nan
    return rms, _mean(positions), _mean(attitudes)


def _nees(off: Array, cov: Array) -> float:
    return float(off @ np.linalg.solve(cov, off)) / 3.0


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def main() -> None:
    """A row for each log and configuration, in two processes."""
    found, rows = jobs(), []
    with ProcessPoolExecutor(2) as pool:
        for job, result in zip(found, pool.map(start, found), strict=True):
            rows.append((*job, *map(number, result)))
            print(*rows[-1], sep="  ", flush=True)
    columns = ("log", "with", "begins [s]", "heading [s]", "error [m]", "position NEES/3", "attitude NEES/3")
    print(Table("Starts of recorded flights and logs", columns, rows).markdown())


if __name__ == "__main__":
    main()
