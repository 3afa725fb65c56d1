"""Several IMUs: one leads, another takes over when it fails (docs/decision.md).

    silent         nothing usable for 0.1 s while another one sends
    stuck          all axes read the same for 0.5 s while another one changes
    held           one axis reads the same for 0.5 s, and another IMU contradicts it
    contradicted   by two others that agree, or by one and by positions

    |u_2 - u_1 - d| > threshold + 0.1 |u_1| + 5 s_12            (means over 0.2 s; gyroscope and accelerometer apart)
    b <- b + d,    P_bb <- P_bb + diag(max(s, floor)^2)         (the new IMU's biases)

d: mean difference of up to 20 s before, s its sigma; else d = 0, s = sqrt(2) times the initial sigma. s_12: standard error. The
failed IMU's samples since the fault are replaced. The choice depends on the order of arrival.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from estimator.sources.base.aid import Aid, order
from estimator.sources.base.rules import RULES
from estimator.sources.imu.stream import BLOCK_NS, Stream
from models.messages import Array, ImuSample

KIND = "imu"
_SHARE, _ERRORS = 0.1, 5.0
_GYRO, _ACCEL = slice(0, 3), slice(3, 6)
_LEAST_BLOCKS = 15  # 3 s, from which the difference is known
_BEFORE_BLOCKS = 5  # 1 s before the fault, which may have begun unseen
_SLOW_BLOCKS = 10  # 2 s: in which what a motion makes of the difference stays the same
_AGAINST = 2  # blocks in a row that contradict: no jolt does
_AXES = 6
_WHERE_REFUTED = 0.25  # of the thresholds, where positions contradict the estimate
_UNSEEN_NS = 4_000_000_000  # for so long the fault may have been too small to be seen
_DOUBT_NS = 60_000_000_000  # a contradiction is reported for so long
_SILENT_NS: Final = 100_000_000  # ten missed samples of the slowest IMU that is flown, 100 Hz
_STUCK_NS: Final = 500_000_000
_CONTRADICT: Final = ((_GYRO, 0.1), (_ACCEL, 2.0))  # rad/s, m/s^2
_BIAS_FLOOR: Final = np.repeat([5e-4, 0.02], 3)  # rad/s, m/s^2: sigma of the new IMU's bias, at least
_AGAIN_NS = 10_000_000_000  # an IMU that has failed is not chosen again for so long


class TakeOver(NamedTuple):
    """Another IMU leads from since_ns; shift, sigma: of the biases, (6,); shift None: unknown."""

    topic: str
    since_ns: int
    samples: list[ImuSample]
    why: str
    shift: Array | None
    sigma: Array


class ImuAid(Aid, frozen=True, eq=False, kw_only=True):
    """The change of IMU; factor: on the first one's noise."""

    shift: Array
    sigma: Array
    factor: float


