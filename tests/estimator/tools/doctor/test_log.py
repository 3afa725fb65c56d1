"""What the log's content says: an airspeed on the ground is a warning, a topic that is never usable is a failure."""

import math

import pytest

from estimator.sources.base.aid import Refusal
from estimator.tools.doctor.log import _stream, _Topic
from estimator.tools.doctor.machine import State
from models.messages import Reading, Reason


@pytest.mark.parametrize(
    ("kind", "reason", "state"),
    [
        ("airspeed", Reason.IMPLAUSIBLE, State.WARN),
        ("airspeed", Reason.NOT_FINITE, State.FAIL),
        ("range", Reason.IMPLAUSIBLE, State.FAIL),
    ],
)
def test_a_topic_that_is_never_usable_fails_but_for_an_airspeed_on_the_ground(kind: str, reason: Reason, state: State) -> None:
    topic = _Topic("")
    for k in range(5):
        topic.add(Reading(k, k, f"/{kind}", kind, (1.2,)), Refusal(reason, "below"))
    assert _stream(f"/{kind}", topic)[0].state is state


def test_a_range_finder_out_of_its_range_is_no_fault() -> None:
    topic = _Topic("")
    for k in range(5):
        topic.add(Reading(k, k, "/range", "range", (math.inf,)), Refusal(Reason.NOT_FINITE, "its reading"))
    assert not topic.bad
