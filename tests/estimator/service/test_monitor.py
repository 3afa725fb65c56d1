"""`landfix monitor`: what it makes of what it hears."""

import subprocess
import sys
import threading
from io import StringIO
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console

from estimator.config import parse
from estimator.service.base.status import Status
from estimator.service.monitor import View
from logs.wire import cdr_fast
from logs.wire.codec import encode
from models.messages import AidStatus, Alert, Health, Integrity, LastGnss, Mode, Reason
from tests.estimator.service.flying import client, environment, fly, free_port, in_thread, toml

T0 = 1_795_000_000_000_000_000


def _text(view: View, now_s: float) -> str:
    paper = Console(file=StringIO(), width=120)
    paper.print(view.render(now_s, "tcp/somewhere"))
    assert isinstance(paper.file, StringIO)
    return paper.file.getvalue()


def test_silence_is_reported_and_how_long_it_lasts() -> None:
    view = View()
    assert "nothing heard yet from tcp/somewhere" in _text(view, 5.0)
    for message in encode(Health(T0, T0, Mode.AIDED, 0.5, 1.25, 0.5, 0, {}, {}, 1)):
        view.hear(message.topic, message.data, 10.0)
    assert "1.25 m" in _text(view, 11.0)
    assert "nothing heard for 7 s" in _text(view, 17.0)


def test_integrity_is_shown_with_its_limits_and_the_reason() -> None:
    view = View()
    wide = Integrity(T0, T0, Alert.DO_NOT_USE, "HPL unbounded", 1e-5, np.inf, 4.04, 10.0, np.inf, (), (), (), 1.0, 1.0)
    view.hear("/landfix/integrity", encode(wide)[0].data, 1.0)
    text = _text(view, 1.5)
    assert "do not use   HPL unbounded, VPL 4.0 m at 1e-05 per hour" in text
    good = msgspec.structs.replace(wide, state=Alert.USABLE, reason="", hpl_m=3.21)
    view.hear("/landfix/integrity", encode(good)[0].data, 1.0)
    assert "usable   HPL 3.2 of 10 m, VPL 4.0 m at 1e-05 per hour" in _text(view, 1.5)


def test_what_peers_send_is_text_and_neither_markup_nor_control_characters() -> None:
    view = View()
    topic = "/gnss[bold]\x1b]0;mine\x07\x1b[2J"
    for message in encode(AidStatus(T0, T0, topic, "gnss", Reason.GATED, detail="[red]\x1b[31m")):
        view.hear("/landfix/aid_status", message.data, 1.0)
    text = _text(view, 1.5)
    assert "/gnss[bold]" in text
    assert "\x1b" not in text
    assert "\x07" not in text


def test_bytes_and_values_that_no_daemon_sends_are_named_and_the_screen_goes_on() -> None:
    view = View()
    (health,) = encode(Health(T0, T0, Mode.AIDED, 0.5, 1.25, 0.5, 0, {}, {}, 1))
    view.hear(health.topic, health.data, 1.0)
    view.hear(health.topic, health.data[:60], 1.0)
    text = _text(view, 1.5)
    assert "1.25 m" in text
    assert "malformed messages on /landfix/health: 1" in text
    view.hear(health.topic, health.data.replace(b"1.25", b"1.x5"), 1.0)
    assert "malformed: could not convert string to float: '1.x5'" in _text(view, 1.5)


def test_a_flag_of_the_receiver_is_shown_with_its_source_as_long_as_it_is_raised() -> None:
    view = View()
    for detail in ("", "the receiver reports jamming"):
        view.hear("/landfix/aid_status", encode(AidStatus(T0, T0, "/gnss", "gnss", Reason.FUSED, detail=detail))[0].data, 1.0)
        (line,) = (line for line in _text(view, 1.5).splitlines() if "/gnss" in line)
        assert ("jamming" in line) == bool(detail)


def test_the_rate_is_that_of_the_stamps_however_fast_they_are_read() -> None:
    view = View()
    for k in range(300):
        values = np.zeros(85)
        values[6] = 1.0
        view.hear("/landfix/odometry", cdr_fast.odometry(T0 + k * 2_500_000, values), 1.0 + 1e-4 * k)
    assert "400 Hz" in _text(view, 1.5)


def test_it_draws_while_more_is_heard() -> None:
    view, drawn, interval = View(), threading.Event(), sys.getswitchinterval()
    data = encode(AidStatus(T0, T0, "/pose_fix", "pose", Reason.FUSED))[0].data

    def hear() -> None:
        while not drawn.is_set():
            view.hear("/landfix/aid_status", data, 1.0)

    zenoh = threading.Thread(target=hear)
    zenoh.start()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(30):
            assert view.render(1.0, "tcp/somewhere")
    finally:
        sys.setswitchinterval(interval)
        drawn.set()
        zenoh.join()


