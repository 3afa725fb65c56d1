import itertools
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from models.frames import Origin
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, PoseFix, Reading, Tick
from models.sim.aids import Gnss, PoseFixes
from models.sim.beacons import Beacons
from models.sim.faults import ImuDropout, SpoofJump
from models.sim.scenario import EPOCH_NS, Scenario, simulate
from models.sim.scenario_file import loads
from models.sim.sensors import GRADES, Imu
from models.sim.trajectory import Multirotor

EXAMPLES = sorted((Path(__file__).parents[3] / "examples/scenarios").glob("*.toml"))
FULL = Scenario(duration_s=20.0, gnss=Gnss(), pose_fix=PoseFixes(delay_s=0.3), ticks_hz=10.0)


def text(messages: list[Input]) -> list[str]:
    return [repr(m) for m in messages]


def test_equal_seeds_give_equal_runs_and_other_seeds_others() -> None:
    one, again, other = simulate(FULL, 1), simulate(FULL, 1), simulate(FULL, 2)
    assert text(one.messages) == text(again.messages)
    for name in one.truth.__slots__:
        np.testing.assert_array_equal(getattr(one.truth, name), getattr(again.truth, name))
    assert text(one.messages) != text(other.messages)


def test_messages_come_in_order_of_arrival_the_imu_sample_after_the_aids_and_before_the_tick() -> None:
    messages = simulate(FULL, 1).messages
    assert [m.arrived_ns for m in messages] == sorted(m.arrived_ns for m in messages)
    rank = {GnssFix: 0, GnssVelocity: 0, PoseFix: 0, ImuSample: 1, Tick: 2}
    for a, b in itertools.pairwise(messages):
        if a.arrived_ns == b.arrived_ns:
            assert rank[type(a)] <= rank[type(b)]


def test_every_kind_is_there_at_its_rate_and_truth_stands_at_the_imu_samples() -> None:
    simulation = simulate(FULL, 1)
    counts = {k: sum(isinstance(m, k) for m in simulation.messages) for k in (ImuSample, GnssFix, GnssVelocity, PoseFix, Tick)}
    assert counts == {ImuSample: 4001, GnssFix: 100, GnssVelocity: 100, PoseFix: 40, Tick: 201}
    stamps = [m.t_ns for m in simulation.messages if isinstance(m, ImuSample)]
    np.testing.assert_array_equal(simulation.truth.t_ns, stamps)
    assert stamps[0] == EPOCH_NS
    assert set(np.diff(stamps)) == {5_000_000}
    assert all(len(getattr(simulation.truth, name)) == 4001 for name in simulation.truth.__slots__)


def test_aids_have_stamps_of_their_own_phase() -> None:
    stamps = [m.t_ns for m in simulate(FULL, 1).messages if isinstance(m, PoseFix)]
    assert (stamps[0] - EPOCH_NS) % 5_000_000 != 0
    assert set(np.diff(stamps)) == {500_000_000}


def test_samples_are_truth_plus_bias_plus_noise() -> None:
    simulation = simulate(FULL, 1)
    truth, noise = simulation.truth, GRADES["flight_controller"].noise
    assert simulation.imu_noise == noise
    accel = np.array([m.accel_b for m in simulation.messages if isinstance(m, ImuSample)])
    residual = accel - truth.accel_b - truth.accel_bias
    assert residual.std() == pytest.approx(noise.accel_noise / np.sqrt(0.005), rel=0.03)
    assert np.abs(residual.mean(axis=0)).max() < 5 * residual.std() / np.sqrt(4001)


def test_a_sensor_more_or_a_fault_leaves_the_other_sensors_as_they_were() -> None:
    alone = simulate(Scenario(duration_s=20.0, gnss=Gnss()), 4)
    more = simulate(Scenario(duration_s=20.0, gnss=Gnss(), pose_fix=PoseFixes(), faults=(ImuDropout(start_s=5.0, end_s=6.0),)), 4)
    assert text([m for m in alone.messages if isinstance(m, GnssFix)]) == text(
        [m for m in more.messages if isinstance(m, GnssFix)]
    )
    np.testing.assert_array_equal(alone.truth.gyro_bias, more.truth.gyro_bias)
    assert sum(isinstance(m, ImuSample) for m in more.messages) == 4001 - 200


def test_config_names_what_the_estimator_needs() -> None:
    scenario = Scenario(
        duration_s=5.0,
        imu=Imu(grade="tactical", noise_multiplier=2.0),
        gnss=Gnss(stamp_lag_s=0.12, antenna_b_m=(0.3, 0.0, -0.2)),
        pose_fix=PoseFixes(),
    )
    simulation = simulate(scenario, 0)
    noise = GRADES["tactical"].noise  # the data sheet's, not the doubled one: the mismatch stays unknown
    assert tomllib.loads(simulation.config_toml) == {
        "imu": {
            "axes": "flu",
            "gyro_noise": noise.gyro_noise,
            "accel_noise": noise.accel_noise,
            "gyro_walk": noise.gyro_walk,
            "accel_walk": noise.accel_walk,
            "gyro_scale": 0.0,
        },
        "inputs": {"imu": "/imu", "gnss": "/gnss", "gnss_velocity": "/gnss/velocity", "pose_fix": "/pose_fix"},
        "gnss": {"delay_s": 0.12, "antenna_b_m": [0.3, 0.0, -0.2]},
        "map": {"origin": [47.3977, 8.5456, 488.0]},
    }
    assert simulation.origin == Origin(47.3977, 8.5456, 488.0)


