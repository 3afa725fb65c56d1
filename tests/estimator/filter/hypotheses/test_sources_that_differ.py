"""Two sources of pose fixes that differ: whichever came first leads, and the covariance contains the other one."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from models.messages import Array, GnssFix, GnssVelocity, Input, PoseFix, vec3
from models.sim.scenario import Simulation
from models.state import E
from tests.estimator.scenes import SECOND, Run, error, fly, position_errors, radii, simulated, within

Change = Callable[[PoseFix], PoseFix]
_TOML = """duration_s = 50.0
[vehicle]
kind = "{kind}"
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 4.0
sigma_m = [0.15, 0.15, 0.15]
"""


@pytest.fixture(scope="module", params=["multirotor", "fixed_wing"])
def flight(request: pytest.FixtureRequest) -> Simulation:
    return simulated(_TOML.format(kind=request.param), seed=4)


def _north(by_m: float) -> Change:
    return lambda m: replace(m, p_n=vec3(np.add(m.p_n, (by_m, 0.0, 0.0))))


def _late(by_s: float) -> Change:
    return lambda m: replace(m, t_ns=m.t_ns + round(by_s * SECOND), arrived_ns=m.arrived_ns + round(by_s * SECOND))


def _both(flight: Simulation, change: Change, topic: str, *, receiver: bool = False) -> Run:
    """Every second fix is that of another source; /a comes first."""
    messages, k = list[Input](), 0
    for m in flight.messages:
        if isinstance(m, PoseFix):
            k += 1
            m = change(replace(m, topic=topic)) if k % 2 == (topic == "/a") else m  # noqa: PLW2901
        if receiver or not isinstance(m, GnssFix | GnssVelocity):
            messages.append(m)
    run = fly(flight, messages=sorted(messages, key=lambda m: m.arrived_ns))
    assert run.internal_errors() == []
    return run


def _ratio(run: Run, flight: Simulation) -> Array:
    """NEES of the position from 10 s on; an estimate throughout."""
    found = within(run.estimates, 10.0, 50.0)
    assert len(found) > 190
    off = [error(e, flight.truth)[E.P] for e in found]
    return np.array([o @ np.linalg.solve(e.covariance[E.P, E.P], o) for o, e in zip(off, found, strict=True)])


@pytest.mark.parametrize("topic", ["/a", "/z"])
@pytest.mark.parametrize("north_m", [0.3, 1.0, 20.0, 200.0])
def test_the_covariance_contains_both(flight: Simulation, north_m: float, topic: str) -> None:
    run = _both(flight, _north(north_m), topic)
    assert np.mean(_ratio(run, flight) < 7.8) > 0.9
    assert np.median(radii(within(run.estimates, 10.0, 50.0))) < 2.5 * north_m + 0.5
    assert (north_m < 3.0) or "the covariance covers it" in run.health[-1].detail


def test_two_that_agree_are_not_widened(flight: Simulation) -> None:
    assert 1.0 < np.mean(_ratio(_both(flight, _north(0.0), "/z"), flight)) < 5.0


def test_one_false_fix_is_no_difference(flight: Simulation) -> None:
    false_ns = flight.messages[0].t_ns + 25 * SECOND

    def once(m: PoseFix) -> PoseFix:
        return _north(50.0)(m) if false_ns <= m.t_ns < false_ns + SECOND // 2 else m

    run = _both(flight, once, "/z")
    assert max(radii(within(run.estimates, 27.0, 50.0, every=1))) < 1.5


@pytest.mark.parametrize("north_m", [20.0, 200.0])
def test_a_receiver_decides(flight: Simulation, north_m: float) -> None:
    run = _both(flight, _north(north_m), "/a", receiver=True)
    assert np.mean(_ratio(run, flight) < 7.8) > 0.9
    late = within(run.estimates, 30.0, 50.0)
    assert np.median(position_errors(late, flight.truth)) < 0.5
    assert np.median(radii(late)) < (8.0 if north_m < 100.0 else 2.0)  # the map may be wrong by tens of metres


@pytest.mark.parametrize("receiver", [True, False])
def test_one_whose_positions_are_noise_does_not_keep_the_other_from_aligning(flight: Simulation, receiver: bool) -> None:
    def anywhere(m: PoseFix) -> PoseFix:
        return replace(m, p_n=vec3(m.p_n + 100.0 * np.random.default_rng(m.t_ns).standard_normal(3)))

    run = _both(flight, anywhere, "/a", receiver=receiver)
    assert position_errors(within(run.estimates, 20.0, 50.0), flight.truth).max() < 2.0
    assert len(within(run.estimates, 20.0, 50.0)) > 140


@pytest.mark.parametrize("late_s", [0.15, 0.4])
def test_one_that_is_late_is_named_and_not_the_other(flight: Simulation, late_s: float) -> None:
    run = _both(flight, _late(late_s), "/z")
    found = within(run.estimates, 10.0, 50.0)
    assert len(found) > 190
    assert np.mean(_ratio(run, flight) < 7.8) > 0.75
    assert all(int(ms) < 50 for ms in re.findall(r"(\d+) ms early", run.health[-1].detail))
