"""What the vision process may say: data, bounded, of vision's topics; never an object that runs code."""

import pickle
from collections.abc import Callable
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import msgspec
import pytest

from estimator.frontend.requests import Pair, Shot
from estimator.service.vision import wire
from estimator.service.vision.wire import Answer, Compiling, Drawing, MalformedError, Question, Ready, Unable
from logs.wire.codec import Encoded

FIX = Encoded("/landfix/fix", "landfix_msgs/msg/LandmarkFix", b"\0\1")
SHOT = Shot("/left/image", "sensor_msgs/msg/Image", b"\0\xff", 1, 2, 3)


class Opens:
    """Writes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return open, (str(self._path), "w")


def test_everything_arrives_as_it_was_sent() -> None:
    ours, theirs = Pipe()
    for message in (Ready(-5), Unable("no map"), Compiling("a.b", 0.5), Answer([]), Answer([FIX])):
        wire.send(theirs, message)
        assert wire.said(ours) == message
    for question in (Question(b"\1", [Pair(SHOT, None), Pair(SHOT, SHOT)]), Drawing("aided")):
        wire.send(ours, question)
        assert wire.asked(theirs) == question


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        b"\xff" * 100,
        msgspec.msgpack.encode(Answer([FIX]))[:-1],
        msgspec.msgpack.encode(Question(b"", [])),
        msgspec.msgpack.encode({"type": "Ready", "time_offset_ns": 2**62}),
        msgspec.msgpack.encode({"type": "Ready", "time_offset_ns": "soon"}),
        msgspec.msgpack.encode({"type": "Answer", "messages": [[1, 2, 3]]}),
        msgspec.msgpack.encode({"type": "Unable", "reason": "x" * 10_001}),
        msgspec.msgpack.encode({"type": "Unable"}).replace(b"Unable", b"Un\xffble"),
        msgspec.msgpack.encode(Answer([FIX] * 101)),
        b"\x91" * 10_000,
    ],
)
def test_anything_else_is_malformed(data: bytes) -> None:
    ours, theirs = Pipe()
    theirs.send_bytes(data)
    with pytest.raises(MalformedError, match=r"^a malformed answer: .+$"):
        wire.said(ours)


@pytest.mark.parametrize("topic", ["/imu", "/gnss", "/pose_fix", "/landfix/tick", "/landfix/checkpoint", "/landfix/odometry"])
def test_vision_cannot_speak_for_another(topic: str) -> None:
    ours, theirs = Pipe()
    wire.send(theirs, Answer([FIX, FIX._replace(topic=topic)]))
    with pytest.raises(MalformedError, match=f"{topic}' is no topic of vision"):
        wire.said(ours)


def test_a_pickle_is_not_unpickled(tmp_path: Path) -> None:
    ours, theirs = Pipe()
    theirs.send(Opens(tmp_path / "written"))
    with pytest.raises(MalformedError):
        wire.said(ours)
    assert not (tmp_path / "written").exists()
    pickle.loads(pickle.dumps(Opens(tmp_path / "written"))).close()
    assert (tmp_path / "written").exists()


def test_more_bytes_than_an_answer_has_are_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire, "_MOST_BYTES", 1000)
    ours, theirs = Pipe()
    theirs.send_bytes(bytes(1001))
    with pytest.raises(OSError, match="bad message length"):
        wire.said(ours)
