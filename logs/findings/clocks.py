"""Faults of stamps against arrivals, offset = stamp - arrival."""

from typing import Final, NamedTuple

import numpy as np

from logs.findings.streams import IMU, Cause, Stream
from models.messages import Array

_FEW_DISTINCT: Final = 0.8  # of all stamps
_BATCH_WAIT: Final = 0.9  # of the span lies in the waits between batches
_LEAST_BATCHES: Final = 10
_ROUGH: Final = 0.02  # no quartz is off by 2 %
_DRIFT: Final = 5e-4  # nor, without fault, by 500 ppm
_LEAST_SPAN_S: Final = 3.0
_DRIFTED_S: Final = 0.1
_SIGNIFICANT: Final = 8.0  # standard errors
_STEP_S: Final = 0.1
_STEP_WINDOW_S: Final = 2.0
_TOGETHER_S: Final = 3.0  # receivers of 1 Hz
_STEADY: Final = 0.2  # of a step: what offsets scatter before and after it
_IMU_AHEAD_S, _AHEAD_S = 0.05, 0.3  # a delay as typed, or estimated, may be as large
_IMU_LATE_S, _LATE_S = 0.5, 6.0  # later measurements are too old for the default history
_DISORDER: Final = 0.02  # of all stamps
_LOST: Final = 0.08  # of all samples
_WHOLE, _REGULAR = 0.2, 0.9  # of a period; of all steps
_SILENT_S: Final = 1.0
_ENDED_S: Final = 3.0
_DIGITS: Final = "write the time with all its digits (nanoseconds or float64 seconds)"
_KNOWN_STEPS: Final = (  # s, tolerance, name
    (2.0**32 * 1e-6, 0.5, "a 32-bit counter of microseconds has wrapped"),
    (2.0**32 * 1e-3, 0.5, "a 32-bit counter of milliseconds has wrapped"),
    (2.0**32 * 1e-9, 0.05, "a 32-bit counter of nanoseconds has wrapped"),
    (86_400.0, 0.5, "midnight"),
    (604_800.0, 0.5, "a GPS week"),
    (18.0, 0.3, "GPS time against UTC"),
    (315_964_800.0 - 18.0, 60.0, "GPS time against Unix time"),
    (3600.0, 1.0, "a time zone"),
)


class _Line(NamedTuple):
    slope: float
    error: float
    scatter: float


def few_stamps(stream: Stream) -> Cause | None:
    """Distinct stamps / samples < 0.8 with changing values."""
    n, distinct = len(stream.t_s), len(np.unique(stream.t_s))
    if distinct == 1:
        return Cause(f"all {n} stamps are the same", float(stream.arrived_s[0]), "let the sender set header.stamp", unfit=True)
    if distinct >= _FEW_DISTINCT * n:
        return None
    changed = np.any(np.diff(stream.values, axis=0) != 0.0, axis=1)[np.diff(stream.t_s) == 0.0]
    if not len(changed) or changed.mean() < 0.5:
        return None  # copies
    return Cause(f"{n} stamps have {distinct} values", float(stream.arrived_s[0]), _DIGITS, unfit=True)


def sawtooth(stream: Stream) -> Cause | None:
    """Stamps repeatedly fall back by one amount."""
    steps = np.diff(stream.t_s)
    back = np.flatnonzero(steps < -0.05)
    if len(back) < 3:
        return None
    fall = float(np.median(steps)) - float(np.median(steps[back]))
    period = float(np.median(np.diff(stream.arrived_s[back])))
    if _spread(steps[back]) > 0.1 * fall or abs(period - fall) > 0.1 * fall:
        return None
    what = (
        "only the nanoseconds of its stamps are set" if abs(fall - 1.0) < 0.05 else "a part of the time is missing in its stamps"
    )
    return Cause(f"its stamps fall back by {fall:.2f} s again and again: {what}", float(stream.arrived_s[0]), _DIGITS)


def two_clocks(stream: Stream) -> Cause | None:
    """Two offset groups, 10 x scatter and 50 ms apart, 10 changes."""
    offset = _offset(stream)
    ordered = np.sort(offset)
    k = int(np.argmax(np.diff(ordered))) + 1
    low, high = ordered[:k], ordered[k:]
    apart = float(np.median(high) - np.median(low))
    if min(len(low), len(high)) < 0.1 * len(ordered) or apart < max(0.05, 10.0 * max(_spread(low), _spread(high))):
        return None
    changes = int(np.count_nonzero(np.diff(offset > ordered[k - 1])))
    backward = int(np.count_nonzero(np.diff(stream.t_s) < -0.5 * apart))
    if changes < 10 or backward < 5:
        return None
    what = f"its stamps are of two clocks, {apart:.2f} s apart, in turn"
    return Cause(what, float(stream.arrived_s[0]), "two senders write this topic: give each a topic of its own")


