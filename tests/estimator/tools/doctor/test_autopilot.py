"""An autopilot of pymavlink that has parameters and is asked for them over UDP."""

import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import Config, parse
from estimator.tools.doctor import autopilot as doctor
from estimator.tools.doctor.machine import Check, State
from tests.estimator.service.autopilots import ARDUPILOT, PX4, UdpAutopilot

GOOD = {
    "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1, "EK3_SRC_OPTIONS": 0, "FS_EKF_ACTION": 1, "FS_EKF_THRESH": 0.8, "VISO_TYPE": 1,
    "VISO_QUAL_MIN": 20, "VISO_VEL_M_NSE": 1, "VISO_DELAY_MS": 10, "VISO_POS_X": 0, "VISO_POS_Y": 0, "VISO_POS_Z": 0,
    "VISO_ORIENT": 0, "VISO_SCALE": 1, "EK3_SRC1_POSXY": 3, "EK3_SRC1_VELXY": 3, "EK3_SRC2_POSXY": 6, "EK3_SRC2_VELXY": 6,
    "EK3_SRC3_POSXY": 0, "RC9_OPTION": 90, "GPS1_TYPE": 1, "GPS2_TYPE": 0, "GPS_AUTO_SWITCH": 1,
    "INS_GYRO_FILTER": 20, "INS_ACCEL_FILTER": 20,
}  # fmt: skip
GOOD_PX4 = {"EKF2_EV_CTRL": 15, "EKF2_EV_QMIN": 1, "EKF2_EV_DELAY": 0.0, "EKF2_EV_NOISE_MD": 0, "EKF2_EVA_NOISE": 0.003}


class _Answering(UdpAutopilot):
    """The first question for each parameter is lost."""

    def __init__(self, kind: int, parameters: dict[str, float], origin: bool = True) -> None:
        super().__init__(kind)
        self._parameters, self._origin, self._lost = parameters, origin, set[str]()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        super().close()

    def _live(self) -> None:
        while not self._stop.is_set():
            for message in self.listen(0.02):
                self._answer(message)
            self.heartbeat()

    def _answer(self, message: Any) -> None:
        if message.get_type() == "PARAM_REQUEST_READ":
            name = message.param_id
            if name in self._lost and name in self._parameters:
                self.say(self._value(name))
            self._lost.add(name)
        elif message.get_type() == "COMMAND_LONG" and message.command == 512:
            if message.param1 == 148:
                version = 4 << 24 | 6 << 16 | 3 << 8 | 255
                self.say(mavlink.MAVLink_autopilot_version_message(0, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0))
            elif self._origin:
                self.say(mavlink.MAVLink_gps_global_origin_message(473_986_000, 85_456_000, 440_500))

    def _value(self, name: str) -> Any:
        value = self._parameters[name]
        is_whole = isinstance(value, int)
        sent = struct.unpack("<f", struct.pack("<i", value))[0] if self.kind == PX4 and is_whole else float(value)
        kind = mavlink.MAV_PARAM_TYPE_INT32 if is_whole else mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(name.encode(), sent, kind, 1000, 5)


def _config(port: int, more: str = "fixes = false") -> str:
    return f'[map]\norigin = [47.3977, 8.5456, 488.0]\ngeoid_m = 47.5\n[mavlink]\nendpoint = "udpout:127.0.0.1:{port}"\n{more}\n'


@contextmanager
def _asked(
    kind: int, parameters: dict[str, float], more: str = "fixes = false", *, origin: bool = True
) -> Iterator[dict[str, Check]]:
    there = _Answering(kind, parameters, origin)
    try:
        yield {check.name: check for check in doctor.autopilot(parse(_config(there.port, more)), Path())}
    finally:
        there.close()


def test_an_autopilot_that_is_set_up_right_has_no_finding() -> None:
    with _asked(ARDUPILOT, GOOD) as checks:
        assert {check.state for check in checks.values()} == {State.OK}
        assert checks["autopilot"].found == "ArduPilot 4.6.3"
        assert checks["horizontal position from ODOMETRY"].found == "set 2"
        assert checks["switch of source sets"].found == "RC9"
        assert "12.0 m" in checks["odometry is used"].found
        assert "100 m north, 0 m east, 0 m up" in checks["origin of EKF3"].found


