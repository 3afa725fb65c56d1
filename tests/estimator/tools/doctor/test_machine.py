import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import Config, load, parse
from estimator.tools.doctor import log as doctor_log
from estimator.tools.doctor import machine
from estimator.tools.doctor.machine import Check, State
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from models.messages import AttitudePrior, GnssFix, ImuSample, Input, PoseFix
from models.sim.scenario import Simulation
from vision.synthetic import WorldSpec, make_world

Change = Callable[[Input], Input]


def named(checks: list[Check], name: str) -> Check:
    found = [c for c in checks if c.name == name]
    assert len(found) == 1, f"{name} not among {[c.name for c in checks]}"
    return found[0]


def rewritten(simulation: Simulation, path: Path, change: Change) -> Path:
    """The simulated flight with each message changed."""
    with Recorder(path) as recorder:
        for message in simulation.messages:
            changed = change(message)
            recorder.write(*encode_input(changed), changed.arrived_ns)
    return path


def scaled_imu(gyro: float, accel: float) -> Change:
    def change(m: Input) -> Input:
        if not isinstance(m, ImuSample):
            return m
        g, a = m.gyro_b, m.accel_b
        return ImuSample(
            m.t_ns, m.arrived_ns, (gyro * g[0], gyro * g[1], gyro * g[2]), (accel * a[0], accel * a[1], accel * a[2]), m.topic
        )

    return change


def test_this_machine_can_run_it() -> None:
    checks = machine.machine()
    assert {c.name for c in checks} == {
        "python",
        "libraries",
        "package names",
        "numba cache",
        "processors",
        "free disk",
        "clock",
        "system clock",
    }
    assert named(checks, "python").state is State.OK


def test_a_good_log_with_its_configuration_has_nothing_to_complain_about(flight: Path) -> None:
    checks = doctor_log.log(flight, load(flight.with_suffix(".toml")))
    assert [c for c in checks if c.state is not State.OK] == []
    assert "200.0 Hz" in named(checks, "/imu stamps").found
    assert "median 300.0 ms" in named(checks, "/pose_fix delay").found
    assert named(checks, "absolute source").found == "/gnss, /pose_fix"


@pytest.mark.parametrize(
    ("gyro", "accel", "check", "advice"),
    [
        (57.29578, 1.0, "/imu turn rate", "looks like deg/s"),
        (1.0, 1 / 9.80665, "/imu gravity", "looks like g"),
        (1.0, 0.01, "/imu gravity", "gravity is missing"),
        (1.0, -1.0, "/imu axes", 'set [imu] axes = "frd"'),
    ],
)
def test_wrong_units_and_axes_fail_with_what_to_do(
    gyro: float, accel: float, check: str, advice: str, simulation: Simulation, tmp_path: Path
) -> None:
    checks = doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", scaled_imu(gyro, accel)), Config())
    assert named(checks, check).state is State.FAIL
    assert advice in named(checks, check).advice


def test_other_topics_of_the_right_type_are_proposed(simulation: Simulation, tmp_path: Path) -> None:
    def change(m: Input) -> Input:
        return msgspec.structs.replace(m, topic="/mavros/imu") if isinstance(m, ImuSample) else m

    checks = doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", change), Config())
    imu = named(checks, "inputs.imu")
    assert imu.state is State.FAIL
    assert imu.advice.endswith('set [inputs] imu = "/mavros/imu"')


def test_an_attitude_to_begin_with_is_not_proposed_as_a_pose_fix(simulation: Simulation, tmp_path: Path) -> None:
    def change(m: Input) -> Input:
        return AttitudePrior(m.t_ns, m.arrived_ns, m.q_nb_wxyz, m.covariance[3:, 3:]) if isinstance(m, PoseFix) else m

    checks = doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", change), Config())
    assert "/attitude" not in named(checks, "inputs.pose_fix").advice


