"""What would stop `landfix run`, or harm it, is found before the flight: with real sockets, devices and files."""

import os
import pty
import socket
from pathlib import Path

import msgspec
import pytest

from calib.files.formats import save_rig
from estimator.config import Config, load
from estimator.service.log.recovery import FolderLock
from estimator.tools.doctor import flight as doctor_flight
from estimator.tools.doctor.machine import Check, State
from vision.synthetic import make_rig

ROOT = os.geteuid() == 0


def checked(folder: Path, text: str) -> dict[str, Check]:
    """The findings about a configuration, by name."""
    (folder / "vehicle.toml").write_text(f'[log]\nfolder = "{folder / "logs"}"\n{text}')
    return {c.name: c for c in doctor_flight.flight(load(folder / "vehicle.toml"), folder)}


def test_a_vehicle_as_it_should_be_has_nothing_to_complain_about(tmp_path: Path) -> None:
    found = checked(tmp_path, "[zenoh]\nlisten = ['tcp/127.0.0.1:0']\n[mavlink]\nendpoint = 'udpin:127.0.0.1:0'\n")
    assert {c.state for c in found.values()} == {State.OK}
    assert found["zenoh.listen"].found == "tcp/127.0.0.1:0: this machine only"
    assert not (tmp_path / "logs").exists()


def test_ports_that_are_taken_are_said(tmp_path: Path) -> None:
    with socket.socket() as stream, socket.socket(type=socket.SOCK_DGRAM) as datagrams:
        stream.bind(("127.0.0.1", 0))
        stream.listen()
        datagrams.bind(("127.0.0.1", 0))
        zenoh, mavlink = stream.getsockname()[1], datagrams.getsockname()[1]
        found = checked(
            tmp_path,
            f"[zenoh]\nlisten = ['tcp/127.0.0.1:{zenoh}']\nconnect = ['tcp/127.0.0.1:{zenoh}', 'tcp/127.0.0.1:1']\n"
            f"[mavlink]\nendpoint = 'udpin:127.0.0.1:{mavlink}'\n",
        )
    for name in ("zenoh.listen", "mavlink.endpoint"):
        assert (found[name].state, "address already in use" in found[name].found) == (State.WARN, True)
        assert "another program has it" in found[name].advice
    assert found["zenoh.connect"].found == "tcp/127.0.0.1:1: no answer"


def test_an_address_of_another_computer_is_said(tmp_path: Path) -> None:
    found = checked(tmp_path, "[zenoh]\nlisten = ['tcp/192.0.2.1:7447#iface=lo']\n[zenoh.security]\ninsecure = true\n")[
        "zenoh.listen"
    ]
    assert (found.state, "no such address" in found.advice) == (State.WARN, True)


