"""One flight, one perturbation, one size: through landfix and through the plain filter, scored against the truth."""

import math
from collections import Counter
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.flights.naive_filter import NaiveFilter
from benchmarks.flights.tasks import INSIDE95
from benchmarks.stress.flights import Flight, load_flight
from benchmarks.stress.perturbations import KINDS, Kind, rarer
from estimator.fusion import Fusion
from logs.evaluation.metrics import nees
from logs.evaluation.trajectory import nearest
from models.messages import AidStatus, Array, Estimate, ImuSample, Input, Reason
from models.state import E, X

Job: TypeAlias = tuple[str, str, float, int, str]  # flight, kind, size, seed, folder of the tasks

BURN_S = 10.0  # not scored: from the start, and from the first fix where fixes begin later
SETTLE_S = 2.0  # after an outage, counts as part of it
OVERCONFIDENT = 3.0  # times the 95 % radius
LEAST_MATCHED = 0.99  # of the truth stamps; a run with fewer estimates is not complete
_NEAR_NS = 100_000_000  # an estimate for every truth stamp that near; else there is none
_TRUTH_NS = 15_000_000  # an estimate is scored with a truth that near


class Score(msgspec.Struct, frozen=True):
    """Of one filter in one run. rmse_m, attitude_deg: outside outages; end_m: last error; nan: no estimate.

    overconfident, inside95: shares of the scored estimates whose error is beyond 3 times the radius, and inside the ellipsoid.
    """

    complete: bool
    rmse_m: float | None = None
    attitude_deg: float | None = None
    end_m: float | None = None
    overconfident: float = 0.0
    inside95: float | None = None


class Row(msgspec.Struct, frozen=True):
    """One cell of the table for one flight and seed; reasons: what became of the measurements of landfix, "topic reason"."""

    kind: str
    size: float
    flight: str
    seed: int
    landfix: Score
    naive: Score
    resets: int
    reasons: dict[str, int]


def run(job: Job) -> Row:
    """Perturb, estimate twice, score."""
    name, kind_name, size, seed, tasks = job
    kind = KINDS[kind_name]
    flight = load_flight(name, kind.aids, seed, Path(tasks))
    messages = perturbed(flight, kind, size, seed)
    from_s = BURN_S + kind.from_s + kind.period_s
    estimates, resets, reasons = landfix(messages, flight)
    ours, plain = (score(found, flight, from_s) for found in (estimates, naive(messages, flight)))
    return Row(kind_name, size, name, seed, ours, plain, resets, reasons)


def perturbed(flight: Flight, kind: Kind, size: float, seed: int) -> list[Input]:
    """The flight's messages in the world of this cell."""
    messages = kind.perturb(flight, size, np.random.default_rng(1000 + seed))
    return rarer(messages, kind.period_s, kind.from_s) if kind.period_s else messages


def landfix(messages: list[Input], flight: Flight) -> tuple[list[Estimate], int, dict[str, int]]:
    """Estimates as published, jumps, and the last decision about each measurement, counted by topic and reason."""
    fusion, estimates = Fusion(flight.config), list[Estimate]()
    decided: dict[tuple[str, str, int], Reason] = {}
    for message in messages:
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                estimates.append(output)
            elif isinstance(output, AidStatus):
                decided[output.topic, output.kind, output.t_ns] = output.reason
    counts = Counter(f"{topic} {reason}" for (topic, _, _), reason in decided.items())
    return estimates, estimates[-1].reset_counter if estimates else 0, dict(counts)


def naive(messages: list[Input], flight: Flight) -> list[Estimate]:
    """The plain filter's estimates at IMU stamps; they end where its numbers do. It ignores GNSS positions."""
    plain, estimates = NaiveFilter(flight.config.imu), list[Estimate]()
    with np.errstate(all="ignore"):
        for message in messages:
            try:
                plain.handle(message)
            except (np.linalg.LinAlgError, ValueError):
                break
            if isinstance(message, ImuSample) and plain.started:
                estimates.append(plain.estimate(message.arrived_ns))
    return estimates


