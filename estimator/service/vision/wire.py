"""Between daemon and vision: msgpack, not pickle: data only.

Question, Drawing                     to the process
Ready, Unable, Compiling, Answer      from it: bounded, of vision's topics only
"""

from multiprocessing.connection import Connection
from typing import Annotated, Final, TypeAlias

import msgspec

from estimator.frontend.requests import Pair
from logs.wire.cameras import LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC
from logs.wire.codec import Encoded
from logs.wire.decoding import LANDMARK_FIX_TOPIC
from logs.wire.markers import TOPIC as LANDMARKS_TOPIC
from models.messages import ODOMETRY_DELTA_TOPIC

_MOST_BYTES: Final = 64 * 2**20  # of an answer: the overlay of a large camera has some
_REPORTS: Final = ("/landfix/vision", "/landfix/odometry_report", "/landfix/overlay")
_TOPICS: Final = {
    *_REPORTS, LANDMARK_FIX_TOPIC, ODOMETRY_DELTA_TOPIC, LANDMARKS_TOPIC, LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC,
}  # fmt: skip
_Offset: TypeAlias = Annotated[int, msgspec.Meta(ge=-60_000_000_000, le=60_000_000_000)]
_Words: TypeAlias = Annotated[str, msgspec.Meta(max_length=10_000)]
_Messages: TypeAlias = Annotated[list[Encoded], msgspec.Meta(max_length=100)]


class Question(msgspec.Struct, frozen=True, tag=True):
    """Bytes of a request, and its images."""

    request: bytes
    pairs: list[Pair]


class Drawing(msgspec.Struct, frozen=True, tag=True):
    """Request for the last image with the map drawn."""

    mode: str


class Ready(msgspec.Struct, frozen=True, tag=True):
    """Warm; time offset of the cameras."""

    time_offset_ns: _Offset


class Unable(msgspec.Struct, frozen=True, tag=True):
    """Why it cannot see."""

    reason: _Words


class Compiling(msgspec.Struct, frozen=True, tag=True):
    """Compiling this kernel; "": done, seconds later."""

    kernel: _Words
    seconds: float = 0.0


class Answer(msgspec.Struct, frozen=True, tag=True):
    """To a question or a drawing."""

    messages: _Messages


Asked: TypeAlias = Question | Drawing
Said: TypeAlias = Ready | Unable | Compiling | Answer
_asked, _said = msgspec.msgpack.Decoder(Asked), msgspec.msgpack.Decoder(Said)


class MalformedError(ValueError):
    """A malformed answer; one line."""


def send(pipe: Connection, message: Asked | Said) -> None:
    """Raises OSError: nobody is there."""
    pipe.send_bytes(msgspec.msgpack.encode(message))


def asked(pipe: Connection) -> Asked:
    """The next question. Raises EOFError, OSError: nobody asks any more."""
    question: Asked = _asked.decode(pipe.recv_bytes())
    return question


def said(pipe: Connection) -> Said:
    """The process's next message. Raises EOFError (dead), OSError (too much), MalformedError."""
    try:
        message: Said = _said.decode(pipe.recv_bytes(_MOST_BYTES))
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MalformedError(f"a malformed answer: {error}") from None
    if isinstance(message, Answer) and (foreign := {m.topic for m in message.messages} - _TOPICS):
        raise MalformedError(f"a malformed answer: {min(foreign)[:100]!r} is no topic of vision")
    return message
