"""Held values in motion: repeated readings, copies, zeros."""

from typing import Final

import numpy as np

from logs.findings.streams import FIX, IMU, POSE, VELOCITY, Cause, Stream, runs
from models.messages import Array

_HELD_S: Final = 2.0
_IMU_HELD_S: Final = 0.2
_LIVELY: Final = 0.5  # of the readings differ from the one before
_MOVING_M_S: Final = 1.0
_MOVED_M: Final = 5.0  # while it was held
_TURNED_RAD: Final = 0.2  # likewise
_SWAY_S, _SWAYING_RAD_S = 0.25, 0.1
_STANDING_S, _STANDING_M = 10.0, 20.0
_REGULAR: Final = 0.7  # of the runs
_AGAIN: Final = 0.4  # of all messages
_EVIDENCE: Final = (IMU, FIX, VELOCITY, POSE)  # of which copies count
_EARTH_M: Final = 111_320.0  # a degree of latitude


def zero(stream: Stream) -> Cause | None:
    """Every reading is exactly zero; a velocity may be."""
    if stream.kind in (FIX, VELOCITY, "velocity_body") or stream.values.any():
        return None
    return Cause("all its readings are 0", float(stream.arrived_s[0]), "its driver gives no data: mend it, or leave it out")


def held(stream: Stream, imu: Stream | None) -> Cause | None:
    """A reading repeats to the bit for > 2 s (IMU 0.2 s) in motion, and varied before."""
    same = np.all(np.diff(stream.values[:, _measured(stream)], axis=0) == 0.0, axis=1)
    spans = runs(same)
    if not len(spans):
        return None
    long_s = stream.arrived_s[spans[:, 1]] - stream.arrived_s[spans[:, 0]]
    k = int(np.argmax(long_s))
    first, last = spans[k].tolist()
    outside = np.concatenate([same[:first], same[last:]])
    usual_s = float(np.quantile(np.delete(long_s, k), 0.9)) if len(long_s) > 5 else 0.0
    if long_s[k] < max(_IMU_HELD_S if stream.kind == IMU else _HELD_S, 5.0 * usual_s) or last - first < 3:
        return None
    if len(outside) < 10 or 1.0 - outside.mean() < _LIVELY or not _moves(stream, imu, first, last):
        return None
    what = f"it repeats one reading for {long_s[k]:.1f} s under new stamps"
    return Cause(what, float(stream.arrived_s[first]), "its sender holds the last value: let it be silent then")


def standing(fix: Stream, imu: Stream | None) -> Cause | None:
    """Latitude or longitude repeats to the bit for > 10 s while the other moves, or both while the vehicle sways."""
    east = _EARTH_M * np.cos(np.radians(fix.values[0, 0]))
    still = np.diff(fix.values[:, :2], axis=0) == 0.0
    for names, same in (("latitude and longitude", still.all(axis=1)), ("latitudes", still[:, 0]), ("longitudes", still[:, 1])):
        for first, last in runs(same).tolist():
            long_s = float(fix.arrived_s[last] - fix.arrived_s[first])
            way_m = float((np.ptp(fix.values[first : last + 1, :2], axis=0) * [_EARTH_M, east]).max())
            moves = way_m > _STANDING_M or (way_m == 0.0 and imu is not None and _sways(fix, imu, first, last))
            if long_s > _STANDING_S and moves:
                what = f"its {names} stay to the last digit for {long_s:.1f} s, while the vehicle moves"
                return Cause(what, float(fix.arrived_s[first]), "see its columns; write degrees with 8 digits behind the point")
    return None


def placeless(pose: Stream) -> Cause | None:
    """A position repeats to the bit for > 10 s, while its attitude turns by > 0.2 rad."""
    for first, last in runs(np.all(np.diff(pose.values[:, :3], axis=0) == 0.0, axis=1)).tolist():
        long_s = float(pose.arrived_s[last] - pose.arrived_s[first])
        cosine = float(np.abs(pose.values[first : last + 1, 3:] @ pose.values[first, 3:]).min())
        if long_s > _STANDING_S and 2.0 * np.arccos(min(cosine, 1.0)) > _TURNED_RAD:
            what = f"its position stays to the last digit for {long_s:.1f} s, while its attitude turns"
            return Cause(what, float(pose.arrived_s[first]), "its source gives no position: leave it out")
    return None


