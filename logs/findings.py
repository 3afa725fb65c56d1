"""Which stream of a log is at fault: its stamps or its axes. Each cause is one function of the collected streams.

Stamps are judged against the times of arrival in the log, and only where most other streams agree with those:
the odd one out is named.
"""

from collections.abc import Mapping
from typing import NamedTuple

import msgspec
import numpy as np

from models.messages import Array

_LEAST_SAMPLES = 50
_FEW_DISTINCT = 0.5  # of all stamps
_BATCH_WAIT = 0.9  # of the span lies in the waits between batches
_LEAST_BATCHES = 10
_CLOCK_RATE = 0.02  # no quartz is off by 2 %
_LEAST_SPAN_S = 3.0
_STEP_S = 0.1
_STEP_WINDOW_S = 1.0
_FROZEN_S = 2.0
_LIVELY = 0.5  # of the samples differ from the one before
_AXES = ("gyroscope x", "gyroscope y", "gyroscope z", "accelerometer x", "accelerometer y", "accelerometer z")


class Stream(NamedTuple):
    """What a topic brought: stamps and times of arrival (n,) [s], and of an IMU gyro and accel (n, 6), else (n, 0)."""

    t_s: Array
    arrived_s: Array
    imu: Array


class Finding(msgspec.Struct, frozen=True):
    """who: the topic at fault; since_s: after the log's first arrival; advice: what to set or mend."""

    who: str
    what: str
    since_s: float
    advice: str


def findings(streams: Mapping[str, Stream]) -> list[Finding]:
    """All findings, at most one about the stamps of each stream, in the order of the topics."""
    start_s = min((float(s.arrived_s.min()) for s in streams.values() if len(s.arrived_s)), default=0.0)
    made = list[Finding]()
    for name, stream in sorted(streams.items()):
        others = [s for topic, s in streams.items() if topic != name]
        if len(stream.t_s) < _LEAST_SAMPLES:
            continue
        found = few_stamps(stream) or batches(stream) or clock_step(stream, others) or clock_rate(stream, others)
        for cause in filter(None, (found, frozen_axis(stream))):
            what, since_s, advice = cause
            made.append(Finding(name, what, max(0.0, since_s - start_s), advice))
    return made


def few_stamps(stream: Stream) -> tuple[str, float, str] | None:
    """Distinct stamps / samples < 1/2: a time written with too few digits, as float32, or never set. IMU only."""
    distinct = len(np.unique(stream.t_s))
    if not stream.imu.size or distinct >= _FEW_DISTINCT * len(stream.t_s):
        return None
    return (
        f"{len(stream.t_s)} stamps have {distinct} values", float(stream.arrived_s[0]),
        "write the time with all its digits (nanoseconds or float64 seconds)",
    )  # fmt: skip


def batches(stream: Stream) -> tuple[str, float, str] | None:
    """Steps > 5 x the median step hold > 90 % of the span, and at least 10 follow: n samples are stamped on arrival. IMU only."""
    steps = np.diff(stream.t_s)
    waits = np.flatnonzero(steps > 5.0 * max(float(np.median(steps)), 0.0))
    span = float(stream.t_s[-1] - stream.t_s[0])
    if not stream.imu.size or len(waits) < _LEAST_BATCHES or span <= 0.0 or steps[waits].sum() < _BATCH_WAIT * span:
        return None
    size = round(float(np.median(np.diff(waits))))
    if size < 2:
        return None
    return (
        f"samples come in batches of {size}, stamped on arrival", float(stream.arrived_s[0]),
        "let the driver stamp each sample with its own time of measurement",
    )  # fmt: skip


def clock_rate(stream: Stream, others: list[Stream]) -> tuple[str, float, str] | None:
    """k = span of the stamps / span of the arrivals, |k - 1| > 2 %, while most other streams have |k - 1| < 2 %."""
    k = _rate(stream)
    if k is None or abs(k - 1.0) <= _CLOCK_RATE or not _agree(others):
        return None
    return (
        f"the clock of its stamps runs at {k:.2f} times the speed of the others", float(stream.arrived_s[0]),
        "mend the unit or the rate of this sender's clock",
    )  # fmt: skip


def clock_step(stream: Stream, others: list[Stream]) -> tuple[str, float, str] | None:
    """Medians of (stamp - arrival) over 1 s before and after a step of the stamps differ by > 0.1 s, and stay."""
    k = _rate(stream)
    if k is None or not _agree(others):
        return None
    offset = stream.t_s - stream.arrived_s
    width = max(5, round(_STEP_WINDOW_S * len(offset) / float(np.ptp(stream.arrived_s))))
    at = int(np.argmax(np.abs(np.diff(offset)))) + 1
    if at < width or at > len(offset) - width:
        return None
    before, after = offset[:at], offset[at:]
    step = float(np.median(after[:width]) - np.median(before[-width:]))
    if abs(offset[at] - offset[at - 1]) < 0.5 * abs(step):
        return None  # a drift, no step
    if abs(step) < _STEP_S or abs(float(np.median(after) - np.median(before)) - step) > 0.5 * abs(step):
        return None
    return (
        f"its stamps jump by {step:+.2f} s and stay", float(stream.arrived_s[at]),
        "the sender's clock was set: add the step to its later stamps, or cut the log there",
    )  # fmt: skip


def frozen_axis(stream: Stream) -> tuple[str, float, str] | None:
    """An axis that lived repeats its value to the bit for > 2 s, while most samples of another axis of its sensor change.

    It lived where it has changed before: a simulation without noise in a plane has axes that read 0 from beginning to end.
    """
    if not stream.imu.size:
        return None
    same = np.diff(stream.imu, axis=0) == 0.0
    for axis, name in enumerate(_AXES):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same[:, axis], [False]]).astype(int)))
        for first, last in edges.reshape(-1, 2).tolist():
            if not first:
                continue
            long_s = stream.arrived_s[last] - stream.arrived_s[first]
            sensor = slice(0, 3) if axis < 3 else slice(3, 6)
            if long_s > _FROZEN_S and np.mean(same[first:last, sensor], axis=0).min() < 1.0 - _LIVELY:
                value = stream.imu[first, axis] + 0.0  # not -0
                what = f"{name} reads {value:g} without any change for {long_s:.1f} s, while other axes move"
                return what, float(stream.arrived_s[first]), "this axis of the sensor or of its driver is dead"
    return None


def _rate(stream: Stream) -> float | None:
    """Span of the stamps / span of the arrivals, between the 10 % and the 90 % sample; None: too short."""
    if len(stream.t_s) < 2:
        return None
    first, last = len(stream.t_s) // 10, len(stream.t_s) - 1 - len(stream.t_s) // 10
    span = float(stream.arrived_s[last] - stream.arrived_s[first])
    return float(stream.t_s[last] - stream.t_s[first]) / span if span > _LEAST_SPAN_S else None


def _agree(others: list[Stream]) -> bool:
    """Do more than half of the others have stamps that run as fast as the arrivals? Else the arrivals may be at fault."""
    rates = [k for k in map(_rate, others) if k is not None]
    return 2 * sum(abs(k - 1.0) < _CLOCK_RATE for k in rates) > len(rates)
