"""Score of a configuration on a log: log-likelihood of held-out fixes.

Held out in windows, each once, against the estimate x, P:

    y = z [-] x,   S = P + R,   score = ln( (1 - eps) N(y; 0, S) + eps U )

A proper score (Gneiting & Raftery 2007, JASA 102); eps U: of a false fix, or without estimate.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import msgspec
import numpy as np

from estimator.config import Config, parse
from estimator.frontend.requests import prior_at
from estimator.fusion import Fusion
from estimator.sources.base.aid import FALSE_ATTITUDE_RAD, FALSE_POSITION_M
from estimator.sources.pose import given_components
from estimator.tools.fleet.store import local_path
from logs.evaluation.trajectory import POSE_TYPES, Trajectory, decode
from logs.store.reader import LogError, LogReader
from logs.wire import axes
from models import so3
from models.frames import Origin
from models.messages import Array, Estimate, GnssFix, GnssVelocity, Input, LandmarkFix, PoseFix, Reading, vec3

_SETTLE_S: Final = 15.0  # after the first absolute fix nothing is held back
_NEAR_NS: Final = 200_000_000  # an estimate further away is not used for that time
_FALSE: Final = math.log(0.05)
_LOG_BOX: Final = np.log(2.0 * np.array([FALSE_POSITION_M] * 3 + [FALSE_ATTITUDE_RAD] * 3))
_TRUTH: Final = np.diag([0.01**2] * 3 + [np.deg2rad(0.1) ** 2] * 3)  # m^2, rad^2: of a truth without one
_TRUTH_EVERY_NS: Final = 500_000_000
_INSIDE95: Final = 7.814728  # chi-square, 3 degrees of freedom
_GIVEN_M2: Final = 9e4

Absolute = PoseFix | LandmarkFix | GnssFix


class Job(msgspec.Struct, frozen=True):
    """values: "section.key" -> number replacing those of `config` (TOML).

    outage_s: of windows and between them; truth: topic of poses instead of fixes.
    """

    log: str
    config: str
    values: dict[str, float]
    outage_s: float = 10.0
    truth: str = ""


class Window(msgspec.Struct, frozen=True):
    """Comparisons, mean score, probably false; of the others sums of y^T S^-1 y, dof, squared errors; covered: within 95 %."""

    start_s: float
    n: int
    score: float
    false: int
    nis: float
    dof: int
    p_sq_m2: float
    covered: int


class _Log(NamedTuple):
    messages: list[Input]
    truth: Trajectory | None


def score(job: Job) -> list[Window]:
    """Windows of a log. Raises LogError with nothing to compare."""
    config = with_values(parse(job.config), job.values)
    messages, truth = _read(job.log, job.config, job.truth)
    begin_ns = min((m.t_ns for m in messages if isinstance(m, Absolute)), default=0) + round(_SETTLE_S * 1e9)
    windows: list[Window] = []
    for fold in (0, 1):
        rows: dict[int, list[_Comparison]] = {}
        stretch = _Stretches(begin_ns, round(job.outage_s * 1e9), fold)
        shown = [m for m in messages if not stretch.held_back(m)]
        wanted = _wanted(messages, truth, stretch, round(config.gnss.delay_s * 1e9))
        for z, estimate in zip(wanted, _estimates(config, shown, [z.t_ns for z in wanted]), strict=True):
            rows.setdefault(stretch.number(z.t_ns), []).append(_compare(z, estimate, config))
        windows += [_window(_SETTLE_S + k * job.outage_s, rows[k]) for k in sorted(rows)]
    if not windows:
        raise LogError(f"{job.log}: no absolute fix to hold back (it is too short, or has none on the topics of [inputs])")
    return windows


class _Stretches(NamedTuple):
    """Every other stretch is a window, in two folds."""

    begin_ns: int
    period_ns: int
    fold: int

    def number(self, t_ns: int) -> int:
        return (t_ns - self.begin_ns) // self.period_ns

    def held_back(self, m: Input) -> bool:
        k = self.number(m.t_ns)
        return isinstance(m, Absolute | GnssVelocity) and k >= 0 and k % 2 == self.fold


def _wanted(messages: Sequence[Input], truth: Trajectory | None, stretch: _Stretches, gnss_late_ns: int) -> list[Absolute]:
    if truth is not None:
        return [z for z in _truths(truth) if z.t_ns >= stretch.begin_ns]
    held = [_at_validity(m, gnss_late_ns) for m in messages if isinstance(m, Absolute) and stretch.held_back(m)]
    return sorted(held, key=lambda z: z.t_ns)


def sources(log: str, config: str) -> frozenset[str]:
    """Sections that judge the log's absolute fixes, and those of the air in use."""
    named: dict[type[Input], str] = {PoseFix: "pose_fix", LandmarkFix: "landmark_fix", GnssFix: "gnss"}
    drag, messages = parse(config).drag.enabled, _read(log, config, "").messages
    in_air = drag or any(isinstance(m, Reading) and m.kind == "airspeed" for m in messages)
    found = {named[type(m)] for m in messages if type(m) in named}
    return frozenset(found | ({"drag"} if drag else set()) | ({"wind"} if in_air else set()))