def test_an_accuracy_of_zero_is_reported(simulation: Simulation, tmp_path: Path) -> None:
    def change(m: Input) -> Input:
        return msgspec.structs.replace(m, covariance_n=np.zeros((3, 3))) if isinstance(m, GnssFix) else m

    found = named(doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", change), Config()), "/gnss accuracy")
    assert found.state is State.WARN
    assert "horizontal_sigma_m 1.5" in found.found


def test_measurements_that_are_all_refused_are_reported(simulation: Simulation, tmp_path: Path) -> None:
    def change(m: Input) -> Input:
        return msgspec.structs.replace(m, covariance=-np.eye(6)) if isinstance(m, PoseFix) else m

    found = named(doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", change), Config()), "/pose_fix content")
    assert found.state is State.FAIL
    assert "unsupported" in found.found


def test_without_anything_absolute_it_fails(flight: Path) -> None:
    checks = doctor_log.log(flight, parse("[inputs]\ngnss = []\npose_fix = []\n"))
    assert named(checks, "absolute source").state is State.FAIL


def test_a_clock_that_is_off_shows_in_the_delay(simulation: Simulation, tmp_path: Path) -> None:
    def change(m: Input) -> Input:
        return m if isinstance(m, ImuSample) else msgspec.structs.replace(m, t_ns=m.t_ns + 10**9)

    checks = doctor_log.log(rewritten(simulation, tmp_path / "x.mcap", change), Config())
    assert named(checks, "/gnss delay").state is State.FAIL
    assert "before their stamp" in named(checks, "/gnss delay").found
    assert named(checks, "/imu delay").state is State.OK


def test_torn_bytes_and_a_torn_file_are_reported(flight: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(flight.read_bytes()[: flight.stat().st_size // 2])
    assert named(doctor_log.log(torn, Config()), "log").state is State.WARN
    (tmp_path / "no.mcap").write_text("no log")
    assert machine.failed(doctor_log.log(tmp_path / "no.mcap", Config()))
    with Recorder(tmp_path / "bad.mcap") as recorder:
        recorder.write("/imu", "sensor_msgs/msg/Imu", b"\0\1\0\0torn", 1)
    checks = doctor_log.log(tmp_path / "bad.mcap", Config())
    assert named(checks, "/imu content").state is State.FAIL


def test_a_configuration_with_units_of_a_data_sheet_is_doubted(tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    file.write_text("[imu]\ngyro_noise = 0.3\n[map]\nlandmarks = 'gone.geojson'\n")
    checks, config = machine.configuration(file)
    assert config is not None
    assert named(checks, "imu.gyro_noise").state is State.WARN
    assert named(checks, "imu.accel_noise").state is State.OK
    assert named(checks, "map.landmarks").state is State.FAIL
    assert "map.origin" not in {c.name for c in checks}


def test_a_map_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    file.write_text("[map]\nlandmarks = 'torn.geojson'\n")
    (tmp_path / "torn.geojson").write_text('{"type": "Feat')
    checks, config = machine.configuration(file)
    assert config is not None
    assert named(checks, "map.landmarks").state is State.OK
    origin = named(checks, "map.origin")
    assert origin.state is State.FAIL
    assert "torn.geojson" in origin.found
    assert "\n" not in origin.found


def test_the_origin_of_the_map_is_that_of_its_landmarks(tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    file.write_text("[map]\nlandmarks = 'map.geojson'\n")
    (tmp_path / "map.geojson").write_bytes(make_world(1, WorldSpec(area_m=60.0, origin=(47.0, 8.0, 500.0))).map.to_geojson())
    checks, config = machine.configuration(file)
    assert [c for c in checks if c.state is State.FAIL] == []
    assert config is not None
    assert config.map.origin == pytest.approx((47.0, 8.0, 500.0))


def test_the_command_exits_with_1_when_something_fails(flight: Path, tmp_path: Path) -> None:
    def run(*args: object) -> tuple[int, dict[str, object]]:
        result = CliRunner().invoke(app, ["doctor", "--json", *map(str, args)])
        return result.exit_code, json.loads(result.stdout)

    assert run()[0] == 0
    code, answer = run(flight, "-c", flight.with_suffix(".toml"))
    assert (code, answer["failed"]) == (0, False)
    (tmp_path / "v.toml").write_text("[imu]\naxis = 1\n")
    code, answer = run(flight, "-c", tmp_path / "v.toml")
    assert (code, answer["failed"]) == (1, True)
    text = CliRunner().invoke(app, ["doctor", "-c", str(tmp_path / "v.toml")])
    assert text.exit_code == 1
    assert "fail" in text.stdout
    assert "did you mean 'axes'?" in " ".join(text.stdout.split())


def with_imu(simulation: Simulation, path: Path, change: Callable[[int, ImuSample], ImuSample]) -> Path:
    """The simulated flight with each IMU sample changed, as its number asks."""
    numbers = {id(m): k for k, m in enumerate(m for m in simulation.messages if isinstance(m, ImuSample))}
    return rewritten(simulation, path, lambda m: change(numbers[id(m)], m) if isinstance(m, ImuSample) else m)


def test_one_implausible_gyro_sample_is_no_wrong_unit(simulation: Simulation, tmp_path: Path) -> None:
    def spike(k: int, m: ImuSample) -> ImuSample:
        return msgspec.structs.replace(m, gyro_b=(60.0, 60.0, 60.0)) if k == 1500 else m

    check = named(doctor_log.log(with_imu(simulation, tmp_path / "x.mcap", spike), Config()), "/imu turn rate")
    assert (check.state, "1 samples beyond" in check.found, "deg/s" in check.advice) == (State.WARN, True, False)


def test_gyroscope_and_accelerometer_in_messages_of_their_own_are_found(simulation: Simulation, tmp_path: Path) -> None:
    def split(k: int, m: ImuSample) -> ImuSample:
        return msgspec.structs.replace(m, **{"gyro_b" if k % 2 else "accel_b": (0.0, 0.0, 0.0)})

    check = named(doctor_log.log(with_imu(simulation, tmp_path / "x.mcap", split), Config()), "/imu at fault")
    assert (check.state, "50%" in check.found) == (State.FAIL, True)
