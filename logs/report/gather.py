"""Report data beyond the evaluation, same pass, bounded memory."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from rosbags.serde import SerdeError

from logs.evaluation.collected import ODOMETRY_TOPIC
from logs.evaluation.metrics import Indices, Times
from logs.evaluation.trajectory import Trajectory, decode
from logs.report.buckets import Buckets
from logs.store.reader import Record
from logs.wire import schemas
from logs.wire.codec import VISION_REQUEST_TOPIC, Decoder, decode_diagnostics, decode_vision_request
from logs.wire.stamps import stamp_of
from models.messages import Array, LandmarkFix, VisionReport, VisionRequest
from models.radius import horizontal_radius
from models.untrusted.toml_text import one_line

HEALTH_TOPIC, DAEMON_TOPIC = "/landfix/health", "/landfix/daemon"
FIX_TOPIC, VISION_TOPIC = "/landfix/fix", "/landfix/vision"
BIASES: Final = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
WEIGHTS: Final = ("IMU wrong", "receiver wrong", "fix false", "position wrong")
NUMBERS: Final = (
    "absolute_age_s",
    "radius95_m",
    "attitude_sigma_deg",
    "hypotheses",
    *BIASES,
    *(f"{name}_sigma" for name in BIASES),
    *WEIGHTS,
)
SIGMAS_95: Final = 1.959964  # of one axis

_BATCH: Final = 2048  # estimates decoded at a time
_DECADE: Final = 10  # bins
_SHORTEST_S, _LONGEST_S = 1e-4, 1e2
_OWN_WAY: Final = (ValueError, KeyError, SerdeError)  # bytes that are no message of their type


@dataclass(slots=True)
class Stretch:
    """A state from t_ns until the next."""

    t_ns: int
    state: str


@dataclass(slots=True)
class Traffic:
    """A topic: count, span, longest silence (arrivals)."""

    schema: str
    first_ns: int
    last_ns: int
    count: int = 0
    silence_ns: int = 0
    silent_from_ns: int = 0


@dataclass(slots=True)
class Frame:
    """A vision attempt: request and result."""

    request: VisionRequest | None = None
    report: VisionReport | None = None
    fix: LandmarkFix | None = None


class Histogram:
    """Counts of times in tenths of a decade, 0.1 ms to 100 s."""

    def __init__(self) -> None:
        decades = round(np.log10(_LONGEST_S / _SHORTEST_S))
        self.edges_s: Array = np.geomspace(_SHORTEST_S, _LONGEST_S, decades * _DECADE + 1)
        self.counts: Indices = np.zeros(len(self.edges_s) - 1, np.intp)

    def add(self, seconds: Array) -> None:
        """Count these times."""
        inside = np.clip(seconds, _SHORTEST_S * 1.001, _LONGEST_S * 0.999)
        self.counts += np.histogram(inside, self.edges_s)[0]


@dataclass
class Gathered:
    """see() takes records in order, then close().

    signals: position, velocity ENU, roll pitch heading (unwrapped deg), 1.96 sigma of each, 95 % radius; numbers: of health.
    """

    estimates: int = 0
    signals: Buckets | None = None
    numbers: Buckets | None = None
    latency: Histogram = field(default_factory=Histogram)
    steps: Histogram = field(default_factory=Histogram)
    states: dict[str, list[Stretch]] = field(default_factory=dict)
    details: list[Stretch] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    daemon: dict[str, str] = field(default_factory=dict)
    frames: dict[int, Frame] = field(default_factory=dict)
    traffic: dict[str, Traffic] = field(default_factory=dict)
    unreadable: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._decoder = Decoder()
        self._data: list[bytes] = []
        self._arrived_ns: list[int] = []
        self._heading_deg = 0.0
        self._last_ns: int | None = None
        self._handlers = {
            ODOMETRY_TOPIC: self._odometry,
            HEALTH_TOPIC: self._health,
            DAEMON_TOPIC: self._daemon,
            VISION_REQUEST_TOPIC: self._request,
            VISION_TOPIC: self._report,
            FIX_TOPIC: self._fix,
        }

    def see(self, record: Record) -> None:
        """The next record."""
        self._count(record)
        handler = self._handlers.get(record.topic)
        if handler is not None:
            try:
                handler(record)
            except _OWN_WAY:
                self.unreadable[record.topic] += 1

    def close(self) -> None:
        """End of the log."""
        self._flush()

    def _count(self, record: Record) -> None:
        traffic = self.traffic.get(record.topic)
        t_ns = record.log_time_ns
        if traffic is None:
            traffic = self.traffic[record.topic] = Traffic(record.schema, t_ns, t_ns)
        elif t_ns - traffic.last_ns > traffic.silence_ns:
            traffic.silence_ns, traffic.silent_from_ns = t_ns - traffic.last_ns, traffic.last_ns
        traffic.last_ns = max(traffic.last_ns, t_ns)
        traffic.count += 1

    # --- the estimate ---------------------------------------------------------------------------------------------------------

    def _odometry(self, record: Record) -> None:
        self._data.append(record.data)
        self._arrived_ns.append(record.log_time_ns)
        if len(self._data) == _BATCH:
            self._flush()

    def _flush(self) -> None:
        if not self._data:
            return
        estimate = decode(schemas.ODOMETRY, self._data, self._arrived_ns)
        self._data, self._arrived_ns = [], []
        if not len(estimate):
            return
        if self.signals is None:
            self.signals = Buckets(19, int(estimate.t_ns[0]))
        self.estimates += len(estimate)
        self.latency.add(seconds(estimate.arrived_ns - estimate.t_ns))
        since = [] if self._last_ns is None else [self._last_ns]
        self.steps.add(np.diff(seconds(np.concatenate([since, estimate.t_ns]).astype(np.int64), int(estimate.t_ns[0]))))
        self._last_ns = int(estimate.t_ns[-1])
        value = np.hstack([estimate.p, estimate.v, self._unwrapped(attitude_deg(estimate.q_wxyz))])
        radius = horizontal_radius(estimate.covariance[:, :2, :2])
        self.signals.add(estimate.t_ns, np.hstack([value, SIGMAS_95 * sigmas(estimate), radius[:, None]]))

    def _unwrapped(self, attitude: Array) -> Array:
        known = np.isfinite(attitude[:, 2])
        heading = np.unwrap(np.concatenate([[self._heading_deg], attitude[known, 2]]), period=360.0)[1:]
        attitude[known, 2] = heading
        if len(heading):
            self._heading_deg = float(heading[-1])
        return attitude

    # --- what it says about itself --------------------------------------------------------------------------------------------

    def _health(self, record: Record) -> None:
        t_ns, values = _diagnostics(record)
        self._enter(self.states.setdefault("mode", []), t_ns, values.get("mode", "unknown"))
        self._enter(self.details, t_ns, values.get("detail", ""))
        for key, value in values.items():
            kind, _, name = key.partition(" ")
            if kind == "sources":
                self._enter(self.states.setdefault(name, []), t_ns, value)
            elif kind == "counts":
                self.counts[name] = int(value)
        if self.numbers is None:
            self.numbers = Buckets(len(NUMBERS), t_ns)
        sections = ("", "biases ", "weights ")
        known = [float(next((values[s + name] for s in sections if s + name in values), "nan")) for name in NUMBERS]
        self.numbers.add(np.array([t_ns]), np.array([known]))

    def _daemon(self, record: Record) -> None:
        _, self.daemon = _diagnostics(record)

    @staticmethod
    def _enter(stretches: list[Stretch], t_ns: int, state: str) -> None:
        if not stretches or stretches[-1].state != state:
            stretches.append(Stretch(t_ns, state))

    # --- vision ---------------------------------------------------------------------------------------------------------------

    def _frame(self, t_ns: int) -> Frame:
        return self.frames.setdefault(t_ns, Frame())

    def _request(self, record: Record) -> None:
        request = decode_vision_request(record.data, record.log_time_ns)
        self._frame(request.t_ns).request = request

    def _report(self, record: Record) -> None:
        m: Any = schemas.STORE.deserialize_cdr(record.data, schemas.VISION_REPORT)
        t_ns = stamp_of(record.data) or 0
        self._frame(t_ns).report = VisionReport(
            t_ns, record.log_time_ns, one_line(m.outcome), one_line(m.detail), int(m.regions), int(m.candidates),
            tuple(map(one_line, m.landmarks)),
            tuple(m.similarities.tolist()), float(m.residual_px), float(m.processing_s),
        )  # fmt: skip

    def _fix(self, record: Record) -> None:
        fix = self._decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
        if isinstance(fix, LandmarkFix):
            self._frame(fix.t_ns).fix = fix


def attitude_deg(q_wxyz: Array) -> Array:
    """Roll, pitch (nose up), heading (clockwise from north) of FLU -> ENU, (n, 3) deg."""
    w, x, y, z = q_wxyz.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (x * z - w * y), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    degrees: Array = np.rad2deg(np.column_stack([roll, pitch, 0.5 * np.pi - yaw]))
    return degrees


def sigmas(estimate: Trajectory) -> Array:
    """Sigmas (n, 9): position, velocity ENU [m, m/s], roll, pitch, heading [deg]."""
    p = np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, :3]
    R_mb = _matrices(estimate.q_wxyz)
    v = np.einsum("nij,njk,nik->ni", R_mb, estimate.v_covariance, R_mb)
    yaw = np.arctan2(R_mb[:, 1, 0], R_mb[:, 0, 0])
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))
    about = np.stack([np.stack([c, s, zero], 1), np.stack([-s, c, zero], 1), np.stack([zero, zero, zero + 1.0], 1)], 1)
    theta = np.einsum("nij,njk,nik->ni", about, estimate.covariance[:, 3:, 3:], about)
    with np.errstate(invalid="ignore"):
        return np.hstack([np.sqrt(p), np.sqrt(v), np.rad2deg(np.sqrt(theta))])


def _matrices(q_wxyz: Array) -> Array:
    w, x, y, z = q_wxyz.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    R: Array = np.moveaxis(np.array(rows), 2, 0)
    return R


def _diagnostics(record: Record) -> tuple[int, dict[str, str]]:
    return stamp_of(record.data) or 0, decode_diagnostics(record.data)


def seconds(t_ns: Times | list[int], start_ns: int = 0) -> Array:
    """Time since start_ns."""
    return np.asarray((np.asarray(t_ns, np.int64) - start_ns) * 1e-9, float)