def test_a_source_is_shown_with_its_state_and_the_fate_of_its_measurements() -> None:
    view = View()
    for k in range(7):
        reason = Reason.GATED if k == 3 else Reason.FUSED
        status = AidStatus(T0, T0, "/pose_fix", "pose", reason, test_ratio=0.1 * k, delay_s=0.25)
        view.hear("/landfix/aid_status", encode(status)[0].data, 1.0)
    last = LastGnss(47.0, 8.0, 400.0, 3.0, 2.0)
    health = Health(T0, T0, Mode.DEAD_RECKONING, 12.3, 8.5, 0.5, 2, {"/pose_fix": "starting"}, {}, 1, last)
    view.hear("/landfix/health", encode(health)[0].data, 1.0)
    text = _text(view, 1.5)
    (line,) = (line for line in text.splitlines() if "/pose_fix" in line)
    for said in ("starting", "250 ms", "0.30", "6 fused", "1 gated"):
        assert said in line
    for said in ("dead_reckoning", "12.3 s ago", "8.50 m", "2 resets"):
        assert said in text


def test_odometry_that_carries_the_estimate_is_the_mode_and_has_its_line() -> None:
    view = View()
    for reason in (Reason.FUSED, Reason.FUSED, Reason.GATED):
        status = AidStatus(T0, T0, "/odometry", "odometry", reason, test_ratio=0.2)
        view.hear("/landfix/aid_status", encode(status)[0].data, 1.0)
    health = Health(T0, T0, Mode.ODOMETRY, 31.0, 2.5, 0.5, 0, {"/odometry": "active"}, {}, 1)
    view.hear("/landfix/health", encode(health)[0].data, 1.0)
    lines = _text(view, 1.5).splitlines()
    assert any(line.split()[1:3] == ["mode", "odometry"] for line in lines)
    assert any(all(said in line for said in ("/odometry", "active", "2 fused", "1 gated")) for line in lines)


def test_links_and_defects_are_shown_where_there_are_any() -> None:
    values = {
        "vision": {"state": "does not answer", "fixes": 7, "pairs": 9, "latency_ms": 43.5, "restarts": 2},
        "mavlink": {
            "state": "open", "autopilot": "px4", "heard_s": "0.2", "odometry": 30, "quality": 87, "fixes": 4,
            "ekf_origin": "3 m north, 0 m east, 1 m above the map's", "attitude": "not taken: its compass is dead",
            "receiver": "1: authenticated",
        },
        "px4": {
            "clock_ahead_s": "unknown", "odometry": 0, "quality": "none sent", "fixes": 0,
            "ekf_origin": "not known: ODOMETRY has quality -1",
        },
    }  # fmt: skip
    view, status = View(), Status(T0, {name: lambda part=part: part for name, part in values.items()})  # type: ignore[misc]
    status.note_defect("KeyError: 7")
    report = status.report(T0)
    assert report is not None
    view.hear(report.topic, report.data, 1.0)
    text = _text(view, 1.5)
    assert "does not answer   7 fixes of 9 pairs, 43.5 ms, 2 restarts" in text
    assert "open   px4 heard 0.2 s ago, sent 30 odometry (quality 87), 4 fixes" in text
    assert "nothing of fmu/out comes, sent 0 odometry (quality none sent), 0 fixes" in text
    for said in (
        "3 m north, 0 m east",
        "not taken: its compass is dead",
        "not known: ODOMETRY has quality -1",
        "1: authenticated",
    ):
        assert said in text
    assert "1, the last: KeyError: 7" in text


@pytest.mark.long
def test_it_watches_a_daemon_and_draws_it(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port)
    (tmp_path / "v.toml").write_text(text)
    command = [sys.executable, "-m", "estimator", "monitor", "-c", str(tmp_path / "v.toml")]
    with in_thread(parse(text), tmp_path), client(port) as session:
        words = ["--seconds", "6", "--svg", str(tmp_path / "now.svg")]
        with (tmp_path / "screen.txt").open("w") as screen:
            watching = subprocess.Popen([*command, *words], env=environment() | {"COLUMNS": "110"}, stdout=screen)
        while watching.poll() is None:
            fly(session, 3.0)
        asked = subprocess.run([*command, "--json"], env=environment(), capture_output=True, text=True, check=True)
    seen = (tmp_path / "screen.txt").read_text()
    assert watching.returncode == 0
    for said in ("mode", "north", "/gnss/velocity", "sensor to estimate", "recording", str(tmp_path / "logs")[:20]):
        assert said in seen
    assert "/gnss/velocity" in (tmp_path / "now.svg").read_text().replace("&#160;", " ")
    assert msgspec.json.decode(asked.stdout)["daemon"]["log state"] == "recording"


def test_without_a_daemon_it_reports_it_in_one_line() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    result = subprocess.run(
        [sys.executable, "-m", "estimator", "monitor", "--connect", endpoint],
        env=environment(), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 1
    assert result.stderr == f"landfix: {endpoint}: no daemon listens there, or it refuses the connection\n"