def _at_validity(z: Absolute, late_ns: int) -> Absolute:
    return msgspec.structs.replace(z, t_ns=z.t_ns - late_ns) if isinstance(z, GnssFix) else z


def with_values(config: Config, values: dict[str, float]) -> Config:
    """The configuration with these keys changed."""
    for name, value in values.items():
        section, _, key = name.partition(".")
        changed = msgspec.structs.replace(getattr(config, section), **{key: value})
        config = msgspec.structs.replace(config, **{section: changed})
    return config


@lru_cache(maxsize=16)
def _read(log: str, config: str, truth: str) -> _Log:
    decoder = parse(config).decoder()
    messages: list[Input] = []
    data: list[bytes] = []
    arrived: list[int] = []
    schema = ""
    with LogReader(local_path(log)) as reader:
        for record in reader:
            if message := decoder.decode(record.topic, record.schema, record.data, record.log_time_ns):
                messages.append(message)
            elif truth and record.topic == truth:
                schema = record.schema
                data.append(record.data)
                arrived.append(record.log_time_ns)
    if truth and schema not in POSE_TYPES:
        raise LogError(f"{log}: {truth} " + (f"holds {schema}, not poses" if schema else "is not in it"))
    return _Log(messages, decode(schema, data, arrived) if truth else None)


def _truths(truth: Trajectory) -> Iterator[PoseFix]:
    last = -1
    for k, t_ns in enumerate(truth.t_ns.tolist()):
        if t_ns // _TRUTH_EVERY_NS == last or not np.isfinite(truth.p[k]).all():
            continue
        last = t_ns // _TRUTH_EVERY_NS
        q, covariance = truth.q_wxyz[k], truth.covariance[k]
        given = np.isfinite(covariance).all() and np.all(np.diag(covariance) > 0.0)
        noise = covariance if given else _TRUTH.copy()
        if not np.isfinite(q).all():
            q, noise = np.array([1.0, 0.0, 0.0, 0.0]), np.diag([*np.diag(noise)[:3], np.inf, np.inf, np.inf])
        q_nb = axes.attitude((float(q[0]), float(q[1]), float(q[2]), float(q[3])))
        yield PoseFix(t_ns, t_ns, axes.world(vec3(truth.p[k])), q_nb, axes.world_covariance(noise), topic="")


def _estimates(config: Config, messages: Sequence[Input], wanted_ns: Sequence[int]) -> list[Estimate | None]:
    fusion = Fusion(config.fusion())
    found: list[Estimate | None] = []
    before: Estimate | None = None
    for message in messages:
        for output in fusion.handle(message):
            if not isinstance(output, Estimate):
                continue
            while len(found) < len(wanted_ns) and wanted_ns[len(found)] <= output.t_ns:
                found.append(_nearer(wanted_ns[len(found)], before, output))
            before = output
    found += [_nearer(t_ns, before, before) for t_ns in wanted_ns[len(found) :]]
    return found


