"""Odometry increments of camera steps (dp, dR), optical flow and wheels.

A step is in the body at its end, an increment at its beginning, dR = exp(a):   dp = dR p

Flow f and turn g, rad about x and y of a camera along the body's z, range r:

    dp = exp(g / 2) (r (f_y - g_y), -r (f_x - g_x), 0)         (an error of r: scale, `systematic`)

Steps are chained to a least duration. Wheels, rolled s, between counts:

    v((t_0 + t_1) / 2) = mean over the wheels of (s_1 - s_0) / (t_1 - t_0)
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from models import so3
from models.messages import Array, OdometryDelta, Reading, vec3

_GAP_NS, _JITTER_NS = 5_000_000, 20_000_000  # between steps that follow each other: half a step, within these
_CAMERA_NS, _FLOW_NS = 475_000_000, 190_000_000  # an increment lasts at least so long
_LONGEST_NS: Final = 2_000_000_000
_SCALE_SHARE: Final = 0.03  # of a flow: its lens, and the slope of the ground
_FLOW_RAD_S: Final = 0.15  # white, of one message (EKF2_OF_N_MIN of PX4, EK3_FLOW_M_NSE of ArduPilot)
_NOT_GIVEN: Final = -1.0
_FINDER_SHARE: Final = 0.02  # 1-sigma of a range finder
LEAST_RANGE_M: Final = 0.05
SEEN_FROM_OUTSIDE: Final = frozenset({0, 1, 2, 3, 7})  # MAV_ESTIMATOR_TYPE of ODOMETRY: unknown, naive, vision, VIO, lidar.
# The others rest on GNSS, or are an autopilot's own
_WHEEL_NS: Final = 100_000_000  # of a speed, at least: a step of an encoder is some millimetres
_FARTHEST_M: Final = 1e9
_WHEEL_SIGMA_M_S: Final = 0.1
_UNKNOWN_M2_S2: Final = 1e6  # of a velocity's component that wheels do not measure


class Range(NamedTuple):
    """Range along the body's down axis, 1-sigma, m; kind: source."""

    metres: float
    sigma_m: float
    kind: str


def measured_range(own_m: float, finder_m: float) -> Range | None:
    """The message's range, else a range finder's, or none."""
    for metres, kind in ((own_m, "flow"), (finder_m, "finder")):
        if LEAST_RANGE_M < metres < math.inf:
            return Range(metres, _FINDER_SHARE * metres, kind)
    return None


class Step(NamedTuple):
    """dp (3,) m, q (4,) from t0_ns to t_ns in the body at t0_ns; variance: of dp_x, dp_y, m^2."""

    t0_ns: int
    t_ns: int
    dp: Array
    q: Array
    variance: float = 0.0


