"""Late = punctual, to the bit, for what takes two places in the order, and for poses of which the tracker makes increments."""

from collections.abc import Iterable

import msgspec
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from models.messages import ImuSample, Input, OdometryDelta, Reason
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.filter.relative.odometers import TOPIC, increments, poses
from tests.estimator.scenes import FAULTY, SECOND, Run, arriving, by_arrival, fly, same, simulated

SETTLED_S = 10.0
OTHER = "/wheels"


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulated(FAULTY)


def _odometry(simulation: Simulation) -> list[Input]:
    """Increments, one that overlaps and one that is false among them, and poses of another odometry that is lost for a while."""
    steps = list(increments(simulation, 0.5, SETTLED_S))
    k = len(steps) // 2
    steps[k] = msgspec.structs.replace(steps[k], dp_b=(steps[k].dp_b[0] + 3.0, *steps[k].dp_b[1:]))
    half = SECOND // 4
    overlaps = msgspec.structs.replace(steps[k + 3], t0_ns=steps[k + 3].t0_ns + half, t_ns=steps[k + 3].t_ns + half)
    others = [msgspec.structs.replace(p, topic=OTHER) for p in poses(simulation, 1.0, SETTLED_S, rate_hz=5.0)]
    others += [msgspec.structs.replace(p, is_lost=True) for p in others[30:33]]
    return [*steps, overlaps, *others]


@pytest.fixture(scope="module")
def messages(simulation: Simulation) -> list[Input]:
    kept = [m for m in simulation.messages if isinstance(m, ImuSample) or m.t_ns < EPOCH_NS + SETTLED_S * SECOND]
    return [*kept, *_odometry(simulation)]


@pytest.fixture(scope="module")
def punctual(simulation: Simulation, messages: list[Input]) -> Run:
    return fly(simulation, messages=by_arrival(messages))


def _reasons(run: Run) -> dict[tuple[str, int, str], Reason]:
    topics = ("/gnss", "/gnss/velocity", "/pose_fix", TOPIC, OTHER)
    words = {(topic, *key): status.reason for topic in topics for key, status in run.last_words(topic).items()}
    return {key: reason for key, reason in words.items() if reason is not Reason.DUPLICATE}


def test_the_flight_has_hypotheses_and_increments_that_are_fused_gated_and_refused(punctual: Run) -> None:
    assert {Reason.FUSED, Reason.GATED, Reason.THINNED, Reason.ALIGNING} <= punctual.reasons(TOPIC).keys()
    assert {Reason.FUSED, Reason.THINNED, Reason.NO_FIX} <= punctual.reasons(OTHER).keys()
    assert max(h.hypotheses for h in punctual.health) > 1
    assert not punctual.internal_errors()


@settings(max_examples=8, phases=(Phase.explicit, Phase.reuse, Phase.generate))  # one example takes too long to shrink
@given(seed=st.integers(0, 2**32 - 1), most_s=st.sampled_from([0.05, 1.0, 5.0]), duplicates=st.sampled_from([0.0, 0.5]))
def test_any_order_of_arrival_ends_in_the_same_bits(
    seed: int, most_s: float, duplicates: float, simulation: Simulation, messages: list[Input], punctual: Run
) -> None:
    rng = np.random.default_rng(seed)
    shuffled: list[Input] = []
    for m in messages:
        if isinstance(m, ImuSample):
            shuffled.append(m)
        else:
            shuffled += [arriving(m, rng.uniform(0.0, most_s)) for _ in range(1 + (rng.random() < duplicates))]
    run = fly(simulation, messages=by_arrival(shuffled))
    assert same(run.estimates[-1], punctual.estimates[-1])
    assert _reasons(run) == _reasons(punctual)
    assert not run.internal_errors()


def test_every_estimate_after_the_last_arrival_is_that_of_punctual_processing(
    simulation: Simulation, messages: list[Input], punctual: Run
) -> None:
    late = by_arrival(m if isinstance(m, ImuSample) else arriving(m, 2.7) for m in messages)
    after = EPOCH_NS + round((SETTLED_S + 2.8) * 1e9)
    run = fly(simulation, messages=late)
    pairs = list(zip(*([e for e in r.estimates if e.t_ns > after] for r in (run, punctual)), strict=True))
    assert len(pairs) > 100
    assert all(same(a, b) for a, b in pairs)


def test_an_increment_that_begins_before_the_history_is_too_old(simulation: Simulation, messages: list[Input]) -> None:
    """Its end would still have a place, its beginning has none."""
    imu = [m for m in messages if not isinstance(m, OdometryDelta)]
    steps = [
        msgspec.structs.replace(m, arrived_ns=m.t0_ns + 6 * SECOND + SECOND // 4)
        for m in messages
        if isinstance(m, OdometryDelta)
    ]
    run = fly(simulation, messages=by_arrival([*imu, *steps]))
    assert run.reasons(TOPIC).keys() == {Reason.TOO_OLD}


def test_without_odometry_nothing_changes(simulation: Simulation, messages: list[Input]) -> None:
    """An increment that is refused leaves no trace."""

    def wrong(m: OdometryDelta) -> OdometryDelta:
        return msgspec.structs.replace(m, dq_wxyz=(0.0, 0.0, 0.0, 0.0))

    plain: Iterable[Input] = [m for m in messages if getattr(m, "topic", "") not in {TOPIC, OTHER}]
    refused = [wrong(m) for m in messages if isinstance(m, OdometryDelta)]
    a, b = (fly(simulation, messages=by_arrival(those)) for those in (plain, [*plain, *refused]))
    assert all(same(x, y) for x, y in zip(a.estimates, b.estimates, strict=True))
    assert b.reasons(TOPIC).keys() == {Reason.IMPLAUSIBLE}