def again(stream: Stream) -> Cause | None:
    """Messages come again with stamp and reading."""
    same = (np.diff(stream.t_s) == 0.0) & np.all(np.diff(stream.values, axis=0) == 0.0, axis=1)
    if same.all() or same.mean() < _AGAIN:
        return None
    what = f"each of its messages comes {round(1.0 / (1.0 - same.mean()))} times"
    return Cause(
        what,
        float(stream.arrived_s[0]),
        "two senders or bridges write this topic, or one sends faster than it measures: stop one, or slow it down",
    )


def copies(stream: Stream) -> Cause | None:
    """Each reading appears m >= 2 times under own stamps, mostly in equal runs."""
    if stream.kind not in _EVIDENCE:
        return None
    same = np.all(np.diff(stream.values[:, _measured(stream)], axis=0) == 0.0, axis=1)
    new_stamp = np.diff(stream.t_s) > 0.0
    changes = np.flatnonzero(~same)
    if len(changes) < 10 or not new_stamp.mean() > _LIVELY:
        return None
    lengths = np.diff(changes)
    times = float(np.median(lengths))
    if times < 2.0 or np.mean(lengths == times) < _REGULAR:
        return None
    hz = len(changes) / max(float(np.ptp(stream.arrived_s)), 1e-9)
    what = f"each reading stands {times:.0f} times under stamps of its own: {hz:.0f} Hz repeated"
    return Cause(what, float(stream.arrived_s[0]), "send each measurement once: copies count as evidence of their own")


def _measured(stream: Stream) -> slice:
    return slice(0, 3) if stream.kind == FIX else slice(None)


def _moves(stream: Stream, imu: Stream | None, first: int, last: int) -> bool:
    """Receiver: at > 1 m/s before, 5 m away behind, or swaying; magnetometer: the IMU turns; others: it changes."""
    if stream.kind in (IMU, "range"):  # the height above the ground may stay as it is
        return stream.kind == IMU
    if stream.kind == VELOCITY and float(np.linalg.norm(stream.values[first])) > _MOVING_M_S:
        return True
    if stream.kind in (FIX, VELOCITY) and imu is not None and _sways(stream, imu, first, last):
        return True
    if stream.kind == VELOCITY:
        return False
    if stream.kind == FIX:
        after = min(last + 1, len(stream.t_s) - 1)
        speed = max(_speed(stream, max(0, first - 10), first), _speed(stream, first, last))
        return speed > _MOVING_M_S or _way(stream, last, after) > _MOVED_M
    if imu is None:
        return False
    rows = (imu.arrived_s >= stream.arrived_s[first]) & (imu.arrived_s <= stream.arrived_s[last])
    samples: Array = imu.values[rows]
    if len(samples) <= 3:
        return False
    if stream.kind == "magnetometer":
        turned_rad = np.linalg.norm(samples[:, :3].mean(axis=0)) * (stream.arrived_s[last] - stream.arrived_s[first])
        return bool(turned_rad > _TURNED_RAD)
    return float(np.mean(np.any(np.diff(samples, axis=0) != 0.0, axis=1))) > _LIVELY


def _sways(stream: Stream, imu: Stream, first: int, last: int) -> bool:
    """The vehicle turns to and fro, slower than its motors shake it, meanwhile: it is not on the ground."""
    rows = (imu.arrived_s >= stream.arrived_s[first]) & (imu.arrived_s <= stream.arrived_s[last])
    width = round(_SWAY_S * np.count_nonzero(rows) / max(float(stream.arrived_s[last] - stream.arrived_s[first]), 1e-9))
    if width < 2 or np.count_nonzero(rows) < 8 * width or not stream.values[first, :3].any():
        return False
    rate = imu.values[rows, :3]
    slow = rate[: len(rate) // width * width].reshape(-1, width, 3).mean(axis=1)
    return bool(np.linalg.norm(slow.std(axis=0)) > _SWAYING_RAD_S)


def _speed(fixes: Stream, first: int, last: int) -> float:
    dt = float(fixes.t_s[last] - fixes.t_s[first])
    return _way(fixes, first, last) / dt if dt > 0.2 else 0.0


def _way(fixes: Stream, first: int, last: int) -> float:
    east = _EARTH_M * np.cos(np.radians(fixes.values[first, 0]))
    return float(np.linalg.norm((fixes.values[last, :2] - fixes.values[first, :2]) * [_EARTH_M, east]))
