"""Odometry over MAVLink: poses (ODOMETRY), increments (VISION_POSITION_DELTA), and flow over a range (OPTICAL_FLOW_RAD).

ODOMETRY: a pose in a frame of its own, which ends where reset_counter moves.

VISION_POSITION_DELTA: the turn is that of the body, dR = exp(a). The translation is seen in the body as it is *now*:

    dp = dR p

OPTICAL_FLOW_RAD: the flow f and the turn g that a gyroscope saw over the same time, rad about x and y of a camera that looks down
along the body's z. At the range r (flow_range.py), half a turn later than where the step begins:

    dp = exp(g / 2) (r (f_y - g_y), -r (f_x - g_x), 0)

Only x and y are given. An error of r is an error of scale: it stays with the source (`systematic` of OdometryDelta).

Steps are chained to increments of at least a given time, so that clones and noise count per increment, not per message.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from estimator.service.mavlink.flow_range import Range
from models import so3
from models.messages import Array, OdometryDelta, OdometryPose, vec3

_US_NS: Final = 1_000
_SEEN: Final = frozenset(
    {
        mavlink.MAV_ESTIMATOR_TYPE_UNKNOWN,
        mavlink.MAV_ESTIMATOR_TYPE_NAIVE,
        mavlink.MAV_ESTIMATOR_TYPE_VISION,
        mavlink.MAV_ESTIMATOR_TYPE_VIO,
        mavlink.MAV_ESTIMATOR_TYPE_LIDAR,
    }
)  # the others rest on GNSS, or are an autopilot's own
_LEFT_UP: Final = frozenset({mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_ENU})  # the body's axes stay FRD
_GAP_NS: Final = 5_000_000  # between two steps that are one after the other
_JOINED_NS: Final = {"VISION_POSITION_DELTA": 475_000_000, "OPTICAL_FLOW_RAD": 190_000_000}  # an increment lasts at least so long
_LONGEST_US: Final = 2_000_000
_SCALE_SHARE: Final = 0.03  # of a flow: its lens, and the slope of the ground
_FLOW_RAD_S: Final = 0.15  # white, of one message (EKF2_OF_N_MIN of PX4, EK3_FLOW_M_NSE of ArduPilot)
_NOT_GIVEN: Final = -1.0


class Step(NamedTuple):
    """dp (3,) m and q (4,) of the body at t_ns, seen in that at t0_ns; variance: of dp_x and dp_y, m^2."""

    t0_ns: int
    t_ns: int
    dp: Array
    q: Array
    variance: float = 0.0


class Chain:
    """Joins steps that follow each other, and puts out increments that neither overlap nor leave a step out."""

    def __init__(self, least_ns: int) -> None:
        self._least_ns = least_ns
        self._open: Step | None = None

    def add(self, step: Step) -> list[Step]:
        """The increments that have come to their end with this step."""
        before, done = self._open, list[Step]()
        if before is not None and abs(step.t0_ns - before.t_ns) > _GAP_NS:
            done, before = ([before] if step.t0_ns > before.t_ns else []), None
        joined = step if before is None else _joined(before, step)
        self._open = None if joined.t_ns - joined.t0_ns >= self._least_ns else joined
        return done if self._open else [*done, joined]


def _joined(a: Step, b: Step) -> Step:
    dp = a.dp + so3.matrix(a.q) @ b.dp
    return Step(a.t0_ns, b.t_ns, dp, so3.normalise(so3.multiply(a.q, b.q)), a.variance + b.variance)


class Increments:
    """OdometryDeltas of one kind of message, "VISION_POSITION_DELTA" or "OPTICAL_FLOW_RAD", on one topic."""

    def __init__(self, kind: str, topic: str) -> None:
        self._chain, self._topic, self._least_ns = Chain(_JOINED_NS[kind]), topic, _JOINED_NS[kind]
        self._epoch, self._range_kind = 0, ""

    def vision(self, message: Any, t_ns: int) -> list[OdometryDelta]:
        """VISION_POSITION_DELTA; a confidence of 0 is none. Raises ValueError for what is no motion."""
        angles, moved = np.array(message.angle_delta, dtype=float), np.array(message.position_delta, dtype=float)
        if not (np.isfinite(angles).all() and np.isfinite(moved).all() and 0 < message.time_delta_usec <= _LONGEST_US):
            raise ValueError("is no motion over a time")
        if not message.confidence > 0.0:
            return []
        q = so3.quat_exp(angles)
        t0_ns = t_ns - message.time_delta_usec * _US_NS
        return [self._delta(s, np.zeros((6, 6)), None) for s in self._chain.add(Step(t0_ns, t_ns, so3.matrix(q) @ moved, q))]

    def flow(self, message: Any, t_ns: int, at: Range | None) -> list[OdometryDelta]:
        """OPTICAL_FLOW_RAD, at the range `at`; a quality of 0 is none. Raises ValueError for what is no flow or has no range."""
        turn = np.array([message.integrated_xgyro, message.integrated_ygyro, message.integrated_zgyro])
        seen = np.array([message.integrated_x, message.integrated_y])
        if not (np.isfinite(turn).all() and np.isfinite(seen).all() and 0 < message.integration_time_us <= _LONGEST_US):
            raise ValueError("is no flow over a time; a gyroscope's turn is needed, too")
        if message.quality == 0:
            return []
        if at is None:
            raise ValueError("no range: neither a range finder nor [visual_odometry] ground_m gives one")
        if at.kind != self._range_kind:
            self._chain, self._epoch, self._range_kind = Chain(self._least_ns), self._epoch + 1, at.kind
        f, g = seen.tolist(), turn.tolist()
        moved = at.metres * np.array([f[1] - g[1], g[0] - f[0], 0.0])
        variance = (at.metres * _FLOW_RAD_S * message.integration_time_us * 1e-6) ** 2
        step = Step(
            t_ns - message.integration_time_us * _US_NS,
            t_ns,
            so3.matrix(so3.quat_exp(0.5 * turn)) @ moved,
            so3.quat_exp(turn),
            variance,
        )
        share = math.hypot(_SCALE_SHARE, at.sigma_m / at.metres)
        return [self._delta(s, np.diag([s.variance] * 2 + [_NOT_GIVEN] * 4), share) for s in self._chain.add(step)]

    def _delta(self, step: Step, covariance: Array, share: float | None) -> OdometryDelta:
        """share: 1-sigma of the scale of x and y, or as [odometry] has it."""
        systematic = None if share is None else np.array([[share * x] for x in (*step.dp[:2].tolist(), 0.0, 0.0, 0.0, 0.0)])
        w, x, y, z = step.q.tolist()
        return OdometryDelta(
            step.t_ns, step.t_ns, step.t0_ns, vec3(step.dp), (w, x, y, z), covariance, systematic, self._epoch, self._topic
        )  # fmt: skip


def pose(message: Any, t_ns: int, topic: str) -> OdometryPose | None:
    """ODOMETRY of a camera, lidar or wheels; None: of something else, or lost. Raises ValueError for what is no pose."""
    if message.estimator_type not in _SEEN or message.quality < 0:
        return None
    if message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
        raise ValueError(f"child_frame_id {message.child_frame_id}: BODY_FRD is expected")
    if message.frame_id in _LEFT_UP:
        raise ValueError(f"frame_id {message.frame_id}: LOCAL_FRD or LOCAL_NED is expected")
    w, x, y, z = message.q
    if not all(map(math.isfinite, (message.x, message.y, message.z, w, x, y, z))):
        raise ValueError("its pose is not finite")
    frame = f"{message.get_srcComponent()} {message.frame_id} {message.reset_counter}"
    return OdometryPose(t_ns, t_ns, (message.x, message.y, message.z), (w, x, y, z), frame, topic)