class Chain:
    """Joins steps into consecutive increments without gaps."""

    def __init__(self, least_ns: int) -> None:
        self._least_ns = least_ns
        self._open: Step | None = None

    def add(self, step: Step) -> list[Step]:
        """Increments completed by this step."""
        before, done = self._open, list[Step]()
        jitter_ns = min(max(_GAP_NS, (step.t_ns - step.t0_ns) // 2), _JITTER_NS)
        if before is not None and abs(step.t0_ns - before.t_ns) > jitter_ns:
            done, before = ([before] if step.t0_ns > before.t_ns else []), None
        joined = step if before is None else _joined(before, step)
        self._open = None if joined.t_ns - joined.t0_ns >= self._least_ns else joined
        return done if self._open else [*done, joined]


def _joined(a: Step, b: Step) -> Step:
    dp = a.dp + so3.matrix(a.q) @ b.dp
    return Step(a.t0_ns, b.t_ns, dp, so3.normalise(so3.multiply(a.q, b.q)), a.variance + b.variance)


class CameraSteps:
    """OdometryDeltas of a camera's steps, on one topic."""

    def __init__(self, topic: str) -> None:
        self._chain, self._topic = Chain(_CAMERA_NS), topic

    def add(self, t_ns: int, dt_ns: int, turn: Array, moved: Array) -> list[OdometryDelta]:
        """turn (3,) rad, moved (3,) m over dt_ns before t_ns. Raises ValueError."""
        if not (np.isfinite(turn).all() and np.isfinite(moved).all() and 0 < dt_ns <= _LONGEST_NS):
            raise ValueError("is no motion over a time")
        q = so3.quat_exp(turn)
        steps = self._chain.add(Step(t_ns - dt_ns, t_ns, so3.matrix(q) @ moved, q))
        return [_delta(s, np.zeros((6, 6)), None, 0, self._topic) for s in steps]


class FlowSteps:
    """OdometryDeltas of an optical flow, on one topic."""

    def __init__(self, topic: str) -> None:
        self._chain, self._topic, self._epoch, self._range_kind = Chain(_FLOW_NS), topic, 0, ""

    def add(self, t_ns: int, dt_ns: int, seen: Array, turn: Array, at: Range | None) -> list[OdometryDelta]:
        """seen (2,), turn (3,) rad over dt_ns before t_ns. Raises ValueError."""
        if not (np.isfinite(turn).all() and np.isfinite(seen).all() and 0 < dt_ns <= _LONGEST_NS):
            raise ValueError("is no flow over a time; a gyroscope's turn is needed, too")
        if at is None:
            raise ValueError("no range: neither a range finder nor [visual_odometry] ground_m gives one")
        if at.kind != self._range_kind:
            self._chain, self._epoch, self._range_kind = Chain(_FLOW_NS), self._epoch + 1, at.kind
        f, g = seen.tolist(), turn.tolist()
        moved = at.metres * np.array([f[1] - g[1], g[0] - f[0], 0.0])
        variance = (at.metres * _FLOW_RAD_S * dt_ns * 1e-9) ** 2
        step = Step(t_ns - dt_ns, t_ns, so3.matrix(so3.quat_exp(0.5 * turn)) @ moved, so3.quat_exp(turn), variance)
        share = math.hypot(_SCALE_SHARE, at.sigma_m / at.metres)
        return [
            _delta(s, np.diag([s.variance] * 2 + [_NOT_GIVEN] * 4), share, self._epoch, self._topic)
            for s in self._chain.add(step)
        ]


def _delta(step: Step, covariance: Array, share: float | None, epoch: int, topic: str) -> OdometryDelta:
    """share: 1-sigma scale of x and y, or [odometry]'s."""
    systematic = None if share is None else np.array([[share * x] for x in (*step.dp[:2].tolist(), 0.0, 0.0, 0.0, 0.0)])
    w, x, y, z = step.q.tolist()
    return OdometryDelta(step.t_ns, step.t_ns, step.t0_ns, vec3(step.dp), (w, x, y, z), covariance, systematic, epoch, topic)


class Wheels:
    """Forward velocities of wheels on a topic; right, down not given."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._before: tuple[int, tuple[float, ...]] | None = None

    def add(self, t_ns: int, metres: Sequence[float]) -> list[Reading]:
        """metres: each wheel's total at t_ns; nan: lost. Raises ValueError."""
        now = tuple(metres)
        if any(abs(way) > _FARTHEST_M for way in now):
            raise ValueError("a wheel's distance is none")
        if not now or any(map(math.isnan, now)):
            self._before = None
            return []
        before = self._before
        if before is None or len(before[1]) != len(now) or not 0 < t_ns - before[0] <= _LONGEST_NS:
            self._before = t_ns, now
            return []
        if (dt_ns := t_ns - before[0]) < _WHEEL_NS:
            return []
        self._before = t_ns, now
        v = (sum(now) - sum(before[1])) / len(now) / (dt_ns * 1e-9)
        noise = np.diag([_WHEEL_SIGMA_M_S**2, _UNKNOWN_M2_S2, _UNKNOWN_M2_S2])
        return [Reading(t_ns - dt_ns // 2, t_ns, self._topic, "velocity_body", (v, 0.0, 0.0), noise)]
