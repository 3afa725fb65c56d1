"""Odometry over MAVLink: ODOMETRY (reset_counter: a new frame), VISION_POSITION_DELTA, OPTICAL_FLOW_RAD, WHEEL_DISTANCE."""

import math
from typing import Any, Final

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from logs.wire.increments import SEEN_FROM_OUTSIDE, CameraSteps, FlowSteps, Range, Wheels
from models.messages import OdometryDelta, OdometryPose, Reading

_US_NS: Final = 1_000
_LEFT_UP: Final = frozenset({mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_ENU})  # the body's axes stay FRD


def camera(steps: CameraSteps, message: Any, t_ns: int) -> list[OdometryDelta]:
    """VISION_POSITION_DELTA; confidence 0: none. Raises ValueError."""
    angles, moved = np.array(message.angle_delta, dtype=float), np.array(message.position_delta, dtype=float)
    return steps.add(t_ns, message.time_delta_usec * _US_NS, angles, moved) if message.confidence > 0.0 else []


def flow(steps: FlowSteps, message: Any, t_ns: int, at: Range | None) -> list[OdometryDelta]:
    """OPTICAL_FLOW_RAD at range `at`; quality 0: none. Raises ValueError."""
    turn = np.array([message.integrated_xgyro, message.integrated_ygyro, message.integrated_zgyro])
    seen = np.array([message.integrated_x, message.integrated_y])
    return steps.add(t_ns, message.integration_time_us * _US_NS, seen, turn, at) if message.quality else []


def wheels(ways: Wheels, message: Any, t_ns: int) -> list[Reading]:
    """WHEEL_DISTANCE. Raises ValueError."""
    return ways.add(t_ns, message.distance[: message.count])


def pose(message: Any, t_ns: int, topic: str) -> OdometryPose | None:
    """ODOMETRY of a camera, lidar or wheels; None: of others; quality -1: lost. Raises ValueError."""
    if message.estimator_type not in SEEN_FROM_OUTSIDE:
        return None
    if message.quality < 0:
        return OdometryPose(t_ns, t_ns, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), topic=topic, is_lost=True)
    if message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
        raise ValueError(f"child_frame_id {message.child_frame_id}: BODY_FRD is expected")
    if message.frame_id in _LEFT_UP:
        raise ValueError(f"frame_id {message.frame_id}: LOCAL_FRD or LOCAL_NED is expected")
    w, x, y, z = message.q
    if not all(map(math.isfinite, (message.x, message.y, message.z, w, x, y, z))):
        raise ValueError("its pose is not finite")
    frame = f"{message.get_srcComponent()} {message.frame_id} {message.reset_counter}"
    return OdometryPose(t_ns, t_ns, (message.x, message.y, message.z), (w, x, y, z), frame, topic)
