"""The scenarios of examples/, flown by the estimator as an engineer would configure it: what each documents in its first lines.

Shortened where nothing more happens, and with half the IMU rate.
"""

from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from models.messages import GnssFix, Mode, PoseFix, Reason
from models.sim.scenario import EPOCH_NS, Simulation, simulate
from models.sim.scenario_file import loads
from models.state import E
from tests import long
from tests.estimator.scenes import SECOND, Run, error, fly, position_errors, within

EXAMPLES = Path(__file__).parents[2] / "examples" / "scenarios"


@cache
def _flown(name: str, duration_s: float, seed: int = 1) -> tuple[Simulation, Run]:
    scenario = loads((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8"), name)
    imu = msgspec.structs.replace(scenario.imu, rate_hz=100.0)
    simulation = simulate(msgspec.structs.replace(scenario, duration_s=duration_s, imu=imu), seed)
    return simulation, fly(simulation)


def _errors(flown: tuple[Simulation, Run], start_s: float, end_s: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    simulation, run = flown
    return position_errors(within(run.estimates, start_s, end_s), simulation.truth)


ALL = {"rare_fixes": 130.0, "fixed_wing": 135.0, "imu_dropout": 80.0, "late_and_shuffled": 125.0, "spoof": 215.0}


def test_every_example_is_flown() -> None:
    of_their_own = ["demo", "night"]  # tests: tests/estimator/tools/test_demo.py, test_night.py
    assert sorted([*ALL, *of_their_own]) == sorted(path.stem for path in EXAMPLES.glob("*.toml"))


@long.parametrize("name", ALL)
def test_nothing_is_lost_and_nothing_is_nonsense(name: str) -> None:
    # GIVEN any of the examples
    simulation, run = _flown(name, ALL[name])
    # THEN there is no defect, no number that is none, and estimates until the end
    assert not run.internal_errors()
    assert all(np.isfinite(e.nav).all() and np.isfinite(e.covariance).all() for e in run.estimates)
    assert run.estimates[-1].t_ns == simulation.truth.t_ns[-1]
    # AND every measurement has its last word, but for those that are newer than the last IMU sample
    for topic, kind in (("/gnss", GnssFix), ("/pose_fix", PoseFix)):
        sent = {m.t_ns for m in simulation.messages if isinstance(m, kind)}
        assert len(sent) - len(run.last_words(topic)) <= 1


@long.parametrize("name", ["rare_fixes", "late_and_shuffled", "imu_dropout"])
def test_the_covariance_holds_the_true_position(name: str) -> None:
    # GIVEN an example without false measurements
    simulation, run = _flown(name, ALL[name])
    # THEN the 95 % ellipsoid of the position holds the truth about that often, from alignment to the end
    estimates = within(run.estimates, 5.0, ALL[name], every=50)
    off = [(error(e, simulation.truth)[E.P], e.covariance[E.P, E.P]) for e in estimates]
    held = np.mean([d @ np.linalg.solve(p, d) < 7.815 for d, p in off])
    assert 0.85 <= held <= 1.0


def test_rare_fixes_carry_the_flight_through_the_loss_of_gps_and_the_blackout() -> None:
    flown = _flown("rare_fixes", ALL["rare_fixes"])
    _, run = flown
    # GIVEN GNSS until 50 s THEN the estimate is good to decimetres
    assert np.median(_errors(flown, 10.0, 50.0)) < 0.5
    # WHEN one late fix in two seconds is all there is THEN it stays so
    assert _errors(flown, 52.0, 90.0).max() < 1.2
    assert {e.mode for e in within(run.estimates, 52.0, 90.0)} == {Mode.AIDED}
    # WHEN there is nothing at all for 30 s THEN it says dead reckoning, and drifts less than its own 95 % radius allows
    assert {e.mode for e in within(run.estimates, 94.0, 120.0)} == {Mode.DEAD_RECKONING}
    before = [h for h in run.health if h.t_ns < EPOCH_NS + 120 * SECOND][-1]
    assert 28.0 < before.absolute_age_s < 33.0
    assert _errors(flown, 118.0, 120.0).max() < 1.5 * before.radius95_m < 150.0
    # WHEN the fixes are back THEN so is the accuracy, at the second of them
    assert _errors(flown, 124.5, 130.0).max() < 1.2
    assert run.health[-1].mode is Mode.AIDED
    # AND the last known GNSS is still reported, with its age
    assert run.health[-1].last_gnss is not None
    assert run.health[-1].last_gnss.age_s == pytest.approx((run.health[-1].t_ns - EPOCH_NS) * 1e-9 - 50.0, abs=0.3)


@pytest.mark.long
def test_late_and_shuffled_fixes_lose_nothing() -> None:
    simulation, run = flown = _flown("late_and_shuffled", ALL["late_and_shuffled"])
    # GIVEN true fixes up to 5 s late, some twice, some in bundles
    fixes = [m for m in simulation.messages if isinstance(m, PoseFix)]
    assert max(m.arrived_ns - m.t_ns for m in fixes) > 4 * SECOND
    # THEN each is fused once, whatever its age and order
    final = {s.t_ns: s.reason for s in run.last_words("/pose_fix").values() if s.reason is not Reason.DUPLICATE}
    assert Reason.TOO_OLD not in final.values()
    assert Reason.IN_FUTURE not in final.values()
    assert sum(reason in {Reason.FUSED, Reason.ALIGNING} for reason in final.values()) >= len(final) - 1
    copies = len(fixes) - len({m.t_ns for m in fixes})
    assert sum(s.reason is Reason.DUPLICATE for s in run.statuses) == copies > 20
    # AND the estimate, up to three seconds behind the newest fix, stays within a metre or two without GNSS
    assert _errors(flown, 65.0, 125.0).max() < 2.5
    assert np.median(_errors(flown, 65.0, 125.0)) < 0.4


def test_the_estimate_goes_on_while_the_imu_is_silent() -> None:
    simulation, run = flown = _flown("imu_dropout", ALL["imu_dropout"])
    # GIVEN an IMU that is silent from 70 s to 73 s, and ticks
    silent = [e for e in run.estimates if EPOCH_NS + 70.15 * SECOND < e.t_ns < EPOCH_NS + 73 * SECOND]
    # THEN estimates go on at the rate of the ticks, say that they coast, and are aided by the fixes
    assert 25 <= len(silent) <= 30
    assert {e.mode for e in silent} == {Mode.COASTING}
    assert position_errors(silent, simulation.truth).max() < 6.0
    # AND their covariance holds: three seconds of a model instead of an IMU
    off = [(error(e, simulation.truth)[E.P], e.covariance[E.P, E.P]) for e in silent]
    assert np.mean([d @ np.linalg.solve(p, d) for d, p in off]) < 9.0
    # AND two seconds after its return all is as before
    assert _errors(flown, 75.0, 80.0).max() < 0.8
    assert {e.mode for e in within(run.estimates, 73.2, 80.0)} == {Mode.AIDED}


@pytest.mark.long
def test_spoofed_gnss_never_wins_beside_landmarks() -> None:
    simulation, run = flown = _flown("spoof", ALL["spoof"])
    # GIVEN a slow pull, a jump behind a jammer, and a repeater, and landmark fixes of which one in twenty is false
    # THEN the estimate never follows one of them
    assert _errors(flown, 10.0, 215.0).max() < 3.0
    assert np.median(_errors(flown, 10.0, 215.0)) < 0.3
    # AND no false landmark fix is fused, nearly every true one is
    words = {s.t_ns: s.reason for s in run.last_words("/pose_fix").values()}
    assert all(words[t] is Reason.GATED for t in simulation.false_fixes if t in words)
    true = [reason for t, reason in words.items() if t not in simulation.false_fixes]
    assert sum(reason is Reason.GATED for reason in true) <= 0.05 * len(true)
    # AND the jump and the repeater, at their full size, are never fused
    for start_s, end_s in ((125.5, 150.0), (181.0, 210.0)):
        lied = [s.reason for s in run.last_words("/gnss").values() if start_s < (s.t_ns - EPOCH_NS) * 1e-9 < end_s]
        assert len(lied) > 100
        assert Reason.FUSED not in lied


@pytest.mark.long
def test_a_fixed_wing_with_real_gnss_errors_keeps_to_its_landmarks() -> None:
    flown = _flown("fixed_wing", ALL["fixed_wing"])
    # GIVEN GNSS with an antenna apart, late stamps and a wandering error THEN the estimate is good to that error
    assert _errors(flown, 10.0, 100.0).max() < 4.0
    # WHEN it is gone, with a fix in five seconds THEN metres
    assert _errors(flown, 100.0, 130.0).max() < 5.0