def batches(stream: Stream) -> Cause | None:
    """Steps > 5 x median, 10 or more, hold > 90 % of the span."""
    steps = np.diff(stream.t_s)
    waits = np.flatnonzero(steps > 5.0 * max(float(np.median(steps)), 0.0))
    span = float(stream.t_s[-1] - stream.t_s[0])
    if stream.kind != IMU or len(waits) < _LEAST_BATCHES or span <= 0.0 or steps[waits].sum() < _BATCH_WAIT * span:
        return None
    size = round(float(np.median(np.diff(waits))))
    if size < 2:
        return None
    return Cause(
        f"samples come in batches of {size}, stamped on arrival", float(stream.arrived_s[0]),
        "let the driver stamp each sample with its own time of measurement",
    )  # fmt: skip


def together(stream: Stream, others: list[Stream]) -> Cause | None:
    """The stamps of an IMU and of all others jump by one amount at one time."""
    found = _jump(stream) if stream.kind == IMU else None
    if found is None:
        return None
    at, size = found
    since_s = float(stream.arrived_s[at])
    for other in others:
        k, theirs = _jump(other) or (0, 0.0)
        if abs(theirs - size) > _STEADY * abs(size) or abs(other.arrived_s[k] - since_s) > _TOGETHER_S:
            return None
    what = f"its stamps jump by {size:+.2f} s" + (", and those of all others with them" if others else " and stay")
    return Cause(what, since_s, "the log was played again, or the clock of the machine was set: cut it there")


def step(stream: Stream, others: list[Stream]) -> Cause | None:
    """Stamps jump by > 0.1 s, steady for 2 s before and after."""
    found = _jump(stream)
    if found is None or not _agree(others):
        return None
    at, size = found
    name = _known(size)
    return Cause(
        f"its stamps jump by {size:+.2f} s and stay" + (f": {name}" if name else ""), float(stream.arrived_s[at]),
        "the sender's clock was set or wrapped: add the step to its later stamps, or cut the log there",
    )  # fmt: skip


def _jump(stream: Stream) -> tuple[int, float] | None:
    """Row and size [s] of a step of the offset."""
    offset = _offset(stream)
    width = max(5, round(_STEP_WINDOW_S * len(offset) / max(float(np.ptp(stream.arrived_s)), 1e-9)))
    at = int(np.argmax(np.abs(np.diff(offset)))) + 1
    if at < width or at > len(offset) - width:
        return None
    before, after = offset[at - width : at], offset[at : at + width]
    size = float(np.median(after) - np.median(before))
    rhythm = np.diff(stream.t_s)
    leap = rhythm[at - 1] - float(np.median(rhythm))
    usual = float(np.quantile(np.abs(np.diff(offset)), 0.98))
    steady = max(_spread(before), _spread(after)) < _STEADY * abs(size)
    if abs(size) < max(_STEP_S, 3.0 * usual) or abs(leap - size) > 0.5 * abs(size) or not steady:
        return None
    return at, size


def rate(stream: Stream, others: list[Stream]) -> Cause | None:
    """k = 1 + slope of the offset, |k - 1| > 500 ppm and significant, others regular."""
    line = _line(stream)
    if line is None or not _agree(others):
        return None
    k, drifted = 1.0 + line.slope, abs(line.slope) * float(np.ptp(stream.arrived_s))
    if abs(line.slope) < _SIGNIFICANT * line.error or drifted < max(_DRIFTED_S, 4.0 * line.scatter) or abs(line.slope) < _DRIFT:
        return None
    if abs(line.slope) < _ROUGH:
        what = f"its stamps drift by {1e3 * line.slope:+.1f} ms a second against the others"
        return Cause(what, float(stream.arrived_s[0]), "synchronise its clock (PTP, chrony), or see why it falls behind")
    unit = next((f": {a} written as {b}" for f, a, b in _UNITS if abs(np.log(k / f)) < 0.1), "") if k > 0.0 else ""
    return Cause(
        f"the clock of its stamps runs at {k:.3g} times the speed of the others{unit}", float(stream.arrived_s[0]),
        "mend the unit or the rate of this sender's clock",
    )  # fmt: skip


_UNITS: Final = (
    (1e3, "milliseconds", "seconds"), (1e-3, "seconds", "milliseconds"), (1e6, "microseconds", "seconds"),
    (1e-6, "seconds", "microseconds"), (1e9, "nanoseconds", "seconds"), (1e-9, "seconds", "nanoseconds"),
)  # fmt: skip


