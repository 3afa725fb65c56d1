from collections.abc import Callable

import pytest

from estimator.publish import OutputConfig, Pace, Publisher
from models.messages import Estimate

SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(("rate_hz", "expected"), [(0.0, 200), (200.0, 200), (50.0, 50), (30.0, 30), (1.0, 1)])
def test_a_pace_lets_its_rate_pass(rate_hz: float, expected: int) -> None:
    pace = Pace(rate_hz)
    assert sum(pace.due(i * 5_000_000) for i in range(200)) == expected


def test_what_is_due_does_not_depend_on_when_the_stream_began() -> None:
    whole, later = Pace(30.0), Pace(30.0)
    stamps = range(0, SECOND_NS, 5_000_000)
    due = [t for t in stamps if whole.due(t)]
    assert [t for t in stamps[10:] if later.due(t)][1:] == [t for t in due if t > stamps[10]]


def test_odometry_for_every_estimate_and_the_slow_topics_at_30_hz(estimate_at: Callable[[int], Estimate]) -> None:
    publisher = Publisher(OutputConfig())
    sent = [encoded.topic for encoded in publisher.encoded(estimate_at(i * 5_000_000) for i in range(200))]
    assert sent.count("/landfix/odometry") == 200
    for topic in ("/landfix/pose", "/tf", "/landfix/global"):
        assert sent.count(topic) == 30


def test_odometry_can_be_thinned(estimate_at: Callable[[int], Estimate]) -> None:
    publisher = Publisher(OutputConfig(rate_hz=50.0))
    sent = [encoded.topic for encoded in publisher.encoded(estimate_at(i * 5_000_000) for i in range(200))]
    assert sent.count("/landfix/odometry") == 50
