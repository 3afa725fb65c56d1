"""A log that leads to no estimate: the reason and what to do, from replay, report, evaluate and doctor."""

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.config import Config
from estimator.replay.no_estimate import advice
from estimator.tools.doctor import log as doctor_log
from estimator.tools.doctor.machine import State
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from models.messages import GnssFix, GnssVelocity, ImuSample, Input
from models.sim.scenario import Simulation


def run(*args: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in args])


def of(simulation: Simulation, path: Path, wanted: Callable[[int, Input], bool], kind: str = "") -> Path:
    """The simulated flight without the messages that are not wanted, as if an importer of this kind had written it."""
    with Recorder(path, metadata={"import_kind": kind}) as recorder:
        for k, message in enumerate(simulation.messages):
            if wanted(k, message):
                recorder.write(*encode_input(message), message.arrived_ns)
    return path


def slow_imu(k: int, m: Input) -> bool:
    return isinstance(m, GnssFix) or (isinstance(m, ImuSample) and k % 500 == 0)


@pytest.mark.parametrize(
    ("wanted", "kind", "words"),
    [
        (lambda _, m: isinstance(m, ImuSample), "", "no GNSS or pose fix in the log"),
        (lambda _, m: isinstance(m, GnssFix), "", "no IMU sample in the log"),
        (slow_imu, "ulog", "SDLOG_PROFILE"),
        (slow_imu, "dataflash", "LOG_BITMASK"),
        (slow_imu, "tlog", "SR0_RAW_SENS"),
        (lambda _, m: isinstance(m, ImuSample | GnssVelocity), "ulog", "no GNSS position in the log"),
    ],
)
def test_the_last_line_reports_why_and_what_to_do(
    wanted: Callable[[int, Input], bool], kind: str, words: str, simulation: Simulation, tmp_path: Path
) -> None:
    log = of(simulation, tmp_path / "x.mcap", wanted, kind)
    result = run("replay", log, "-o", tmp_path / "out.mcap")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1].startswith("landfix: no estimate: ")
    assert words in result.stderr.splitlines()[-1]
    assert "0.00 m" not in result.stdout
    (check,) = [c for c in doctor_log.log(log, Config()) if c.name == "alignment"]
    assert (check.state, words in check.advice) == (State.FAIL, True)


def test_report_makes_a_page_and_evaluate_advises_no_second_replay(simulation: Simulation, tmp_path: Path) -> None:
    log, out = of(simulation, tmp_path / "x.mcap", lambda _, m: isinstance(m, ImuSample)), tmp_path / "out.mcap"
    run("replay", log, "-o", out)
    report = run("report", out, "-o", tmp_path / "x.html")
    assert report.exit_code == 0
    assert "no estimate" in report.stdout
    text = (tmp_path / "x.html").read_text()
    assert all(words in text for words in ("no estimate", "/imu", "200.0", "longest silence", "waiting for a position"))
    evaluated = run("evaluate", out)
    assert evaluated.exit_code == 1
    assert "waiting for a position" in evaluated.stderr
    assert "landfix replay" not in evaluated.stderr


def test_a_good_log_passes_the_check_of_the_alignment(flight: Path) -> None:
    (check,) = [c for c in doctor_log.log(flight, Config()) if c.name == "alignment"]
    assert check.state is State.OK


def test_fixes_of_another_type_are_named_with_it() -> None:
    of_type = {"/mocap": "is geometry_msgs/msg/PoseStamped, not geometry_msgs/msg/PoseWithCovarianceStamped"}
    said = advice("rosbag", 2000, 0, 10.0, {"/mocap": {"malformed": 14}, "/baro": {"fused": 20}}, of_type, "waiting")
    assert said.startswith("no GNSS or pose fix in the log that can be read: /mocap, 14 of them (is geometry_msgs")


def test_refused_measurements_are_named_with_their_reason() -> None:
    said = advice("", 2000, 50, 10.0, {"/gnss": {"not_psd": 50}}, {"/gnss": "covariance is zero"}, "waiting for a position")
    assert said.startswith("every measurement of /gnss was refused, 50 of 50 as not_psd (covariance is zero)")


@pytest.mark.parametrize(
    ("name", "start", "words"),
    [
        ("x.ulg", b"ULog\x01\x12\x35\x01 and more", "a PX4 log: landfix import ulog"),
        ("x.bin", b"\xa3\x95\x80\x80\x59FMT   ", "an ArduPilot dataflash log: landfix import dataflash"),
        ("x.tlog", b"\0\5\x1a\x2b\x3c\x4d\x5e\x6f\xfe", "a MAVLink telemetry log: landfix import tlog"),
        ("x.mcap.zst", b"\x28\xb5\x2f\xfd and more", "unpack it first: zstd -d"),
    ],
)
def test_logs_of_other_programs_are_known_by_their_first_bytes(name: str, start: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(start)
    result = run("report", tmp_path / name, "-o", tmp_path / "x.html")
    assert result.exit_code == 1
    assert words in result.stderr


def test_an_estimate_that_is_lost_for_want_of_imu_samples_reports_it(simulation: Simulation, tmp_path: Path) -> None:
    """GIVEN an IMU at 200 Hz for 3.5 s, and hardly any sample after it, THEN a line says why the estimate ended."""
    start_ns = simulation.messages[0].t_ns

    def wanted(k: int, m: Input) -> bool:
        late = m.t_ns - start_ns > 3_500_000_000
        return not isinstance(m, ImuSample) or not late or k % 500 == 0

    log = of(simulation, tmp_path / "x.mcap", wanted, "tlog")
    result = run("replay", log, "-o", tmp_path / "out.mcap")
    assert result.exit_code == 0
    assert "SR0_RAW_SENS" in result.stderr.splitlines()[-1]
    assert "an estimate for" in result.stderr.splitlines()[-1]
