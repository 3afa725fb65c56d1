"""examples/sitl_fixes.py: the truth of a simulator becomes fixes, as PX4 and as ArduPilot tell it, and they arrive over Zenoh."""

import os
import runpy
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from pymavlink.dialects.v20 import common as mavlink

from estimator.config import load
from logs.wire.codec import Decoder
from models import so3
from models.frames import Origin
from models.messages import PoseFix
from tests.estimator.service.autopilots import ARDUPILOT, UdpAutopilot
from tests.estimator.service.flying import free_port, until

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPT = EXAMPLES / "sitl_fixes.py"
SCHEMA = "geometry_msgs/msg/PoseWithCovarianceStamped"
Q_NB = so3.from_euler(0.05, -0.1, 2.0)
AT_N = (12.0, -7.0, -30.0)


def _px4(lat: float, lon: float, alt_m: float) -> Any:
    place = round(lat * 1e7), round(lon * 1e7), round(alt_m * 1e3)
    return mavlink.MAVLink_hil_state_quaternion_message(0, Q_NB.tolist(), 0, 0, 0, *place, 0, 0, 0, 0, 0, 0, 0, 0)


def _ardupilot(lat: float, lon: float, alt_m: float) -> Any:
    rest = 0, 0, 0, 0, 0, 0, 0, 0, 0, lat * 1e7, lon * 1e7, alt_m, 0, 0, 0, 0, 0
    return mavlink.MAVLink_sim_state_message(*Q_NB.tolist(), *rest, round(lat * 1e7), round(lon * 1e7))


@pytest.mark.parametrize(("name", "encode"), [("px4", _px4), ("ardupilot", _ardupilot)])
def test_a_simulators_truth_becomes_a_fix_about_the_origin(name: str, encode: Any) -> None:
    config, script = load(EXAMPLES / f"{name}_sitl.toml"), runpy.run_path(str(SCRIPT))
    assert config.map.origin is not None
    lat, lon, height_m = Origin(*config.map.origin).to_geodetic(AT_N)
    rng = np.random.default_rng(0)
    fixes = [script["fix"](encode(lat, lon, height_m - config.map.geoid_m), config, 5, rng) for _ in range(400)]
    off = np.array([fix.p_n for fix in fixes]) - AT_N
    turn = np.array([so3.quat_log(so3.multiply(np.array(fix.q_nb_wxyz), so3.conjugate(Q_NB))) for fix in fixes])
    spread = np.hstack((off, turn)) / script["SIGMA"]
    assert np.abs(spread.mean(axis=0)).max() < 0.25
    assert 0.85 < spread.std(axis=0).min() <= spread.std(axis=0).max() < 1.15
    np.testing.assert_allclose(np.diag(fixes[0].covariance), script["SIGMA"] ** 2)


def test_fixes_arrive_over_zenoh(tmp_path: Path) -> None:
    port, mavlink_port = free_port(), free_port()
    text = (EXAMPLES / "px4_sitl.toml").read_text().replace("tcp/127.0.0.1:7447", f"tcp/127.0.0.1:{port}")
    (tmp_path / "sitl.toml").write_text(text)
    settings, heard = zenoh.Config(), list[bytes]()
    settings.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    settings.insert_json5("scouting/multicast/enabled", "false")
    options = ["-c", str(tmp_path / "sitl.toml"), "--from", f"udpin:127.0.0.1:{mavlink_port}", "--every", "0.1"]
    with zenoh.open(settings) as session:
        subscriber = session.declare_subscriber("0/pose_fix/**", lambda sample: heard.append(sample.payload.to_bytes()))
        simulator = UdpAutopilot(to=mavlink_port)
        script = subprocess.Popen([sys.executable, str(SCRIPT), *options], env=os.environ | {"PYTHONPATH": str(EXAMPLES.parent)})
        try:

            def flies() -> bool:
                assert script.poll() is None
                simulator.heartbeat()
                simulator.listen(0.05)
                asked = {m.param1 for m in simulator.heard if m.get_type() == "COMMAND_LONG" and m.command == 511}
                if asked:
                    simulator.say(_px4(47.397742, 8.545594, 518.0))
                return len(heard) >= 3 and asked == {115.0}

            until(flies, "three fixes, and that the simulator is asked for its truth")
        finally:
            script.kill()
            script.wait()
            simulator.close()
            subscriber.undeclare()  # type: ignore[no-untyped-call]
    fix = Decoder().decode("/pose_fix", SCHEMA, heard[-1], 0)
    assert isinstance(fix, PoseFix)
    assert np.linalg.norm(np.array(fix.p_n) - (0.0, 0.0, -30.0)) < 3.0  # ten standard deviations


def test_it_waits_for_landfix_and_ends_with_ctrl_c_without_a_traceback(tmp_path: Path) -> None:
    port, mavlink_port = free_port(), free_port()
    text = (EXAMPLES / "ardupilot_sitl.toml").read_text().replace("tcp/127.0.0.1:7447", f"tcp/127.0.0.1:{port}")
    (tmp_path / "sitl.toml").write_text(text)
    settings = zenoh.Config()
    settings.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    settings.insert_json5("scouting/multicast/enabled", "false")
    options = ["-c", str(tmp_path / "sitl.toml"), "--from", f"udpin:127.0.0.1:{mavlink_port}"]
    environment = os.environ | {"PYTHONPATH": str(EXAMPLES.parent)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, str(SCRIPT), *options], env=environment, **pipes) as script:  # type: ignore[call-overload]
        try:
            assert script.stdout.readline() == f"waiting for landfix run at tcp/127.0.0.1:{port}\n"
            with zenoh.open(settings):
                assert "fixes go to" in script.stdout.readline()
                script.send_signal(signal.SIGINT)
                assert script.communicate(timeout=60.0) == ("", "")
        finally:
            script.kill()


def test_a_simulator_that_refuses_is_not_asked_again(tmp_path: Path) -> None:
    """ArduPilot says "No ap_message for mavlink id (115)" each time."""
    port, mavlink_port = free_port(), free_port()
    text = (EXAMPLES / "ardupilot_sitl.toml").read_text().replace("tcp/127.0.0.1:7447", f"tcp/127.0.0.1:{port}")
    (tmp_path / "sitl.toml").write_text(text)
    settings = zenoh.Config()
    settings.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    options = ["-c", str(tmp_path / "sitl.toml"), "--from", f"udpin:127.0.0.1:{mavlink_port}"]
    environment = os.environ | {"PYTHONPATH": str(EXAMPLES.parent)}
    with zenoh.open(settings):
        simulator = UdpAutopilot(ARDUPILOT, to=mavlink_port)
        script = subprocess.Popen([sys.executable, str(SCRIPT), *options], env=environment, stderr=subprocess.PIPE, text=True)

        def asked() -> list[Any]:
            return [m for m in simulator.heard if m.get_type() == "COMMAND_LONG" and m.command == 511]

        simulator.until(asked, "it is asked")
        simulator.say(mavlink.MAVLink_command_ack_message(511, mavlink.MAV_RESULT_DENIED))
        _, complaint = script.communicate(timeout=60.0)
        simulator.listen(0.1)
        assert [m.param1 for m in asked()] == [108.0]
        assert script.returncode == 1
        assert "does not send SIM_STATE (108)" in complaint
        simulator.close()
