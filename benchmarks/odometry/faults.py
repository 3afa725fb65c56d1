"""What may be wrong with an odometry: each fault changes its poses, from some time of an outage on or all the time."""

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from msgspec.structs import replace

from models import so3
from models.messages import Array, Input, OdometryPose
from models.relative_pose import between

SECOND: Final = 1_000_000_000
TOPIC: Final = "/odometry"
BEGINS_NS: Final = 5 * SECOND  # into the outage

Poses = list[OdometryPose]
Fault = Callable[[Poses, int, int], Iterable[Input]]


def as_poses(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """Every pose as it came."""
    return poses


def jumping(poses: Poses, start_ns: int, _seed: int) -> Iterable[Input]:
    """5 s into the outage the odometry jumps by 1.2 m, 15 s into it by 0.25 m, without saying so."""
    late_ns = start_ns + 3 * BEGINS_NS
    for pose in poses:
        yield _moved(pose, (1.2 * (pose.t_ns > start_ns + BEGINS_NS), 0.25 * (pose.t_ns > late_ns), 0.0))


def drifting(rate_m_s: float, longest_s: float = 3600.0) -> Fault:
    """It drifts by so much from 5 s into the outage on; as half of a scene that moves at twice the rate draws it along."""

    def fault(poses: Poses, start_ns: int, _seed: int) -> Iterable[Input]:
        for pose in poses:
            seconds = np.clip((pose.t_ns - start_ns - BEGINS_NS) / SECOND, 0.0, longest_s)
            yield _moved(pose, (rate_m_s * float(seconds), 0.0, 0.0))

    return fault


def scaled(factor: float) -> Fault:
    """A wrong scale all the time."""
    return lambda poses, _start_ns, _seed: (_at(pose, factor * np.array(pose.p_o)) for pose in poses)


def scaled_within(factor: float) -> Fault:
    """A wrong scale from 5 s into the outage on."""

    def fault(poses: Poses, start_ns: int, _seed: int) -> Iterable[Input]:
        good = [pose for pose in poses if pose.t_ns <= start_ns + BEGINS_NS]
        at = np.array(good[-1].p_o) if good else np.zeros(3)
        yield from good
        for pose in poses[len(good) :]:
            yield _at(pose, at + factor * (np.array(pose.p_o) - at))

    return fault


def frozen(poses: Poses, start_ns: int, _seed: int) -> Iterable[Input]:
    """From 5 s into the outage on it repeats its pose."""
    last = poses[0]
    for pose in poses:
        last = pose if pose.t_ns <= start_ns + BEGINS_NS else last
        yield replace(pose, p_o=last.p_o, q_ob_wxyz=last.q_ob_wxyz)


def identity(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """It has never begun, and says that nothing has moved."""
    return (replace(pose, p_o=(0.0, 0.0, 0.0), q_ob_wxyz=(1.0, 0.0, 0.0, 0.0)) for pose in poses)


def turned(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """Its body's axes are turned by 90 degrees."""
    quarter = so3.from_euler(0.0, 0.0, 0.5 * np.pi)
    for pose in poses:
        w, x, y, z = so3.multiply(np.array(pose.q_ob_wxyz), quarter).tolist()
        yield replace(pose, q_ob_wxyz=(w, x, y, z))


def late_stamps(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """Its stamps are half a second late."""
    return (replace(pose, t_ns=pose.t_ns + SECOND // 2) for pose in poses)


def late(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """It arrives 3 s late."""
    return (replace(pose, arrived_ns=pose.t_ns + 3 * SECOND) for pose in poses)


def slow(poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """A pose a second."""
    newest_ns = -SECOND
    for pose in poses:
        if pose.t_ns - newest_ns >= SECOND:
            newest_ns = pose.t_ns
            yield pose


def restarted(poses: Poses, start_ns: int, _seed: int) -> Iterable[Input]:
    """5 s into the outage it begins anew at the origin, in a frame of the same name."""
    good = [pose for pose in poses if pose.t_ns <= start_ns + BEGINS_NS]
    yield from good
    at: Array | None = None
    for pose in poses[len(good) :]:
        now = np.array((*pose.p_o, *pose.q_ob_wxyz))
        at = now if at is None else at
        x, y, z, *q = between(at, now).tolist()
        yield replace(pose, p_o=(x, y, z), q_ob_wxyz=(q[0], q[1], q[2], q[3]))


def _moved(pose: OdometryPose, by: tuple[float, float, float]) -> OdometryPose:
    return _at(pose, np.array(pose.p_o) + by)


def _at(pose: OdometryPose, p: Array) -> OdometryPose:
    x, y, z = p.tolist()
    return replace(pose, p_o=(x, y, z))


FAULTS: Final[dict[str, tuple[Fault, str]]] = {
    "poses": (as_poses, "published VIO"),
    "jump": (jumping, "jumps of 1.2 and 0.25 m"),
    "drift_0.1": (drifting(0.1), "drift of 0.1 m/s from 5 s into the outage"),
    "drift_0.2": (drifting(0.2), "drift of 0.2 m/s from 5 s into the outage"),
    "drift_0.5": (drifting(0.5), "drift of 0.5 m/s from 5 s into the outage"),
    "scale": (scaled(1.1), "scale 1.1 all the time"),
    "scale_0.7": (scaled(0.7), "scale 0.7 all the time"),
    "scale_1.3": (scaled(1.3), "scale 1.3 all the time"),
    "scale_in": (scaled_within(1.1), "scale 1.1 from 5 s into the outage"),
    "scale_in_0.7": (scaled_within(0.7), "scale 0.7 from 5 s into the outage"),
    "scale_in_1.3": (scaled_within(1.3), "scale 1.3 from 5 s into the outage"),
    "frozen": (frozen, "the same pose from 5 s into the outage on"),
    "identity": (identity, "identity all the time"),
    "axes": (turned, "axes turned by 90 degrees"),
    "stamps": (late_stamps, "stamps 0.5 s late"),
    "restart": (restarted, "begins anew 5 s into the outage"),
    "slow": (slow, "1 Hz"),
    "late": (late, "arrives 3 s late"),
    "passing": (drifting(0.5, 4.0), "half of the scene moves at 1 m/s for 4 s, 5 s into the outage"),
}
