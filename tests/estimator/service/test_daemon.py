"""The daemon from the outside: sensors over Zenoh in, estimates out, and a log that says the same again."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from benchmarks.service.vehicle import ORIGIN, gnss, imu, pose_fix, truth
from estimator.cli import app
from estimator.config import parse
from estimator.service.base.ports import Arrival
from estimator.service.run import assembled
from estimator.service.zenoh.keys import rmw_key
from logs.store.reader import LogReader
from logs.wire import schemas
from logs.wire.codec import Encoded, decode_odometry, encode_input, type_hash
from tests.estimator.service.flying import (
    ODOMETRY,
    ask,
    assert_replay_says_the_same,
    assert_sound,
    client,
    fly,
    free_port,
    in_thread,
    logs_of,
    records,
    standing,
    status,
    toml,
    until,
)

SECOND = 1_000_000_000
EXAMPLES = Path(__file__).parents[3] / "examples" / "zenoh"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, dict[str, int], int, dict[str, list[bytes]]]:
    """A flight of three seconds: the log, the configuration, what was sent, what came back, what a late joiner gets."""
    folder, port = tmp_path_factory.mktemp("flown"), free_port()
    text = toml(folder, port, zenoh_keys="ros2dds = true")
    with in_thread(parse(text), folder) as daemon, client(port) as session:
        vehicle = fly(session, 3.0, image_hz=5.0)
        until(lambda: len(daemon.mailbox) == 0, "all is handled")
        received = str(sum(vehicle.sent.values()))
        until(lambda: status(session).get("zenoh received") == received, "the status reports all")
        health = rmw_key(0, "/landfix/health", schemas.DIAGNOSTICS, type_hash(schemas.DIAGNOSTICS))
        keys = [health, "landfix/odometry", "landfix/status", "landfix/config", "landfix/map"]
        heard = {key: ask(session, key) for key in keys}
        heard["health"] = heard.pop(health)
        tokens = [reply.ok for reply in session.liveliness().get("@ros2_lv/**", timeout=5.0)]
        heard["tokens"] = [str(token.key_expr).encode() for token in tokens if token is not None]
    (log,) = logs_of(folder)
    return log, text, vehicle.sent, len(vehicle.latency_ns), heard


def test_every_input_is_in_the_log_and_every_image(flown: tuple[Path, str, dict[str, int], int, object]) -> None:
    log, _, sent, _, _ = flown
    logged = {topic: len(records(log, topic)) for topic in sent}
    assert logged == sent
    assert sent["/imu"] == 600


def test_estimates_come_back_and_are_right(flown: tuple[Path, str, dict[str, int], int, object]) -> None:
    log, _, _, received, _ = flown
    estimates = [decode_odometry(r.data) for r in records(log, ODOMETRY)]
    assert len(estimates) >= received > 300
    errors = np.array([np.subtract(e.p_n, truth(e.t_ns)[0]) for e in estimates[-100:]])
    sigma = np.sqrt([np.diag(e.pose_covariance)[:3] for e in estimates[-100:]])
    assert 0.01 < np.linalg.norm(errors, axis=1).mean() < 0.5
    assert (np.abs(errors) / sigma).max() < 5.0


def test_the_log_replayed_reports_the_same(flown: tuple[Path, str, dict[str, int], int, object]) -> None:
    log, text, *_ = flown
    assert_replay_says_the_same(log, text)


def test_others_can_read_the_log(flown: tuple[Path, str, dict[str, int], int, object]) -> None:
    log, text, sent, *_ = flown
    with AnyReader([log]) as reader:
        connections = [c for c in reader.connections if c.topic == ODOMETRY]
        message: Any = reader.deserialize(next(reader.messages(connections))[2], schemas.ODOMETRY)
        assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
        assert set(sent) <= {c.topic for c in reader.connections}
    with LogReader(log) as ours:
        assert list(ours)
        assert ours.metadata["landfix"].keys() == {"version", "config_sha256", "part"}
        assert [(a.name, a.data.decode()) for a in ours.attachments] == [("config.toml", parse(text).toml())]


def test_who_comes_late_is_reported(flown: tuple[Path, str, dict[str, int], int, dict[str, list[bytes]]]) -> None:
    log, text, sent, _, heard = flown
    (health,) = heard["health"]
    assert health in {r.data for r in records(log, "/landfix/health")}
    (last,) = heard["landfix/odometry"]
    assert last in {r.data for r in records(log, ODOMETRY)}
    assert heard["landfix/config"] == [parse(text).toml().encode()]
    assert heard["landfix/map"] == []
    values = json.loads(heard["landfix/status"][0])["daemon"]
    assert values["log state"] == "recording"
    assert values["log lost_inputs"] == "0"
    assert int(values["zenoh received"]) == sum(sent.values())


def test_ros_sees_the_node_and_its_topics(flown: tuple[Path, str, dict[str, int], int, dict[str, list[bytes]]]) -> None:
    tokens = [token.decode().split("/") for token in flown[-1]["tokens"]]
    assert [t[-1] for t in tokens if t[5] == "NN"] == ["landfix"]
    published = {t[9].replace("%", "/"): t[10] for t in tokens if t[5] == "MP"}
    assert published["/landfix/odometry"] == "nav_msgs::msg::dds_::Odometry_"
    assert len(published) == 9
    subscribed = {t[9].replace("%", "/") for t in tokens if t[5] == "MS"}
    assert {"/imu", "/gnss", "/pose_fix", "/landfix/fix", "/left/image"} <= subscribed
    assert "/landfix/tick" not in subscribed


def test_with_no_log_it_starts_where_it_is_told_and_flies_and_both_examples_work(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port, more="enabled = false\n[service]\nstate_file = ''")
    publish, subscribe = ([sys.executable, str(EXAMPLES / f"{name}.py")] for name in ("publish", "subscribe"))
    endpoint = f"tcp/127.0.0.1:{port}"
    with in_thread(parse(text), tmp_path), client(port) as session:
        with standing(session):
            typed = [
                "start",
                "--at",
                f"{ORIGIN.lat_deg},{ORIGIN.lon_deg}",
                "--heading",
                "90",
                "--sigma",
                "2",
                "--connect",
                endpoint,
            ]
            first, second = (CliRunner().invoke(app, typed) for _ in range(2))
        assert first.output.startswith("landfix has an estimate after "), first.output
        assert second.exit_code == 1
        assert "has an estimate already (mode " in second.output  # aided; coasting where a busy machine makes the IMU late
        subprocess.run([*publish, "0", "30", "40", "90", endpoint], check=True, timeout=180.0)
        until(lambda: b'"/pose_fix ' in ask(session, "landfix/status")[0], "the fix of the example is judged")
        with subprocess.Popen([*subscribe, "3", endpoint], stdout=subprocess.PIPE, text=True) as listener:
            for _ in range(20):
                vehicle = fly(session, 1.5)
                if listener.poll() is not None:
                    break
            printed, _ = listener.communicate(timeout=5.0)
    assert len(vehicle.latency_ns) > 50
    assert printed.count("one sigma") == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_an_oversized_message_is_refused_and_the_flight_goes_on(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port, zenoh_keys="largest_image_mb = 1")
    key = rmw_key(0, "/imu", schemas.IMU, type_hash(schemas.IMU))
    with in_thread(parse(text), tmp_path), client(port) as session, client(port) as other:
        before = fly(session, 1.0)
        for size in (100_000, 50_000_000):
            other.put(key, b"\0" * size)
        after = fly(session, 1.0)
        until(lambda: status(session).get("zenoh oversized") == "1", "it is reported")  # the larger one never came through
    assert len(before.latency_ns) > 50
    assert len(after.latency_ns) > 100
    assert len(records(logs_of(tmp_path)[0], "/imu")) == before.sent["/imu"] + after.sent["/imu"]
    assert_sound(logs_of(tmp_path)[0])


def test_torn_and_random_bytes_get_a_reason_and_nothing_else(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port)
    rng = np.random.default_rng(3)
    types = {
        "/imu": schemas.IMU,
        "/gnss": schemas.NAV_SAT_FIX,
        "/pose_fix": schemas.POSE_FIX,
        "/landfix/fix": schemas.LANDMARK_FIX,
    }
    with in_thread(parse(text), tmp_path) as daemon, client(port) as session:
        before = fly(session, 1.0)
        for topic, schema in types.items():
            for size in (0, 3, 4, 11, 12, 60, 316, 1000):
                session.put(rmw_key(0, topic, schema, type_hash(schema)), b"\0\1\0\0" + rng.bytes(size))
                session.put(rmw_key(0, topic, schema, type_hash(schema)), rng.bytes(size))
        after = fly(session, 1.0)
        until(lambda: len(daemon.mailbox) == 0, "all is handled")
    (log,) = logs_of(tmp_path)
    assert len(before.latency_ns) > 50
    assert len(after.latency_ns) > 100
    assert_sound(log)
    assert_replay_says_the_same(log, text)


def test_a_defect_of_ours_costs_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    with in_thread(parse(toml(tmp_path, port)), tmp_path) as daemon, client(port) as session:

        def fails_once(topic: str, *_: object) -> None:
            monkeypatch.undo()
            raise KeyError(topic)

        monkeypatch.setattr(daemon._decoder, "decode", fails_once)
        vehicle = fly(session, 1.5)
        until(lambda: status(session).get("internal_errors") == "1", "the status reports it")
    assert len(vehicle.latency_ns) > 50


def test_what_a_late_fix_changes_is_worked_out_behind_an_output_before_the_next_sample_comes(tmp_path: Path) -> None:
    rng, start_ns = np.random.default_rng(1), 1_795_000_000 * SECOND
    with assembled(parse(toml(tmp_path, 1, zenoh_keys="enabled = false")), tmp_path) as daemon:
        for t_ns in range(start_ns, start_ns + 2 * SECOND, SECOND // 100):
            aids = gnss(t_ns - SECOND // 20, rng) if t_ns % (SECOND // 5) == 0 else ()
            for message in (*aids, imu(t_ns, rng)):
                daemon.take(Arrival(*encode_input(message), t_ns))
        history = daemon._fusion._history
        before, at_ns = history.tracker, history.tracker.core.t_ns
        daemon.take(Arrival(*encode_input(pose_fix(at_ns - SECOND // 10, rng)), at_ns))
        assert history.tracker is before
        daemon.take(Arrival(*encode_input(imu(at_ns + SECOND // 100, rng)), at_ns + SECOND // 100))
        redone = history.tracker
        assert redone is not before
        assert redone.core.t_ns == at_ns + SECOND // 100
        daemon.take(Arrival(*encode_input(imu(at_ns + SECOND // 50, rng)), at_ns + SECOND // 50))
        assert history.tracker is redone


def test_what_our_own_vision_reports_is_taken_behind_an_imu_sample_or_a_tick(tmp_path: Path) -> None:
    rng, t_ns = np.random.default_rng(1), 1_795_000_000 * SECOND
    with assembled(parse(toml(tmp_path, 1, zenoh_keys="enabled = false")), tmp_path) as daemon:
        waiting = []
        for step in (gnss(t_ns, rng)[0], imu(t_ns, rng)):
            daemon.mailbox.put_own(Encoded(*encode_input(pose_fix(t_ns, rng))))
            daemon.take(Arrival(*encode_input(step), t_ns))
            waiting.append(len(daemon.mailbox))
        daemon.mailbox.put_own(Encoded(*encode_input(pose_fix(t_ns, rng))))
        daemon._tick()
        assert [*waiting, len(daemon.mailbox)] == [1, 0, 0]
    assert len(records(logs_of(tmp_path)[0], "/pose_fix")) == 3
