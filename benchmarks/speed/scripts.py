"""What the speed benchmarks feed: a made-up flight, cut into rounds of messages that are not timed and messages that are.

Every round begins in steady flight, with a history as long as the filter keeps one.
"""

from collections.abc import Iterable, Iterator

import msgspec

from benchmarks.speed.flight import PERIOD_NS, imu_samples, pose_fixes
from models.messages import Input

LEAD_IN_S = 10.0  # before the first round: alignment, and a full history

Round = tuple[list[Input], list[Input]]  # not timed, timed


def imu_only(rounds: int, samples: int = 95) -> list[Round]:
    """Timed: IMU samples between two punctual fixes at 2 Hz."""
    begins = [round((LEAD_IN_S + 0.5 * k) * 1e9) + 2 * PERIOD_NS for k in range(rounds)]
    flow = _flow(LEAD_IN_S + 0.5 * rounds + 1.0, 2.0, {})
    return list(_cut(flow, ((begin, begin + samples * PERIOD_NS) for begin in begins)))


def late_fixes(rounds: int, late_s: float, rate_hz: float, count: int = 1, every_s: float = 1.0) -> list[Round]:
    """Timed: `count` fixes that come at once, the oldest late_s late, and the IMU sample after them.

    The other fixes are punctual. A late fix arrives two IMU samples later still, so that no punctual one comes with it.
    """
    seconds = LEAD_IN_S + every_s * rounds + late_s + 1.0
    fixes = pose_fixes(seconds, rate_hz)
    arrivals: dict[int, int] = {}
    for k in range(rounds):
        first = round((LEAD_IN_S + every_s * k) * rate_hz)
        arrived = fixes[first].t_ns + round(late_s * 1e9) + (2 * PERIOD_NS if late_s else 0)
        arrivals |= dict.fromkeys(range(first, first + count), arrived)
    instants = dict.fromkeys(arrivals.values())
    return list(_cut(_flow(seconds, rate_hz, arrivals), ((t - PERIOD_NS // 6, t + PERIOD_NS) for t in instants)))


def messages(seconds: float, rate_hz: float) -> list[Input]:
    """A whole flight in order of arrival, every fix punctual."""
    return list(_flow(seconds, rate_hz, {}))


def _flow(seconds: float, rate_hz: float, arrivals: dict[int, int]) -> Iterator[Input]:
    """The flight in order of arrival; arrivals: index of a fix -> when it arrives, if not at once."""
    fixes = enumerate(pose_fixes(seconds, rate_hz))
    moved = [msgspec.structs.replace(fix, arrived_ns=arrivals.get(k, fix.arrived_ns)) for k, fix in fixes]
    flight: list[Input] = [*imu_samples(seconds), *moved]
    return iter(sorted(flight, key=lambda m: m.arrived_ns))


def _cut(flow: Iterator[Input], spans: Iterable[tuple[int, int]]) -> Iterator[Round]:
    """For each span of arrival [begin, end): what comes before it, and what comes in it."""
    message = next(flow)
    for begin, end in spans:
        before: list[Input] = []
        timed: list[Input] = []
        while message.arrived_ns < end:
            (before if message.arrived_ns < begin else timed).append(message)
            message = next(flow)
        yield before, timed
