"""What a receiver reports of jamming and spoofing acts on its positions and velocities, and nothing else does."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from estimator.sources.base.aid import Aid
from estimator.sources.base.rules import RULES
from estimator.sources.gnss import GnssConfig, velocity_aid
from models.messages import GnssFix, GnssVelocity, Input, Reason, ReceiverState
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.scenes import SECOND, Run, fly, position_errors, simulated, within

RULE = RULES["gnss"]
PULL_S, FLAG_S, CLEAR_S, END_S = 12.0, 14.0, 16.0, 44.0
SCENE = """
duration_s = 44.0
[vehicle]
kind = "multirotor"
seed = 5
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 1.0
sigma_m = [0.2, 0.2, 0.2]
"""


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(SCENE, seed=2)


def _after(t_ns: int) -> float:
    return (t_ns - EPOCH_NS) * 1e-9


def _flagged(flight: Simulation, change: Callable[[Input, float], Input]) -> Run:
    return fly(flight, messages=[change(m, _after(m.t_ns)) for m in flight.messages])


def _reasons(run: Run, topic: str, since_s: float, until_s: float) -> list[Reason]:
    words = sorted(run.last_words(topic).values(), key=lambda s: s.t_ns)
    return [s.reason for s in words if since_s < _after(s.t_ns) < until_s]


@pytest.fixture(scope="module")
def spoofed(flight: Simulation) -> Run:
    """Positions run away at 2 m/s, velocities say so; two seconds later the receiver reports it, for two seconds."""

    def change(m: Input, t: float) -> Input:
        if isinstance(m, GnssFix) and PULL_S < t < CLEAR_S:
            m = msgspec.structs.replace(m, lat_deg=m.lat_deg + 2.0 * (t - PULL_S) / 111_000.0)
        if isinstance(m, GnssVelocity) and PULL_S < t < CLEAR_S:
            m = msgspec.structs.replace(m, v_n=(m.v_n[0] + 2.0, *m.v_n[1:]))
        if isinstance(m, GnssFix) and FLAG_S <= t < CLEAR_S:
            m = msgspec.structs.replace(m, state=ReceiverState.SPOOFED)
        return m

    return _flagged(flight, change)


def test_positions_and_velocities_stop_with_the_first_flag(spoofed: Run) -> None:
    for topic in ("/gnss", "/gnss/velocity"):
        assert set(_reasons(spoofed, topic, FLAG_S + 0.21, CLEAR_S)) == {Reason.STOPPED}, topic


def test_a_receiver_that_agrees_again_is_on_probation_first(spoofed: Run) -> None:
    held = _reasons(spoofed, "/gnss", CLEAR_S, CLEAR_S - 0.3 + RULE.hold_s)
    assert held
    assert Reason.FUSED not in held
    assert Reason.FUSED not in _reasons(spoofed, "/gnss/velocity", CLEAR_S, CLEAR_S - 0.3 + RULE.hold_s)
    back = _reasons(spoofed, "/gnss", CLEAR_S - 0.3 + RULE.hold_s, END_S)
    first = back.index(Reason.FUSED)  # the hypothesis without it leads, until it agrees for ten seconds
    assert set(back[:first]) == {Reason.PROBATION, Reason.GATED}
    assert back.count(Reason.PROBATION) == RULE.probation
    assert back[first:].count(Reason.FUSED) > 0.9 * len(back[first:])


def test_the_estimate_holds_meanwhile(flight: Simulation, spoofed: Run) -> None:
    assert position_errors(within(spoofed.estimates, PULL_S, END_S), flight.truth).max() < 2.0


def test_a_jammed_receiver_weighs_less_and_its_velocities_with_it(flight: Simulation) -> None:
    def jammed(m: Input, t: float) -> Input:
        return msgspec.structs.replace(m, state=ReceiverState.JAMMED) if isinstance(m, GnssFix) and t > PULL_S else m

    run = _flagged(flight, jammed)
    words = [s for s in run.last_words("/gnss").values() if _after(s.t_ns) > FLAG_S]
    assert {s.detail for s in words} == {"the receiver reports jamming"}
    assert set(_reasons(run, "/gnss/velocity", FLAG_S, END_S)) == {Reason.FUSED}


def test_velocities_have_the_share_of_false_readings_of_their_positions() -> None:
    aid = velocity_aid(GnssVelocity(SECOND, SECOND, (1.0, 0.0, 0.0), np.eye(3)), GnssConfig())
    assert isinstance(aid, Aid)
    doubted = aid.doubted(0.5)
    assert doubted.rules.false_share == 0.5
    assert doubted.log_false - aid.log_false == pytest.approx(np.log(50.0))