def test_without_a_place_on_earth_there_is_no_origin_and_no_gnss() -> None:
    simulation = simulate(Scenario(duration_s=5.0, geographic=False, pose_fix=PoseFixes()), 0)
    assert simulation.origin is None
    assert "map" not in tomllib.loads(simulation.config_toml)
    np.testing.assert_array_equal(simulation.truth.gyro_b, simulation.truth.omega_b)
    with pytest.raises(ValueError, match="no GNSS"):
        Scenario(geographic=False, gnss=Gnss())


@pytest.mark.parametrize(("duration_s", "rate_hz"), [(86_400.0, 10_000.0), (60.0, 1e-9)])
def test_more_samples_than_fit_into_memory_or_none_are_refused(duration_s: float, rate_hz: float) -> None:
    with pytest.raises(ValueError, match=r"^duration_s, rate_hz: .* IMU samples; wanted are 1 to 2e\+07$"):
        Scenario(duration_s=duration_s, imu=Imu(rate_hz=rate_hz))


def test_truth_since() -> None:
    truth = simulate(Scenario(duration_s=5.0), 0).truth
    late = truth.since(EPOCH_NS + 2_000_000_001)
    assert late.t_ns[0] == EPOCH_NS + 2_005_000_000
    assert len(late.p_n) == len(late.t_ns) == len(truth.t_ns) - 401


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_examples_are_scenarios(path: Path) -> None:
    simulation = simulate(loads(path.read_text(), path.name), 0)
    assert len(simulation.messages) > 10_000


def test_all_examples_are_found() -> None:
    assert {p.stem for p in EXAMPLES} >= {"demo", "rare_fixes", "fixed_wing", "spoof", "imu_dropout", "late_and_shuffled"}


def test_file_becomes_the_scenario_it_describes() -> None:
    scenario = loads("""
        name = "test"
        duration_s = 60
        [vehicle]
        kind = "multirotor"
        speed_m_s = 4
        [pose_fix]
        delay_s = [0, 2.5]
        outages_s = [[10, 20], [30.0, 40.0]]
        [[pose_fix.false_spans]]
        start_s = 5
        end_s = 6
        offset_n_m = [1, 0, 0]
        [[faults]]
        kind = "spoof_jump"
        start_s = 3.0
        offset_n_m = [100, 0, 0]
    """)
    assert scenario.vehicle == Multirotor(speed_m_s=4.0)
    assert scenario.pose_fix is not None
    assert scenario.pose_fix.delay_s == (0.0, 2.5)
    assert scenario.pose_fix.outages_s == ((10.0, 20.0), (30.0, 40.0))
    assert scenario.pose_fix.false_spans[0].offset_n_m == (1.0, 0.0, 0.0)
    assert scenario.faults == (SpoofJump(start_s=3.0, offset_n_m=(100.0, 0.0, 0.0)),)
    assert scenario.gnss is None


def test_a_second_imu_is_on_a_topic_of_its_own_has_errors_of_its_own_and_changes_nothing_else() -> None:
    both = msgspec.structs.replace(FULL, other_imus=(Imu(grade="hobby", rate_hz=50.0),))
    alone, simulation = simulate(FULL, 1), simulate(both, 1)
    second = [m for m in simulation.messages if isinstance(m, ImuSample) and m.topic == "/imu2"]
    rest = [m for m in simulation.messages if not (isinstance(m, ImuSample) and m.topic == "/imu2")]
    assert [repr(m) for m in rest] == [repr(m) for m in alone.messages]
    assert second[1].t_ns - second[0].t_ns == 20_000_000
    truth = simulation.truth
    at = np.searchsorted(truth.t_ns, [m.t_ns for m in second])
    off = np.array([m.gyro_b for m in second]) - truth.gyro_b[at]
    assert 1e-4 < np.abs(off.mean(axis=0)).max() < 0.1  # a turn-on bias of 0.5 deg/s
    assert np.abs(off.mean(axis=0) - truth.gyro_bias[at].mean(axis=0)).max() > 1e-4
    assert 'imu = ["/imu", "/imu2"]' in simulation.config_toml


def test_beacons_are_asked_in_turn_within_reach_and_the_configuration_names_them() -> None:
    beacons = Beacons(at_n_m=((30.0, 0.0, 0.0), (0.0, 500.0, 0.0)), rate_hz=5.0, sigma_m=0.1, slow_sigma_m=0.0)
    with_them = simulate(msgspec.structs.replace(FULL, beacons=beacons), 1)
    ranges = [m for m in with_them.messages if isinstance(m, Reading)]
    assert {m.topic for m in ranges} == {"/beacon/1"}  # the other is out of reach
    assert len(ranges) == pytest.approx(100, abs=1)
    rows = np.searchsorted(with_them.truth.t_ns, [m.t_ns for m in ranges])
    true = np.linalg.norm(with_them.truth.p_n[rows] - beacons.at_n_m[0], axis=1)
    assert np.std([m.values[0] for m in ranges] - true) == pytest.approx(0.1, rel=0.3)
    config = tomllib.loads(with_them.config_toml)
    assert config["inputs"]["beacon"] == ["/beacon/1", "/beacon/2"]
    assert config["beacon"]["at_n_m"][1] == [0.0, 500.0, 0.0]
    assert text(simulate(FULL, 1).messages) == text([m for m in with_them.messages if not isinstance(m, Reading)])