@pytest.mark.parametrize(
    ("name", "value", "state", "advice"),
    [
        ("AHRS_EKF_TYPE", 2, State.FAIL, "set 3"),
        ("EK3_SRC_OPTIONS", 1, State.FAIL, "set 0"),
        ("FS_EKF_ACTION", 0, State.WARN, "set 1"),
        ("VISO_TYPE", 0, State.FAIL, "reboot"),
        ("VISO_QUAL_MIN", -1, State.FAIL, "set 0 or more"),
        ("VISO_VEL_M_NSE", 0.1, State.FAIL, "set 1"),
        ("VISO_DELAY_MS", 200, State.WARN, "set 10"),
        ("VISO_POS_X", 0.3, State.FAIL, "set 0"),
        ("VISO_SCALE", 2.0, State.FAIL, "set 1"),
        ("EK3_SRC2_VELXY", 3, State.FAIL, "set 6"),
        ("INS_GYRO_FILTER", 4, State.WARN, "56 ms late"),  # a rover's default
    ],
)
def test_a_wrong_parameter_is_found_and_what_to_set_is_said(name: str, value: float, state: State, advice: str) -> None:
    with _asked(ARDUPILOT, GOOD | {name: value}) as checks:
        assert (checks[name].state, checks[name].found) == (state, f"{value:g}")
        assert advice in checks[name].advice
        assert [check.name for check in checks.values() if check.state is not State.OK] == [name]


def test_what_is_missing_is_found() -> None:
    lacking = {name: value for name, value in GOOD.items() if name not in {"VISO_QUAL_MIN", "RC9_OPTION"}} | {"EK3_SRC2_POSXY": 3}
    with _asked(ARDUPILOT, lacking, origin=False) as checks:
        assert (checks["VISO_QUAL_MIN"].state, checks["VISO_QUAL_MIN"].found) == (State.FAIL, "no such parameter")
        assert checks["horizontal position from ODOMETRY"].state is State.FAIL
        assert checks["switch of source sets"].state is State.WARN
        assert (checks["origin of EKF3"].state, checks["origin of EKF3"].found) == (State.WARN, "none yet")


def test_the_way_of_fixes_needs_a_receiver_and_no_velocity() -> None:
    with _asked(ARDUPILOT, GOOD | {"EK3_SRC2_POSXY": 0}, "odometry = false") as checks:
        assert checks["receiver for GPS_INPUT"].state is State.FAIL
        assert checks["GPS_AUTO_SWITCH"].state is State.FAIL
        assert checks["fixes while GNSS is good"].state is State.WARN
        assert checks["horizontal position from GPS_INPUT"].state is State.FAIL  # set 1 fuses a velocity that fixes have not
        assert "VISO_TYPE" not in checks
    good = GOOD | {"GPS2_TYPE": 14, "EK3_SRC2_POSXY": 3, "EK3_SRC2_VELXY": 0}
    with _asked(ARDUPILOT, good | {"GPS_AUTO_SWITCH": 4}, "odometry = false\n[autopilot]\nown_gnss = false") as checks:
        assert {check.state for check in checks.values()} == {State.OK}


def test_px4_sends_its_integers_as_bytes() -> None:
    with _asked(PX4, GOOD_PX4) as checks:
        assert {check.state for check in checks.values()} == {State.OK}
        assert checks["EKF2_EV_CTRL"].found == "15"
    with _asked(PX4, GOOD_PX4 | {"EKF2_EV_CTRL": 0, "EKF2_EV_QMIN": 0}) as checks:
        assert {name for name, check in checks.items() if check.state is State.FAIL} == {"EKF2_EV_CTRL", "EKF2_EV_QMIN"}
        assert "EKF2_EVA_NOISE" not in checks  # no yaw is taken
    with _asked(PX4, GOOD_PX4 | {"EKF2_EVA_NOISE": 0.1}) as checks:
        assert checks["EKF2_EVA_NOISE"].state is State.WARN


def test_nobody_there_no_endpoint_and_a_port_that_is_taken_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimator.service.mavlink.questions._PATIENCE_S", 0.3)
    silent = UdpAutopilot()
    (check,) = doctor.autopilot(parse(_config(silent.port)), Path())
    assert (check.state, "no HEARTBEAT" in check.found) == (State.FAIL, True)
    taken = parse(_config(silent.port).replace("udpout", "udpin"))
    (check,) = doctor.autopilot(taken, Path())
    assert (check.state, "in use" in check.found, "landfix run" in check.advice) == (State.FAIL, True, True)
    silent.close()
    (check,) = doctor.autopilot(Config(), Path())
    assert (check.state, "endpoint" in check.found) == (State.FAIL, True)


def test_the_command_asks_and_fails_where_something_is_wrong(tmp_path: Path) -> None:
    there = _Answering(ARDUPILOT, GOOD | {"VISO_TYPE": 0})
    (tmp_path / "vehicle.toml").write_text(_config(there.port))
    done = CliRunner().invoke(app, ["doctor", "-c", str(tmp_path / "vehicle.toml"), "--autopilot", "--json"])
    there.close()
    assert done.exit_code == 1
    assert '"VISO_TYPE"' in done.stdout
    assert CliRunner().invoke(app, ["doctor", "--autopilot"]).exit_code == 2