def _nearer(t_ns: int, before: Estimate | None, after: Estimate | None) -> Estimate | None:
    near = [e for e in (before, after) if e is not None and abs(e.t_ns - t_ns) <= _NEAR_NS]
    return min(near, key=lambda e: abs(e.t_ns - t_ns), default=None)


class _Comparison(NamedTuple):
    score: float
    false: bool
    nis: float = 0.0
    dof: int = 0
    p_sq_m2: float = 0.0
    covered: bool = False


def _compare(z: Absolute, estimate: Estimate | None, config: Config) -> _Comparison:
    rows = np.arange(3) if isinstance(z, GnssFix) else given_components(z.covariance).rows
    worst = _FALSE - float(_LOG_BOX[rows].sum())
    if estimate is None:
        return _Comparison(worst, false=True)
    p_n, q, covariance = prior_at(estimate, z.t_ns)
    if isinstance(z, GnssFix):
        y, noise = _gnss(z, p_n, q, estimate, config)
    else:
        turn = so3.multiply(so3.normalise(np.array(z.q_nb_wxyz)), so3.conjugate(q))
        y, noise = np.concatenate((np.array(z.p_n) - p_n, so3.quat_log(turn))), _noise(z, config)
    y, S = y[rows], (covariance[:3, :3] + noise if isinstance(z, GnssFix) else covariance + noise)[np.ix_(rows, rows)]
    _, log_det = np.linalg.slogdet(2.0 * np.pi * S)
    nis = float(y @ np.linalg.solve(S, y))
    likely = math.log1p(-math.exp(_FALSE)) - 0.5 * (nis + float(log_det))
    total = float(np.logaddexp(likely, worst))
    if likely < worst:
        return _Comparison(total, false=True)
    place = [k for k, row in enumerate(rows) if row < 3]
    covered = len(place) == 3 and float(y[place] @ np.linalg.solve(S[np.ix_(place, place)], y[place])) < _INSIDE95
    return _Comparison(total, False, nis, len(rows), float(y[place] @ y[place]), covered)


def _noise(z: PoseFix | LandmarkFix, config: Config) -> Array:
    rules = config.landmark_fix if isinstance(z, LandmarkFix) else config.pose_fix
    scale = rules.noise_scale if z.topic else 1.0  # the truth has no topic
    common = np.zeros((6, 6)) if z.covariance_common is None else z.covariance_common
    noise: Array = np.nan_to_num(z.covariance * scale**2 + common, nan=_GIVEN_M2, posinf=_GIVEN_M2)
    return noise


def _gnss(z: GnssFix, p_n: Array, q: Array, estimate: Estimate, config: Config) -> tuple[Array, Array]:
    origin, rules = Origin.of(estimate.origin), config.gnss
    if origin is None:
        return np.full(3, FALSE_POSITION_M), np.eye(3)
    antenna_n = p_n + so3.matrix(q) @ np.array(rules.antenna_b_m)
    noise = z.covariance_n
    if noise is None:
        noise = np.diag([rules.horizontal_sigma_m**2] * 2 + [rules.vertical_sigma_m**2])
    return np.array(origin.to_ned(z.lat_deg, z.lon_deg, z.alt_m)) - antenna_n, noise


def _window(start_s: float, some: list[_Comparison]) -> Window:
    return Window(
        start_s=start_s,
        n=len(some),
        score=math.fsum(c.score for c in some) / len(some),
        false=sum(c.false for c in some),
        nis=math.fsum(c.nis for c in some),
        dof=sum(c.dof for c in some),
        p_sq_m2=math.fsum(c.p_sq_m2 for c in some),
        covered=sum(c.covered for c in some),
    )
