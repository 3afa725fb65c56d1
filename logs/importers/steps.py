"""Odometry steps of a log to increments and velocities (increments.py)."""

from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from logs.importers.recording import Stream, Times
from logs.importers.settings import DELTA_TOPIC, FLOW_TOPIC
from logs.wire.increments import CameraSteps, FlowSteps, Wheels, measured_range
from logs.wire.sensors import SENSORS
from models.messages import Array, OdometryDelta, Reading

_OLD_NS = 500_000_000  # of a range


def camera(t_ns: Times, arrived_ns: Times, dt_ns: Times, turn: Array, moved: Array) -> list[Stream]:
    """turn (n, 3) rad, moved (n, 3) m, in the body at each step's end; nan rows dropped."""
    steps, made = CameraSteps(DELTA_TOPIC), list[tuple[int, OdometryDelta]]()
    for t, arrived, dt, a, p in zip(t_ns.tolist(), arrived_ns.tolist(), dt_ns.tolist(), turn, moved, strict=True):
        try:
            made += [(arrived, delta) for delta in steps.add(t, dt, a, p)]
        except ValueError:
            continue
    return _stream(DELTA_TOPIC, made)


def flow(
    t_ns: Times, arrived_ns: Times, dt_ns: Times, seen: Array, turn: Array, own_m: Array, streams: Iterable[Stream],
    notes: list[str],
) -> list[Stream]:  # fmt: skip
    """seen (n, 2), turn (n, 3) rad over dt_ns, own_m (n,): range; streams: IMU, range finder."""
    by_topic = {stream.topic: stream for stream in streams}
    imu = by_topic["/imu"]
    turn = np.where(np.isnan(turn), _turned(imu, t_ns - dt_ns, t_ns), turn)
    finder_m = _finder(by_topic.get(SENSORS["range"].topic), t_ns)
    steps, made, blind = FlowSteps(FLOW_TOPIC), list[tuple[int, OdometryDelta]](), 0
    rows = zip(
        t_ns.tolist(), arrived_ns.tolist(), dt_ns.tolist(), seen, turn, own_m.tolist(), finder_m.tolist(), strict=True
    )  # fmt: skip
    for t, arrived, dt, f, g, own, found in rows:
        at = measured_range(own, found)
        blind += at is None
        try:
            made += [(arrived, delta) for delta in steps.add(t, dt, f, g, at)]
        except ValueError:
            continue
    if blind:
        notes.append(f"{blind} of {len(t_ns)} messages of optical flow left out: no range to the ground at that time")
    return _stream(FLOW_TOPIC, made)


def wheels(t_ns: Times, arrived_ns: Times, metres: Array) -> list[Stream]:
    """metres (n, k): way of each wheel; nan row: lost."""
    topic = SENSORS["velocity_body"].topic
    ways, made = Wheels(topic), list[tuple[int, Reading]]()
    for t, arrived, way in zip(t_ns.tolist(), arrived_ns.tolist(), metres.tolist(), strict=True):
        try:
            made += [(arrived, reading) for reading in ways.add(t, way)]
        except ValueError:
            continue
    return _stream(topic, made)


def _stream(topic: str, made: list[tuple[int, OdometryDelta]] | list[tuple[int, Reading]]) -> list[Stream]:
    if not made:
        return []
    t_ns, arrived_ns = np.array([m.t_ns for _, m in made]), np.array([arrived for arrived, _ in made])

    def make(_: int, arrived: int, k: float) -> OdometryDelta | Reading:
        return replace(made[int(k)][1], arrived_ns=arrived)

    return [Stream(topic, t_ns, arrived_ns, (np.arange(len(made), dtype=float),), make)]


def _turned(imu: Stream, t0_ns: Times, t_ns: Times) -> Array:
    order = np.argsort(imu.t_ns, kind="stable")
    at, rate = imu.t_ns[order], imu.columns[0][order]
    seconds = (at - at[0]) * 1e-9
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(seconds)[:, np.newaxis], axis=0)])
    ends = [np.stack([np.interp((t - at[0]) * 1e-9, seconds, column) for column in angle.T], axis=1) for t in (t0_ns, t_ns)]
    return np.asarray(ends[1] - ends[0])


def _finder(stream: Stream | None, t_ns: Times) -> Array:
    if stream is None or not len(stream):
        return np.full(len(t_ns), np.nan)
    order = np.argsort(stream.t_ns, kind="stable")
    at, metres = stream.t_ns[order], stream.columns[0][order, 0]
    k = np.clip(np.searchsorted(at, t_ns), 1, max(1, len(at) - 1))
    k = np.where((k < len(at)) & (np.abs(at[np.minimum(k, len(at) - 1)] - t_ns) < np.abs(t_ns - at[k - 1])), k, k - 1)
    return np.where(np.abs(at[k] - t_ns) <= _OLD_NS, metres[k], np.nan)
