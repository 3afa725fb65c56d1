"""Several IMUs, one of which fails while there is no GNSS: another takes over, and the covariance stays consistent."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import parse
from estimator.fusion import Fusion, FusionConfig
from estimator.replay.smooth_log import of_one_imu
from logs.wire.codec import encode_input
from models.messages import Estimate, GnssFix, GnssVelocity, ImuSample, Input, Vec3, vec3
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES
from models.state import E, X
from tests import long
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, ride

REST_S, FAULT_S, END_S, DARK_S = 5.0, 40.0, 60.0, (38.0, 50.0)
GYRO_2, ACCEL_2 = np.array([0.01, -0.02, 0.015]), np.array([0.2, -0.15, 0.1])
NOISE = GRADES["flight_controller"].noise


def _config(*topics: str) -> FusionConfig:
    return FusionConfig(imu=NOISE, origin=HOME.lla, imu_topics=topics)


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(REST_S, END_S - REST_S, seed=3)


def _seconds(t_ns: int) -> float:
    return (t_ns - EPOCH_NS) * 1e-9


def _other(journey: Ride, topic: str, seed: int) -> list[ImuSample]:
    """A second IMU, with biases that are far from those of the first, in step with it, that arrive 3 ms later."""
    rng, t = np.random.default_rng(seed), journey.truth
    white = rng.standard_normal((len(t.t_ns), 6)) * np.sqrt(50.0)
    gyro = t.gyro_b + GYRO_2 + white[:, :3] * NOISE.gyro_noise
    accel = t.accel_b + ACCEL_2 + white[:, 3:] * NOISE.accel_noise
    return [ImuSample(int(s), int(s) + 3_000_000, vec3(g), vec3(a), topic) for s, g, a in zip(t.t_ns, gyro, accel, strict=True)]


def _lit(messages: list[Input]) -> list[Input]:
    """What comes without GNSS from DARK_S."""
    return [m for m in messages if not (isinstance(m, GnssFix | GnssVelocity) and DARK_S[0] < _seconds(m.t_ns) < DARK_S[1])]


@dataclass(frozen=True)
class Fault:
    """What a failing IMU sends in place of a sample; None: nothing."""

    sent: Callable[[ImuSample, ImuSample], ImuSample | None]
    says: str

    def of(self, messages: list[Input]) -> list[Input]:
        """The messages with the fault in /imu."""
        out: list[Input] = []
        last = next(m for m in messages if isinstance(m, ImuSample))
        for m in messages:
            if not isinstance(m, ImuSample) or m.topic != "/imu":
                out.append(m)
            elif _seconds(m.t_ns) < FAULT_S:
                out.append(m)
                last = m
            elif (sent := self.sent(m, last)) is not None:
                out.append(sent)
        return out


def _with(sample: ImuSample, gyro: Vec3 | None = None, accel: Vec3 | None = None) -> ImuSample:
    return ImuSample(sample.t_ns, sample.arrived_ns, gyro or sample.gyro_b, accel or sample.accel_b, sample.topic)


NAN = float("nan")
FAULTS = {
    "silent": Fault(lambda _, __: None, "silent"),
    "stuck": Fault(lambda s, last: _with(s, last.gyro_b, last.accel_b), "stuck"),
    "not finite": Fault(lambda s, _: _with(s, (NAN, NAN, NAN)), "silent"),
    "saturated": Fault(lambda s, _: _with(s, accel=(s.accel_b[0], s.accel_b[1], -4.0)), "out of range"),
}
BIASED = Fault(lambda s, _: _with(s, (s.gyro_b[0] + 0.5, s.gyro_b[1], s.gyro_b[2])), "contradicts")


def _run(messages: list[Input], config: FusionConfig) -> Run:
    run = Run(Fusion(config)).feed(by_arrival(messages))
    assert run.internal_errors() == []
    return run


def _nees(estimates: list[Estimate], journey: Ride, part: slice) -> float:
    each = []
    for e in estimates:
        off = error(e, journey.truth)[part]
        each.append(float(off @ np.linalg.solve(e.covariance[part, part], off)) / len(off))
    return float(np.mean(each))


def _check(run: Run, journey: Ride, says: str) -> None:
    (change,) = [s for s in run.statuses if s.kind == "imu"]
    assert change.topic == "/imu2"
    assert says in change.detail
    assert says in run.health[-1].detail
    assert run.health[-1].sources["/imu2"] == "leading"
    dark = within(run.estimates, FAULT_S + 1.0, DARK_S[1], every=10)
    assert len(dark) > 20
    for part in (E.P, E.V, E.THETA):
        assert _nees(dark, journey, part) < 4.0
    assert np.linalg.norm(error(dark[-1], journey.truth)[E.P]) < 25.0
    bias = run.estimates[-1].nav[X.BG]
    assert np.abs(bias - GYRO_2).max() < 4e-3


@long.parametrize("name", FAULTS)
def test_given_one_of_two_fails_in_the_dark_then_the_other_takes_over(journey: Ride, name: str) -> None:
    messages = FAULTS[name].of(_lit([*journey.messages, *_other(journey, "/imu2", 1)]))
    _check(_run(messages, _config("/imu", "/imu2")), journey, FAULTS[name].says)


@pytest.mark.long
def test_given_the_first_comes_back_then_it_stands_by_and_takes_over_when_the_second_fails(journey: Ride) -> None:
    """The first is silent from 40 to 44 s, the second from 53 s on."""
    messages = _lit([*journey.messages, *_other(journey, "/imu2", 1)])
    silent = {"/imu": (FAULT_S, 44.0), "/imu2": (53.0, END_S)}
    heard = [m for m in messages if not (isinstance(m, ImuSample) and silent[m.topic][0] < _seconds(m.t_ns) < silent[m.topic][1])]
    run = _run(heard, _config("/imu", "/imu2"))
    assert [s.topic for s in run.statuses if s.kind == "imu"] == ["/imu2", "/imu"]
    states = [(_seconds(h.t_ns), h.sources["/imu"]) for h in run.health]
    assert {state for t, state in states if 41.0 < t < 44.0} == {"silent"}
    assert {state for t, state in states if 45.0 < t < 49.5} == {"failed"}  # for 10 s
    assert {state for t, state in states if 51.0 < t < 53.0} == {"standby"}
    assert states[-1][1] == "leading"
    back = within(run.estimates, 54.0, END_S - 0.5, every=10)
    for part in (E.P, E.V, E.THETA):
        assert _nees(back, journey, part) < 4.0
    assert np.linalg.norm(error(back[-1], journey.truth)[E.P]) < 2.0


@pytest.mark.long
def test_given_one_of_three_contradicts_the_others_then_it_is_the_wrong_one(journey: Ride) -> None:
    others = [*_other(journey, "/imu2", 1), *_other(journey, "/imu3", 2)]
    messages = BIASED.of(_lit([*journey.messages, *others]))
    _check(_run(messages, _config("/imu", "/imu2", "/imu3")), journey, BIASED.says)


def test_given_two_contradict_each_other_in_the_dark_then_it_is_said_and_nothing_changes(journey: Ride) -> None:
    messages = [m for m in _lit([*journey.messages, *_other(journey, "/imu2", 1)]) if _seconds(m.t_ns) < DARK_S[1]]
    run = _run(BIASED.of(messages), _config("/imu", "/imu2"))
    assert not [s for s in run.statuses if s.kind == "imu"]
    assert "contradict each other" in run.health[-1].detail


@long.parametrize("wrong", ["/imu", "/imu2"])
def test_given_two_contradict_each_other_then_positions_decide(journey: Ride, wrong: str) -> None:
    """Before, the estimate was given up and began again with the IMU that had failed: 74 m off, with a claim of 10 m."""
    messages = [*journey.messages, *_other(journey, "/imu2", 1)]
    other = "/imu2" if wrong == "/imu" else "/imu"
    swapped = {"/imu": wrong, "/imu2": other}
    faulty = BIASED.of([replace(m, topic=swapped[m.topic]) if isinstance(m, ImuSample) else m for m in messages])
    run = _run([replace(m, topic=swapped[m.topic]) if isinstance(m, ImuSample) else m for m in faulty], _config("/imu", "/imu2"))
    changes = [s for s in run.statuses if s.kind == "imu"]
    assert [s.topic for s in changes] == (["/imu2"] if wrong == "/imu" else [])
    if changes:
        assert "and the positions" in changes[0].detail
        assert _seconds(run.health[-1].t_ns) > FAULT_S + 10.0
    later = within(run.estimates, FAULT_S + 2.0, END_S, every=10)
    for part in (E.P, E.V, E.THETA):
        assert _nees(later, journey, part) < 4.0
    assert np.linalg.norm(error(later[-1], journey.truth)[E.P]) < 2.5


@pytest.mark.long
def test_given_another_imu_with_a_noise_of_its_own_then_the_covariance_grows_by_that(journey: Ride) -> None:
    """Fifty times the noise of the first: the velocity in the dark is known worse once the second leads."""
    messages = FAULTS["stuck"].of(_lit([*journey.messages, *_other(journey, "/imu2", 1)]))
    config = parse('[inputs]\nimu = ["/imu", "/imu2"]\n[imu]\nothers_noise = [50.0]\n').fusion()
    assert config.imu_factors == (50.0,)
    ends = []
    for factors in ((), config.imu_factors):
        run = _run(messages, replace(_config("/imu", "/imu2"), imu_factors=factors))
        before, end = (within(run.estimates, t, t + 0.5)[0] for t in (FAULT_S - 1.0, DARK_S[1] - 0.5))
        ends.append((before.covariance.diagonal()[E.V].max(), end.covariance.diagonal()[E.V].max()))
    assert ends[0][0] == ends[1][0]
    assert ends[1][1] > 2.0 * ends[0][1]


@pytest.mark.long
def test_given_two_sound_imus_then_the_estimate_is_that_of_the_first(journey: Ride) -> None:
    both = _run([*journey.messages, *_other(journey, "/imu2", 1)], _config("/imu", "/imu2"))
    alone = _run(journey.messages, _config("/imu"))
    assert len(both.estimates) == len(alone.estimates)
    assert all(np.array_equal(a.nav, b.nav) for a, b in zip(both.estimates, alone.estimates, strict=True))
    assert both.health[-1].sources["/imu2"] == "standby"


def test_given_the_first_never_speaks_then_the_second_leads_from_the_start(journey: Ride) -> None:
    silent: list[Input] = [m for m in journey.messages if not isinstance(m, ImuSample)]
    run = _run([*silent, *_other(journey, "/imu2", 1)], _config("/imu", "/imu2"))
    assert len(run.estimates) > 1000
    assert _nees(within(run.aligned, 30.0, END_S, every=20), journey, E.P) < 3.0


@pytest.mark.long
def test_given_fixes_come_late_then_the_end_is_that_of_fixes_in_time_to_the_bit(journey: Ride) -> None:
    messages = FAULTS["stuck"].of([*journey.messages, *_other(journey, "/imu2", 1)])
    late = [
        GnssFix(m.t_ns, m.arrived_ns + 700_000_000, m.lat_deg, m.lon_deg, m.alt_m, m.covariance_n, m.status, m.topic)
        if isinstance(m, GnssFix) and _seconds(m.t_ns) < END_S - 5.0
        else m
        for m in messages
    ]
    config = _config("/imu", "/imu2")
    punctual, delayed = _run(messages, config), _run(late, config)
    assert np.array_equal(punctual.estimates[-1].nav, delayed.estimates[-1].nav)
    assert np.array_equal(punctual.estimates[-1].covariance, delayed.estimates[-1].covariance)


@pytest.mark.long
def test_given_a_change_then_the_smoother_has_the_samples_of_the_imu_that_led_longest(journey: Ride) -> None:
    messages = FAULTS["stuck"].of(by_arrival([*journey.messages, *_other(journey, "/imu2", 1)]))
    used = [m for m in of_one_imu(messages, _config("/imu", "/imu2")) if isinstance(m, ImuSample)]
    assert {m.topic for m in used} == {"/imu"}
    assert FAULT_S - 0.1 < _seconds(used[-1].t_ns) < FAULT_S


@pytest.mark.long
def test_given_positions_decide_between_two_then_the_smoother_has_the_samples_of_the_right_one(journey: Ride) -> None:
    messages = BIASED.of(by_arrival([*journey.messages, *_other(journey, "/imu2", 1)]))
    late = [m for m in messages if _seconds(m.t_ns) > FAULT_S - 15.0]  # the first leads for 15 s, the second for 20 s
    used = [m for m in of_one_imu(late, _config("/imu", "/imu2")) if isinstance(m, ImuSample)]
    assert {m.topic for m in used} == {"/imu2"}
    assert FAULT_S - 5.0 < _seconds(used[0].t_ns) < FAULT_S
    assert _seconds(used[-1].t_ns) > END_S - 0.1


def test_given_imus_that_are_mounted_apart_then_each_is_turned_into_the_body() -> None:
    config = parse('[inputs]\nimu = ["/imu", "/imu2"]\n[imu]\nothers_rpy_deg = [[0, 0, 90]]\n')
    sample = ImuSample(1, 1, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), "/imu2")
    encoded = encode_input(sample, config.mounting())
    decoded = config.decoder().decode(*encoded, 1)
    assert isinstance(decoded, ImuSample)
    np.testing.assert_allclose(decoded.gyro_b, sample.gyro_b, atol=1e-12)
    as_first = config.decoder().decode("/imu", encoded[1], encoded[2], 1)
    assert isinstance(as_first, ImuSample)
    np.testing.assert_allclose(as_first.gyro_b, (0.2, -0.1, 0.3), atol=1e-12)
