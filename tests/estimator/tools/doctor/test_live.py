"""`landfix doctor --live`: running sensors over Zenoh, one page of what comes and what to set."""

import json
import re
import socket
import threading
from pathlib import Path

from typer.testing import CliRunner

from benchmarks.service.vehicle import Vehicle
from estimator.cli import app
from estimator.service.zenoh.keys import published_of, publisher_token
from logs.wire import schemas
from tests.estimator.service.flying import client, free_port, listening, toml, until


def _fly(port: int, done: threading.Event) -> None:
    """A vehicle that sends /imu, /gnss and poses, and a receiver on another topic than the configured one."""
    until(lambda: listening(port) or done.is_set(), "doctor listens")
    if done.is_set():
        return
    with client(port) as session:
        token = publisher_token(0, str(session.zid()), "driver", 1, "/fix", schemas.NAV_SAT_FIX, "RIHS01_0")
        kept = session.liveliness().declare_token(token)
        Vehicle(session, seed=1).fly(5.0, 200.0, gnss_hz=0.0, fix_hz=10.0)
        kept.undeclare()  # type: ignore[no-untyped-call]


def test_running_sensors_are_measured_and_what_is_missing_is_named(tmp_path: Path) -> None:
    port, file, done = free_port(), tmp_path / "vehicle.toml", threading.Event()
    file.write_text(toml(tmp_path, port, '[inputs]\ngnss = "/gps"\n[imu]\ngyro_noise = 1e-6'))
    flight = threading.Thread(target=_fly, args=(port, done))
    flight.start()
    try:
        result = CliRunner().invoke(app, ["doctor", "-c", str(file), "--live", "4", "--json"])
    finally:
        done.set()
        flight.join()
    checks = {check["name"]: check for check in json.loads(result.stdout)["checks"]}
    assert re.search(r"\n/imu \d+ Hz, /pose_fix \d+ Hz\n", result.stderr)  # each second
    assert checks["inputs.imu"]["found"] == "/imu"
    assert checks["inputs.gnss"]["found"] == "/gps did not come"
    assert checks["inputs.gnss"]["advice"] == 'other topics of its type are here: set [inputs] gnss = "/fix"'
    assert checks["/imu stamps"]["found"].endswith(" Hz, in order")
    assert checks["/imu delay"]["state"] == "ok"
    assert checks["/imu gyro_noise"]["advice"].startswith("set [imu] gyro_noise = 0.000")
    assert checks["/imu accel_noise"]["state"] == checks["/pose_fix noise"]["state"] == "ok"
    assert not (tmp_path / "logs").exists()  # nothing of it is kept


def test_a_port_that_a_daemon_holds_is_a_line_with_what_to_do(tmp_path: Path) -> None:
    port, file = free_port(), tmp_path / "vehicle.toml"
    file.write_text(toml(tmp_path, port))
    with socket.create_server(("127.0.0.1", port)):
        result = CliRunner().invoke(app, ["doctor", "-c", str(file), "--live", "3", "--json"])
    check = json.loads(result.stdout)["checks"][-1]
    assert (check["name"], check["state"]) == ("live", "fail")
    assert "end `landfix run` first" in check["advice"]


def test_a_publisher_s_token_names_topic_and_type() -> None:
    token = publisher_token(7, "zid", "node", 1, "/a/b", schemas.IMU, "RIHS01_x")
    assert published_of(token) == ("/a/b", schemas.IMU)
    assert published_of("@ros2_lv/0/zid") is None