def shifted(stream: Stream, others: list[Stream]) -> Cause | None:
    """Median offset unlike most others': ahead of arrivals, or beyond any delay."""
    offset = float(np.median(_offset(stream)))
    if not _out(stream.kind, offset) or 2 * sum(not _out(s.kind, float(np.median(_offset(s)))) for s in others) <= len(others):
        return None
    name = _known(offset)
    where = "ahead of" if offset > 0.0 else "behind"
    what = f"its stamps are {_length(abs(offset))} {where} the clock of the others" + (f": {name}" if name else "")
    return Cause(what, float(stream.arrived_s[0]), "stamp with the clock of the IMU, and with the time of measurement")


def disorder(stream: Stream) -> Cause | None:
    """More than 2 % of an IMU's stamps go back."""
    back = np.flatnonzero(np.diff(stream.t_s) < 0.0)
    if stream.kind != IMU or len(back) < max(3.0, _DISORDER * len(stream.t_s)):
        return None
    what = f"{len(back)} of {len(stream.t_s)} stamps go back in time"
    return Cause(what, float(stream.arrived_s[back[0] + 1]), "let the driver send samples in their order, stamped when measured")


def silence(stream: Stream, others: list[Stream]) -> Cause | None:
    """An IMU is silent for > 1 s while others go on."""
    if stream.kind != IMU:
        return None
    heard = np.sort(np.concatenate([np.minimum(s.t_s, s.arrived_s) for s in others])) if others else np.empty(0)
    waits = np.diff(stream.arrived_s)
    k = int(np.argmax(waits))
    if waits[k] > _SILENT_S and _between(heard, stream.arrived_s[k], stream.arrived_s[k + 1]) >= 2:
        what = f"it is silent for {waits[k]:.1f} s while others go on"
        return Cause(what, float(stream.arrived_s[k]), "see the IMU's driver and its cable: the estimate coasts meanwhile")
    last = float(stream.arrived_s[-1])
    if len(heard) and heard[-1] > last + _ENDED_S and _between(heard, last, float(heard[-1])) >= 2:
        what = f"it ends {heard[-1] - last:.1f} s before the others"
        return Cause(what, last, "see the IMU's driver and its cable")
    return None


def lost(stream: Stream) -> Cause | None:
    """An IMU's steps are whole periods, many of them more than one."""
    steps = np.diff(np.unique(stream.t_s))
    period = float(np.quantile(steps, 0.1)) if len(steps) else 0.0
    if stream.kind != IMU or period <= 0.0 or batches(stream):
        return None
    ratio = steps[steps < _SILENT_S] / period
    whole = np.round(ratio)
    share = float((whole - 1.0).sum() / max(whole.sum(), 1.0))
    if share < _LOST or np.mean(np.abs(ratio - whole) < _WHOLE) < _REGULAR:
        return None
    what = f"{share:.0%} of its samples are missing, up to {period * (whole.max() - 1.0):.2g} s at a time"
    return Cause(what, float(stream.arrived_s[0]), "see bandwidth, queues and processor load on the way of the IMU")


def _between(t: Array, low: float, high: float) -> int:
    return int(np.count_nonzero((t > low) & (t < high)))


def _offset(stream: Stream) -> Array:
    return stream.t_s - stream.arrived_s


def _spread(x: Array) -> float:
    return 1.48 * float(np.median(np.abs(x - np.median(x))))


def _line(stream: Stream) -> _Line | None:
    t, offset = stream.arrived_s - stream.arrived_s[0], _offset(stream)
    if len(t) < 10 or np.ptp(t) < _LEAST_SPAN_S:
        return None
    t = t - t.mean()
    slope = float(t @ (offset - offset.mean()) / (t @ t))
    left = offset - offset.mean() - slope * t
    return _Line(slope, float(left.std() / np.sqrt(t @ t)), _spread(left))


def _agree(others: list[Stream]) -> bool:
    lines = [line for line in map(_line, others) if line is not None]
    return 2 * sum(abs(line.slope) < max(_DRIFT, 3.0 * line.error) for line in lines) > len(lines)


def _out(kind: str, offset: float) -> bool:
    ahead_s, late_s = (_IMU_AHEAD_S, _IMU_LATE_S) if kind == IMU else (_AHEAD_S, _LATE_S)
    return offset > ahead_s or offset < -late_s


def _known(size: float) -> str:
    size = abs(size)
    name = next((name for length, tolerance, name in _KNOWN_STEPS if abs(size - length) < tolerance), "")
    hours = round(size / 1800.0)
    return name or (_KNOWN_STEPS[-1][2] if 1 <= hours <= 28 and abs(size - 1800.0 * hours) < 1.0 else "")


def _length(s: float) -> str:
    return f"{s:.2f} s" if s < 1e5 else f"{s / 86_400.0:.0f} days"