def test_somebody_who_answers_is_found(tmp_path: Path) -> None:
    with socket.socket() as router:
        router.bind(("127.0.0.1", 0))
        router.listen()
        found = checked(tmp_path, f"[zenoh]\nlisten = []\nconnect = ['tcp/127.0.0.1:{router.getsockname()[1]}']\n")
    assert (found["zenoh.connect"].state, found["zenoh.connect"].found.endswith(": answers")) == (State.OK, True)


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ("[zenoh]\nlisten = ['tcp/0.0.0.0:0']\n", "zenoh", "is open to everybody in reach"),
        ("[zenoh]\nlisten = []\n[zenoh.security]\nuser = 'a'\npassword_file = 'no.txt'\n", "zenoh", "no.txt"),
        ("[zenoh]\nlisten = []\n[zenoh.security]\nuser = 'a'\npassword_file = 'noise'\n", "zenoh", "is not a text file"),
        ("[zenoh]\nlisten = ['7447']\n", "zenoh", "is not PROTOCOL/HOST:PORT"),
        ("[zenoh]\nconnect = ['tcp/127.0.0.1:99999']\n", "zenoh", "is not PROTOCOL/HOST:PORT"),
        ("[zenoh]\nlisten = ['tcp/127.0.0.1']\n", "zenoh", "is not PROTOCOL/HOST:PORT"),
        ("[mavlink]\nendpoint = '/dev/null'\nbaud = 12345\n", "mavlink", "is not a speed"),
        ("[mavlink]\nendpoint = '/tmp'\n", "mavlink.endpoint", "is no serial device"),
        ("[mavlink]\nendpoint = 'udp:here'\n", "mavlink", "is not udpin:HOST:PORT"),
        ("[mavlink]\nendpoint = 'udpin:0.0.0.0:14540'\n", "mavlink", "anybody in reach could feed it"),
        ("[mavlink]\nendpoint = 'udpin:127.0.0.1:0'\nsigning_key_file = 'key'\n", "mavlink", "no such file"),
        ("[rig]\nfile = 'rig.yaml'\n", "rig", "rig.yaml"),
    ],
)
def test_what_run_would_refuse_fails(text: str, name: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("left: 3\n")
    (tmp_path / "noise").write_bytes(b"\xff\xfe\xfd")
    (tmp_path / "noise").chmod(0o600)
    found = checked(tmp_path, text)[name]
    assert found.state is State.FAIL
    assert said in found.found
    assert found.advice


def test_a_secret_that_others_can_use_is_refused_with_what_to_type(tmp_path: Path) -> None:
    for name in ("key", "ca.pem", "us.pem"):
        (tmp_path / name).write_text("a secret of two")
    key = tmp_path / "key"
    certificate = "ca_file = 'ca.pem'\ncertificate_file = 'us.pem'\nkey_file = 'key'\n"
    for text, name in (
        ("[mavlink]\nendpoint = 'udpout:127.0.0.1:14540'\nsigning_key_file = 'key'\n", "mavlink.signing_key_file"),
        ("[zenoh]\nlisten = []\n[zenoh.security]\nuser = 'a'\npassword_file = 'key'\n", "zenoh.security.password_file"),
        ("[zenoh]\nlisten = []\n[zenoh.security]\nusers_file = 'key'\n", "zenoh.security.users_file"),
        (f"[zenoh]\nlisten = []\n[zenoh.security]\n{certificate}", "zenoh.security.key_file"),
    ):
        for mode in (0o644, 0o640, 0o604, 0o620, 0o601):
            key.chmod(mode)
            found = checked(tmp_path, text)[name.partition(".")[0]]
            assert found.state is State.FAIL
            assert found.found == f"{name} = {key}: others may use this secret; type: chmod 600 {key}"
        key.chmod(0o600)
        assert checked(tmp_path, text)[name].state is State.OK


def test_a_folder_of_logs_that_anybody_can_read_is_said(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    for mode, said in ((0o755, True), (0o701, True), (0o750, False), (0o700, False)):
        folder.chmod(mode)
        found = checked(tmp_path, "[zenoh]\nenabled = false\n")
        assert ("log.permissions" in found) is said
        assert not said or f"chmod 750 {folder}" in found["log.permissions"].advice


def test_a_state_that_cannot_be_kept_is_said(tmp_path: Path) -> None:
    found = checked(tmp_path, "[service]\nstate_file = '/nowhere/landfix.state'\n")["service.state_file"]
    assert (found.state, "cannot be written" in found.found) == (State.WARN, True)


def test_a_serial_device_is_there_or_not(tmp_path: Path) -> None:
    near, far = pty.openpty()
    try:
        there = checked(tmp_path, f"[mavlink]\nendpoint = '{os.ttyname(far)}'\n")["mavlink.endpoint"]
    finally:
        os.close(near)
        os.close(far)
    gone = checked(tmp_path, "[mavlink]\nendpoint = '/dev/ttyNONE7'\n")["mavlink.endpoint"]
    assert (there.state, gone.state) == (State.OK, State.WARN)
    assert "is not there" in gone.found


@pytest.mark.skipif(ROOT, reason="root may do anything")
def test_a_device_and_a_folder_that_are_not_ours_fail(tmp_path: Path) -> None:
    (tmp_path / "tty").touch(mode=0)
    closed = tmp_path / "logs"
    closed.mkdir(mode=0o500)
    found = checked(tmp_path, f"[mavlink]\nendpoint = '{tmp_path / 'tty'}'\n")
    assert found["mavlink.endpoint"].state is State.FAIL
    assert found["log.folder"].state is State.FAIL


def test_a_folder_where_another_records_is_said(tmp_path: Path) -> None:
    with FolderLock(tmp_path / "logs"):
        found = checked(tmp_path, "")["log.folder"]
    assert (found.state, "another landfix records there" in found.found) == (State.WARN, True)


def test_little_room_for_the_log_is_said(tmp_path: Path) -> None:
    assert checked(tmp_path, "least_free_mb = 1e9\n")["log.folder"].state is State.FAIL


def test_cameras_in_part_are_said(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.yaml", make_rig())
    found = checked(tmp_path, "[rig]\nfile = 'rig.yaml'\n")
    assert found["rig"].state is State.OK
    assert found["vision"].advice == "give [map] landmarks or picture, or leave the rig out"
    assert "640 x 480 px" in found["rig"].found


def test_a_rig_that_does_not_say_how_good_it_is_is_said(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.yaml", msgspec.structs.replace(make_rig(), covariance_rc=None))
    found = checked(tmp_path, "[rig]\nfile = 'rig.yaml'\n")["rig"]
    assert (found.state, "calibrate" in found.advice) == (State.WARN, True)


def test_code_that_others_may_change_is_said(tmp_path: Path) -> None:
    code = tmp_path / "filter.py"
    code.write_text("pass\n")
    assert doctor_flight.package(tmp_path).state is State.OK
    assert doctor_flight.package(tmp_path, owners=[code.stat().st_uid + 1]).state is State.WARN
    code.chmod(0o666)
    found = doctor_flight.package(tmp_path)
    assert (found.state, str(code) in found.found) == (State.WARN, True)


def test_defaults_are_checked_without_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").mkdir()
    assert not any(c.state is State.FAIL for c in doctor_flight.flight(Config(), tmp_path))
    assert list(tmp_path.rglob("*")) == [tmp_path / "logs"]


@pytest.mark.parametrize("example", sorted(Path("examples").glob("vehicle*.toml")), ids=lambda p: p.stem)
def test_examples_are_checked_to_the_end(example: Path) -> None:
    names = {c.name for c in doctor_flight.flight(load(example), example.parent)}
    assert names >= {"log.folder", "package"}
