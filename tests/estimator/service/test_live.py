"""`landfix live` seen by a WebSocket client of Foxglove's protocol: topics, definitions, and the very bytes of the log."""

import base64
import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator.config import parse
from estimator.frontend.markers import LandmarkBoard
from estimator.service.live_server import LiveError, LiveServer, play, relay, topics_of
from logs.store.reader import LogReader
from logs.wire.codec import Encoded, decode_odometry
from logs.wire.markers import TOPIC as LANDMARKS
from logs.wire.schemas import ODOMETRY, schema_text
from tests.estimator.service.flying import client, environment, fly, free_port, in_thread, toml, until
from tests.estimator.sights import village, write_flight

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed (landfix[live])")


class Viewer:
    """A client of the WebSocket protocol (RFC 6455) with Foxglove's messages: JSON in text frames, data in binary ones."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=30.0)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._file = self._socket.makefile("rb")
        assert b"101" in self._file.readline()
        while self._file.readline() != b"\r\n":
            pass
        self.channels: dict[str, dict[str, Any]] = {}
        self.times: list[int] = []
        self._topics: dict[int, str] = {}

    def close(self) -> None:
        self._file.close()
        self._socket.close()

    def subscribe(self, *topics: str) -> None:
        """To topics that were advertised."""
        wanted = []
        for topic in topics:
            while topic not in self.channels:
                self._next()
            number = len(self._topics) + 1
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self._send(json.dumps({"op": "subscribe", "subscriptions": wanted}).encode())

    def messages(self, count: int) -> list[tuple[str, int, bytes]]:
        """Topic, time and bytes of the next so many."""
        got: list[tuple[str, int, bytes]] = []
        while len(got) < count:
            message = self._next()
            if message is not None:
                got.append(message)
        return got

    def _next(self) -> tuple[str, int, bytes] | None:
        """A data message; None for anything else, which is noted."""
        opcode, body = self._frame()
        if opcode == 1:
            message = json.loads(body)
            if message["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in message["channels"]}
        elif opcode == 2 and body[0] == 1:
            number, t_ns = struct.unpack_from("<IQ", body, 1)
            return self._topics[number], t_ns, body[13:]
        elif opcode == 2 and body[0] == 2:
            self.times.append(struct.unpack_from("<Q", body, 1)[0])
        return None

    def _frame(self) -> tuple[int, bytes]:
        first, length = self._file.read(2)
        if length == 126:
            (length,) = struct.unpack(">H", self._file.read(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._file.read(8))
        return first & 0x0F, self._file.read(length)

    def _send(self, text: bytes) -> None:
        mask = os.urandom(4)
        head = bytes([0x81, 0x80 | len(text)]) if len(text) < 126 else struct.pack(">BBH", 0x81, 0xFE, len(text))
        self._socket.sendall(head + mask + bytes(b ^ mask[k % 4] for k, b in enumerate(text)))


@contextmanager
def viewer(port: int) -> Iterator[Viewer]:
    made = Viewer(port)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flight, _ = write_flight(tmp_path_factory.mktemp("live"))
    return flight


def test_a_viewer_gets_definitions_and_the_bytes_of_the_log_at_their_times(log: Path) -> None:
    with LogReader(log) as reader:
        expected = [(r.topic, r.log_time_ns, r.data) for r in reader if r.topic in {"/imu", "/pose_fix"}]
    with LiveServer("127.0.0.1", 0) as server:
        server.offer(topics_of(log))
        assert not server.watched
        with viewer(server.port) as watching:
            watching.subscribe("/imu", "/pose_fix")
            assert watching.channels["/imu"]["encoding"] == "cdr"
            assert watching.channels["/imu"]["schemaEncoding"] == "ros2msg"
            assert watching.channels["/imu"]["schemaName"] == "sensor_msgs/msg/Imu"
            assert watching.channels["/imu"]["schema"] == schema_text("sensor_msgs/msg/Imu")
            assert {"/left/image", "/right/image"} <= set(watching.channels)
            until(lambda: server.watched, "the subscription arrives")
            counts: list[int] = []
            player = threading.Thread(target=lambda: counts.append(play(server, log, 5.0)))
            player.start()
            got = watching.messages(len(expected))
            player.join()
        assert got == expected
        assert counts[0] >= len(expected)
        assert watching.times == sorted(watching.times) != []


def test_who_comes_late_gets_the_landmarks() -> None:
    (landmarks,) = LandmarkBoard(village().map).news(7, np.zeros(3), frozenset())
    with LiveServer("127.0.0.1", 0) as server:
        server.put(landmarks, 7)
        with viewer(server.port) as watching:
            watching.subscribe(LANDMARKS)
            assert watching.messages(1) == [(LANDMARKS, 7, landmarks.data)]


def test_an_unknown_type_is_left_out() -> None:
    with LiveServer("127.0.0.1", 0) as server:
        server.put(Encoded("/strange", "strange_msgs/msg/Thing", b"\0\1\0\0"), 1)
        server.offer({"/imu": "sensor_msgs/msg/Imu"})
        with viewer(server.port) as watching:
            watching.subscribe("/imu")
            assert set(watching.channels) == {"/imu"}


def test_a_port_in_use_is_said() -> None:
    with LiveServer("127.0.0.1", 0) as server, pytest.raises(LiveError, match=f"127.0.0.1:{server.port}: cannot listen there"):
        LiveServer("127.0.0.1", server.port)


def test_a_daemon_is_shown_over_zenoh(tmp_path: Path) -> None:
    port = free_port()
    with in_thread(parse(toml(tmp_path, port)), tmp_path), client(port) as session, LiveServer("127.0.0.1", 0) as server:
        kept = relay(server, session, 0, {"/landfix/odometry": ODOMETRY})
        with viewer(server.port) as watching:
            watching.subscribe("/landfix/odometry")
            until(lambda: server.watched, "the subscription arrives")
            pilot = threading.Thread(target=lambda: fly(session, 4.0))
            pilot.start()
            got = [decode_odometry(data) for _, _, data in watching.messages(20)]
            pilot.join()
        assert [o.t_ns for o in got] == sorted({o.t_ns for o in got})
        assert len(kept) == 1


def test_the_command_waits_for_a_viewer_and_plays(log: Path) -> None:
    port = free_port()
    arguments = [sys.executable, "-m", "estimator", "live", str(log), "--port", str(port), "--speed", "20"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, env=environment(), text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == f"landfix: ws://127.0.0.1:{port}  (Ctrl-C ends it)\n"
        with viewer(port) as watching:
            watching.subscribe("/pose_fix")
            assert len(watching.messages(3)) == 3
            process.wait(timeout=60.0)
        assert process.returncode == 0
        assert "messages played" in process.stderr.read()