class Choice:
    """Which IMU leads. topics: of [inputs] imu; below two every sample is used."""

    def __init__(self, topics: tuple[str, ...]) -> None:
        self._topics, self.is_used = topics, len(topics) > 1  # where there are several IMUs
        self.leader = topics[0] if topics else ""
        self.why = ""
        self._again_ns: dict[str, int] = {}
        self.forget()

    def forget(self) -> None:
        """After a clock step: forget all but the leader."""
        self._streams = {topic: Stream() for topic in self._topics}
        self._first_ns: int | None = None
        self._checked_block = -1
        self._again_ns.clear()
        self._doubt: tuple[int, str] = -_DOUBT_NS, ""
        self._apart_ns: int | None = None  # since then the leader and another contradict each other

    def remark(self, t_ns: int) -> str:
        """Why another IMU leads, and contradictions."""
        since_ns, doubt = self._doubt
        return "; ".join(filter(None, (self.why, doubt if t_ns - since_ns < _DOUBT_NS else "")))

    def leads(self, sample: ImuSample) -> bool:
        """Whether the estimator is to have the sample."""
        return not self.is_used or sample.topic == self.leader or sample.topic not in self._streams

    def states(self, t_ns: int) -> dict[str, str]:
        """leading, standby, failed or silent, by topic."""
        return {topic: self._state(topic, t_ns) for topic in self._topics} if self.is_used else {}

    def _state(self, topic: str, t_ns: int) -> str:
        if topic == self.leader:
            return "leading"
        if not self._is_heard(topic, t_ns):
            return "silent"
        return "standby" if self._is_healthy(topic, t_ns) else "failed"

    def note(self, sample: ImuSample, *, is_refuted: bool = False) -> TakeOver | None:
        """Take a usable sample; the change where the leader failed.

        is_refuted: positions contradict the estimate.
        """
        stream = self._streams.get(sample.topic)
        if not self.is_used or stream is None:
            return None
        self._first_ns = sample.t_ns if self._first_ns is None else self._first_ns
        stream.add(sample)
        if sample.topic == self.leader:
            return None
        return self._check(sample.t_ns, is_refuted=is_refuted)

    def _check(self, t_ns: int, *, is_refuted: bool) -> TakeOver | None:
        lead = self._streams[self.leader]
        others = [x for x in self._topics if x != self.leader and self._is_healthy(x, t_ns)]
        if not others or self._first_ns is None:
            return None
        heard_ns = max(lead.newest_ns, self._first_ns)
        if t_ns - heard_ns > _SILENT_NS:
            return self._take_over(others[0], heard_ns, f"{self.leader} is silent", t_ns)
        if lead.is_stuck(_STUCK_NS):
            since_ns = lead.held_since_ns(range(_AXES))
            return self._take_over(others[0], since_ns, f"{self.leader} reads the same all the time: stuck", t_ns)
        if (block := t_ns // BLOCK_NS) == self._checked_block:
            return None
        self._checked_block = block
        held, share = lead.held(_STUCK_NS), _WHERE_REFUTED if is_refuted else 1.0
        against = [x for x in others if self._contradict(self.leader, x, share)]
        if held and against:
            return self._take_over(
                against[0], lead.held_since_ns(held), f"{self.leader} holds a value: stuck or out of range", t_ns
            )
        agreed = [x for x in against if any(x != y and not self._contradict(x, y) for y in against)]
        if agreed:
            since_ns = t_ns - _UNSEEN_NS if is_refuted else (block - _AGAINST - 1) * BLOCK_NS
            return self._take_over(agreed[0], since_ns, f"{self.leader} contradicts the others", t_ns)
        if not against:
            self._apart_ns = None
            return None
        begun_ns = (block - _AGAINST - 1) * BLOCK_NS
        self._apart_ns = begun_ns if self._apart_ns is None else self._apart_ns
        if is_refuted:
            since_ns = min(self._apart_ns, t_ns - _UNSEEN_NS)
            return self._take_over(against[0], since_ns, f"{self.leader} contradicts {against[0]} and the positions", t_ns)
        self._doubt = t_ns, f"{self.leader} and {against[0]} contradict each other: one of them is wrong"
        return None

    def _is_healthy(self, topic: str, t_ns: int) -> bool:
        is_stuck = self._streams[topic].is_stuck(_STUCK_NS)
        return self._is_heard(topic, t_ns) and not is_stuck and self._again_ns.get(topic, 0) <= t_ns

    def _is_heard(self, topic: str, t_ns: int) -> bool:
        return t_ns - self._streams[topic].newest_ns <= _SILENT_NS

    def _contradict(self, one: str, other: str, share: float = 1.0) -> bool:
        first, second = self._streams[one], self._streams[other]
        blocks, differences = first.blocks(second)
        if len(blocks) < _AGAINST:
            return False
        before = differences[: -_AGAINST - _BEFORE_BLOCKS]
        usual = before.mean(axis=0) if len(before) >= _LEAST_BLOCKS else np.zeros(_AXES)
        for block, difference in zip(blocks[-_AGAINST:], differences[-_AGAINST:] - usual, strict=True):
            mean, variance = first.mean(block)
            variance = variance + second.mean(block)[1]
            for part, threshold in _CONTRADICT:
                expected = _SHARE * np.linalg.norm(mean[part]) + _ERRORS * math.sqrt(variance[part].sum())
                if np.linalg.norm(difference[part]) > share * threshold + expected:
                    break
            else:
                return False
        return True

    def _take_over(self, topic: str, since_ns: int, why: str, t_ns: int) -> TakeOver:
        stream = self._streams[topic]
        blocks, differences = self._streams[self.leader].blocks(stream)
        known = differences[[b < since_ns // BLOCK_NS - _BEFORE_BLOCKS for b in blocks]]
        shift, sigma = None, np.zeros(_AXES)
        if (n := len(known)) >= _LEAST_BLOCKS:
            shift = known.mean(axis=0)
            sigma = np.maximum(_BIAS_FLOOR, known.std(axis=0) * np.sqrt(_SLOW_BLOCKS / n))
        self._again_ns[self.leader], self._apart_ns = t_ns + _AGAIN_NS, None
        self.leader, self.why = topic, f"{why}; {topic} leads"
        return TakeOver(topic, since_ns, stream.after(since_ns), self.why, shift, sigma)


def imu_aid(change: TakeOver, t_ns: int, arrived_ns: int, unknown: tuple[float, float], factor: float = 1.0) -> ImuAid:
    """The change as a measurement; unknown: initial bias sigmas."""
    shift, sigma = change.shift, change.sigma
    if shift is None:
        shift, sigma = np.zeros(_AXES), np.sqrt(2.0) * np.repeat(unknown, 3)
    return ImuAid(
        t_ns=t_ns,
        arrived_ns=arrived_ns,
        topic=change.topic,
        kind=KIND,
        order=order(t_ns, KIND, change.topic),
        rules=RULES["imu"],
        absolute=False,
        log_false=0.0,
        measurement=lambda _: None,
        detail=change.why,
        shift=shift,
        sigma=sigma,
        factor=factor,
    )
