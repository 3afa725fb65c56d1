"""A reading that equals the last one to the bit while the vehicle moves is no measurement, from whichever source."""

import msgspec
import numpy as np
import pytest

from estimator.sources.base.held import HeldImu
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, Mode, PoseFix, Reason, Vec3
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.scenes import SECOND, fly, position_errors, simulated

BEGIN_NS, END_NS = EPOCH_NS + 20 * SECOND, EPOCH_NS + 26 * SECOND
MOVING: Vec3 = (0.3, -0.2, 0.1)
FORCE: Vec3 = (0.5, 1.0, -11.0)


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated("duration_s = 36.0\n[imu]\nrate_hz = 100.0\n[gnss]\n[pose_fix]\n", seed=5)


def _held(messages: list[Input], kind: type, *alive: str) -> list[Input]:
    """The messages of a kind repeat the last one before BEGIN_NS, but for the fields `alive`."""
    last: dict[type, Input] = {}
    found = list[Input]()
    for m in messages:
        if not isinstance(m, kind):
            found.append(m)
            continue
        if not BEGIN_NS <= m.t_ns < END_NS:
            last[kind] = m
        now = {name: getattr(m, name) for name in ("t_ns", "arrived_ns", *alive)}
        found.append(msgspec.structs.replace(last[kind], **now))
    return found


@pytest.mark.parametrize(("kind", "alive"), [(PoseFix, ()), (PoseFix, ("q_nb_wxyz",)), (GnssFix, ()), (GnssVelocity, ())])
def test_a_held_reading_of_any_source_is_named_within_a_second_and_never_followed(
    flight: Simulation, kind: type, alive: tuple[str, ...]
) -> None:
    run = fly(flight, messages=_held(flight.messages, kind, *alive))
    topic = next(m.topic for m in flight.messages if isinstance(m, kind))
    repeated = [m.t_ns for m in flight.messages if isinstance(m, kind) and BEGIN_NS + SECOND <= m.t_ns < END_NS]
    words = {s.t_ns: s.reason for s in run.last_words(topic).values()}
    assert {words[t] for t in repeated if t in words} <= {Reason.HELD, Reason.THINNED}
    assert Reason.HELD in words.values()
    assert any(topic in h.detail and "repeats" in h.detail for h in run.health if h.t_ns < BEGIN_NS + 2 * SECOND)
    assert position_errors([e for e in run.estimates if e.t_ns > BEGIN_NS], flight.truth).max() < 1.5


def _samples(gyro: list[Vec3], accel: list[Vec3], rate_hz: float = 100.0) -> list[str]:
    held = HeldImu()
    return [
        held.note(ImuSample(round(k * 1e9 / rate_hz), round(k * 1e9 / rate_hz), w, f))
        for k, (w, f) in enumerate(zip(gyro, accel, strict=True))
    ]


def _noisy(count: int) -> tuple[list[Vec3], list[Vec3]]:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((count, 6)) * 0.01
    return (
        [(MOVING[0] + n[0], MOVING[1] + n[1], MOVING[2] + n[2]) for n in noise],
        [(FORCE[0] + n[3], FORCE[1] + n[4], FORCE[2] + n[5]) for n in noise],
    )


def test_six_values_that_are_held_are_missing_after_a_tenth_of_a_second() -> None:
    gyro, accel = _noisy(50)
    said = _samples(gyro + gyro[-1:] * 30, accel + accel[-1:] * 30)
    assert not any(said[:58])
    assert all(said[62:])


def test_an_axis_that_dies_is_named_after_half_a_second_and_used_again_when_it_lives() -> None:
    gyro, accel = _noisy(200)
    gyro[50:150] = [(w[0], w[1], 0.0) for w in gyro[50:150]]
    said = _samples(gyro, accel)
    assert not any(said[:100])
    assert all("gyroscope z" in words for words in said[105:150])
    assert not any(said[151:])


def test_what_is_the_same_from_the_start_or_at_rest_is_used() -> None:
    gyro, accel = _noisy(200)
    planar = [(0.0, 0.0, w[2]) for w in gyro]
    assert not any(_samples(planar, accel))
    still = [(0.001, 0.0, 0.0)] * 200
    assert not any(_samples(gyro[:20] + still[20:], [*accel[:20], *[(0.0, 0.0, -9.81)] * 180]))


def test_samples_that_a_driver_repeats_at_a_higher_rate_are_used() -> None:
    gyro, accel = _noisy(100)
    assert not any(_samples([w for w in gyro for _ in range(4)], [f for f in accel for _ in range(4)], rate_hz=800.0))


def test_while_the_imu_is_held_the_estimate_coasts_and_fixes_lead_on(flight: Simulation) -> None:
    run = fly(flight, messages=_held(flight.messages, ImuSample))
    assert position_errors([e for e in run.estimates if e.t_ns > BEGIN_NS], flight.truth).max() < 3.0
    assert {e.mode for e in run.estimates if BEGIN_NS + SECOND < e.t_ns < END_NS} == {Mode.COASTING}