def score(estimates: list[Estimate], flight: Flight, from_s: float) -> Score:
    """Position and attitude error, overconfidence and consistency from from_s seconds on."""
    scored_ns = flight.start_ns + round(from_s * 1e9)
    estimates = [e for e in _first_of_each_stamp(estimates) if e.t_ns >= scored_ns]
    if not estimates:
        return Score(complete=False)
    t_ns = np.array([e.t_ns for e in estimates])
    _, covered = nearest(t_ns, flight.t_ns[flight.t_ns >= scored_ns], _NEAR_NS)
    row, near = nearest(flight.t_ns, t_ns, _TRUTH_NS)
    nav, P = np.array([e.nav for e in estimates])[near], np.array([e.covariance for e in estimates])[near][:, E.P, E.P]
    row, t_s = row[near], (t_ns[near] - flight.start_ns) * 1e-9
    finite = np.isfinite(nav).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
    complete = bool(finite.all() and covered.mean() >= LEAST_MATCHED)
    nav, P, row, t_s = nav[finite], P[finite], row[finite], t_s[finite]
    if not len(nav):
        return Score(complete=False)
    error = _interpolated(flight, row, t_s) - nav[:, X.P]
    size, turned = np.linalg.norm(error, axis=1), _angle_deg(nav[:, X.Q], flight.R_nb[row])
    outside = ~np.any([(t_s > a) & (t_s < b + SETTLE_S) for a, b in flight.outages_s] or [t_s < 0.0], axis=0)
    radius = _reach(P)
    return Score(
        complete=complete,
        rmse_m=_rms(size[outside]),
        attitude_deg=_rms(turned[outside]),
        end_m=float(size[-1]),
        overconfident=float(np.mean(size > OVERCONFIDENT * radius)),
        inside95=float(np.mean(nees(error, P) < INSIDE95)),
    )


def errors(estimates: list[Estimate], flight: Flight, from_s: float) -> tuple[Array, Array, Array]:
    """Seconds, position error [m] and 95 % radius [m] of each estimate from from_s on that has a truth near."""
    scored_ns = flight.start_ns + round(from_s * 1e9)
    estimates = [e for e in _first_of_each_stamp(estimates) if e.t_ns >= scored_ns]
    t_ns = np.array([e.t_ns for e in estimates], np.int64)
    row, near = nearest(flight.t_ns, t_ns, _TRUTH_NS)
    chosen = [e for e, is_near in zip(estimates, near, strict=True) if is_near]
    t_s = np.asarray((t_ns[near] - flight.start_ns) * 1e-9, np.float64)
    if not chosen:
        return t_s, np.empty(0), np.empty(0)
    off = _interpolated(flight, row[near], t_s) - np.array([e.nav[X.P] for e in chosen])
    return t_s, np.linalg.norm(off, axis=1), _reach(np.array([e.covariance[E.P, E.P] for e in chosen]))


def _reach(P: Array) -> Array:
    """models.radius.reach of each of P (n, 3, 3)."""
    return np.asarray(np.sqrt(INSIDE95 * np.clip(np.linalg.eigvalsh(P)[:, -1], 0.0, None)))


def _first_of_each_stamp(estimates: list[Estimate]) -> list[Estimate]:
    first: dict[int, Estimate] = {}
    for e in estimates:
        first.setdefault(e.t_ns, e)
    return [first[t] for t in sorted(first)]


def _interpolated(flight: Flight, row: NDArray[np.intp], t_s: Array) -> Array:
    """True positions at t_s, next to the rows: the row's, moved with its velocity."""
    late = t_s - (flight.t_ns[row] - flight.start_ns) * 1e-9
    return np.asarray(flight.p_n[row] + flight.v_n[row] * late[:, None])


def _angle_deg(q_nb_wxyz: Array, R_nb: Array) -> Array:
    """Of the rotation between estimated and true attitudes, (n,)."""
    estimated = Rotation.from_quat(q_nb_wxyz, scalar_first=True)
    return np.degrees((estimated.inv() * Rotation.from_matrix(R_nb)).magnitude())


def _rms(x: Array) -> float | None:
    return math.sqrt(float(np.mean(x**2))) if len(x) else None
