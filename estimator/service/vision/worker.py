"""Vision in its own process.

Of waiting pairs the newest goes. A dead or late process is restarted, each time later; compiling extends its time.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from estimator.frontend.requests import Pair, Pairing, Shot, Track, VisionConfig
from estimator.frontend.workers import SPAWNED
from estimator.map_files.image_file import ImageFile
from estimator.publish import Pace
from estimator.service.base.clock import SECOND_NS, Clock, Stamps
from estimator.service.base.ports import Arrival, Screen
from estimator.service.vision.wire import (
    Answer,
    Asked,
    Compiling,
    Drawing,
    MalformedError,
    Question,
    Ready,
    Said,
    Unable,
    asked,
    said,
    send,
)
from estimator.strict_toml import ConfigError
from logs.wire.codec import Encoded, decode_vision_request, encode
from logs.wire.decoding import LANDMARK_FIX_TOPIC
from logs.wire.stamps import stamp_of
from models.messages import Vec3

_GIVES_WAY: Final = 5  # to the loop, which has little to do but at once
_START_S: Final = 300.0  # to load everything, without what has to be compiled
_COMPILE_S: Final = 120.0  # for one kernel, on a small computer with other work to do,
_ALL_COMPILED_S: Final = 1800.0  # and for all that come before one answer
_SLICE_S: Final = 0.1  # of a time-out
_FIRST_BACKOFF_S, _LONGEST_BACKOFF_S = 0.5, 10.0
_GOOD_ANSWERS: Final = 50  # in a row, until the back-off begins anew: seconds of sight, not one answer between two failures
_IDLE_S: Final = 0.05
_WAITING: Final = 8  # images
_QUIET_NS: Final = 2 * SECOND_NS  # without an image, or without an answer, and it does not see


Respond = Callable[[Asked], list[Encoded]]


def serve(pipe: Connection, rig_file: Path, map_file: Path | None, origin: Vec3 | None, image: ImageFile | None) -> None:
    """The process: answers the questions and draws until the pipe is closed."""

    def load() -> tuple[int, Respond]:
        from estimator.frontend.files import load_processor  # noqa: PLC0415  (OpenCV is loaded in this process only)

        processor = load_processor(rig_file, map_file, origin, image)

        def respond(to: Asked) -> list[Encoded]:
            if isinstance(to, Drawing):
                drawn = processor.draw(to.mode)
                return [] if drawn is None else [drawn]
            return processor.process(decode_vision_request(to.request, 0), to.pairs[0])

        return processor.time_offset_ns, respond

    def warm() -> None:
        from estimator.service.vision.warm_up import warm_up  # noqa: PLC0415

        warm_up()

    answer_until_closed(pipe, load, warm)


def answer_until_closed(pipe: Connection, load: Callable[[], tuple[int, Respond]], warm: Callable[[], None]) -> None:
    """load(): the cameras' time offset [ns] and the processor, or ConfigError; warm(): compiles.

    Sends Ready or Unable first.
    """
    _give_way()
    from estimator.service.base.compilation import listen  # noqa: PLC0415  (numba is slow to import)

    try:
        time_offset_ns, respond = load()
    except ConfigError as error:
        send(pipe, Unable(str(error)))
        return
    with suppress(BrokenPipeError):
        listen(lambda kernel, seconds: send(pipe, Compiling(kernel, seconds)))
        warm()
        send(pipe, Ready(time_offset_ns))
    with suppress(EOFError, BrokenPipeError):
        while True:
            send(pipe, Answer(respond(asked(pipe))))


def _give_way() -> None:
    """Give way to the daemon, never at real-time priority, whose throttle would stop it too."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(_GIVES_WAY)


class VisionWorker:
    """put() from any thread; tell(message): requests and answers."""

    _measurement = LANDMARK_FIX_TOPIC  # what an answer is to give

    def __init__(
        self,
        files: tuple[Any, ...],
        config: VisionConfig,
        sides: dict[str, str],
        clock: Clock,
        stamps: Stamps,
        track: Track,
        tell: Callable[[Encoded], None],
        screen: Screen | None = None,
        overlay_hz: float = 0.0,
    ) -> None:
        self._screen, self._overlay_pace = screen if overlay_hz > 0.0 else None, Pace(overlay_hz)
        self._files, self._config, self._sides = files, config, sides
        self._clock, self._stamps, self._track, self._tell = clock, stamps, track, tell
        self._shots: deque[Shot] = deque(maxlen=_WAITING)
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._offset_ns = self._run = 0
        self._warm = False  # the process has warmed up
        self._backoff_s = _FIRST_BACKOFF_S
        self._state = "starting"
        self._pairs = self._answers = self._fixes = self._dropped = self._unplaced = self._drawn = 0
        self._good = self._compiled = self._malformed = self._answered_ns = 0
        self._asked_ns: int | None = None  # since then a question is out
        self._latency_s = self._compiled_s = 0.0
        self._compiling = ""
        self._thread = threading.Thread(target=self._work, name="vision", daemon=True)
        self._thread.start()

    def put(self, arrival: Arrival) -> None:
        """Add an image; of too many the oldest is dropped."""
        topic, schema, data, arrived_ns, _ = arrival
        stamp_ns = stamp_of(data)
        t_ns = None if stamp_ns is None else self._stamps.validity_ns(topic, stamp_ns, arrived_ns)
        if stamp_ns is None or t_ns is None:
            self._unplaced += 1
            return
        self._dropped += len(self._shots) == _WAITING
        self._shots.append(Shot(topic, schema, data, stamp_ns, t_ns, arrived_ns))
        self._wake.set()

    def close(self) -> None:
        """Stop thread and process."""
        self._stopping.set()
        self._wake.set()
        if self._process is not None:
            self._process.kill()  # it would keep the thread waiting
        self._thread.join()
        self._stop_process()

    def report(self) -> dict[str, Any]:
        """For the status."""
        return {
            "state": self._state_now(),
            "pairs": self._pairs,
            "answers": self._answers,
            "fixes": self._fixes,
            "dropped_images": self._dropped,
            "images_of_unknown_time": self._unplaced,
            "overlays": self._drawn,
            "restarts": self._run,
            "malformed_answers": self._malformed,
            "compiling": self._compiling,
            "compiled_in_flight": self._compiled,
            "compiled_in_flight_s": round(self._compiled_s, 1),
            "latency_ms": round(1e3 * self._latency_s, 1),
        }

    def _state_now(self) -> str:
        now_ns, asked_ns = self._clock.now_ns(), self._asked_ns
        if self._state != "seeing" or now_ns - (asked_ns or self._answered_ns) < _QUIET_NS:
            return self._state
        return "waiting for images" if asked_ns is None else "waiting for an answer"

    # --- the thread -----------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        pairing = Pairing(self._config, alone=len(set(self._sides.values())) == 1)
        while not self._stopping.is_set():
            try:
                if self._process is not None or self._start():
                    self._turn(pairing)
            except MalformedError as error:
                self._malformed += 1
                self._restart(str(error))
            except Exception as error:  # a defect of ours costs an image and a restart, not the sight for the rest of the flight
                self._restart(f"{type(error).__name__}: {error}")

    def _turn(self, pairing: Pairing) -> None:
        self._wake.wait(_IDLE_S)
        self._wake.clear()
        if self._process is not None and not self._process.is_alive():
            self._restart("has died")
            return
        pairs = pairing.overdue(self._clock.now_ns())
        while self._shots:
            shot = self._shots.popleft()
            pairs += pairing.put(self._sides[shot.topic], shot._replace(t_ns=shot.t_ns + self._offset_ns))
        if pairs:
            self._pairs += len(pairs)
            self._dropped += 2 * (len(pairs) - 1)
            self._ask(pairs[-1])

    def _ask(self, pair: Pair) -> None:
        asked_ns = self._clock.now_ns()
        question = self._question(pair, asked_ns)
        if question is None:
            return
        message, pairs = question
        self._tell(message)
        self._asked_ns = asked_ns
        answers = self._answers_to(Question(message.data, pairs))
        if answers is None:
            self._restart("does not answer")
            return
        for answer in answers:
            self._tell(answer)
        self._state, self._asked_ns, self._answered_ns = "seeing", None, self._clock.now_ns()
        self._answers += 1
        self._good += 1
        if self._good >= _GOOD_ANSWERS:
            self._backoff_s = _FIRST_BACKOFF_S
        self._fixes += any(answer.topic == self._measurement for answer in answers)
        self._latency_s = (self._answered_ns - asked_ns) / SECOND_NS
        if self._screen and self._screen.watched() and self._overlay_pace.due(pair.t_ns):
            self._draw(self._screen)

    def _question(self, pair: Pair, asked_ns: int) -> tuple[Encoded, list[Pair]] | None:
        request = self._track.request(pair, asked_ns, self._run)
        if request is None:
            self._state = "waiting for an estimate"
            return None
        (message,) = encode(request)
        return message, [pair]

    def _draw(self, screen: Screen) -> None:
        drawn = self._answers_to(Drawing(self._track.mode))
        if drawn is None:
            self._restart("does not draw")
            return
        for image in drawn:
            self._drawn += 1
            screen.show(image)

    @staticmethod
    def _target() -> Callable[..., None]:
        return serve

    def _patience_s(self) -> float:
        return self._config.timeout_s * self._backoff_s / _FIRST_BACKOFF_S

    def _answers_to(self, question: Asked) -> list[Encoded] | None:
        answer = self._exchange(question, self._patience_s())
        if answer is None or isinstance(answer, Answer):
            return None if answer is None else answer.messages
        raise MalformedError(f"a malformed answer: {type(answer).__name__}")

    def _exchange(self, question: Asked | None, patience_s: float) -> Said | None:
        """The answer; None: dead, or killed. A compiled kernel restarts the time, up to a limit."""
        assert self._process is not None
        assert self._pipe is not None
        answered, end_s = self._killed_in(patience_s), time.monotonic() + _ALL_COMPILED_S
        try:
            if question is not None:
                send(self._pipe, question)
            while isinstance(message := said(self._pipe), Compiling):
                answered.set()
                allowed_s = _COMPILE_S if message.kernel else patience_s
                answered = self._killed_in(min(allowed_s, max(end_s - time.monotonic(), 0.0)))
                self._note(message)
            return message
        except (EOFError, OSError):
            return None
        finally:
            answered.set()

    def _killed_in(self, seconds: float) -> threading.Event:
        """Kill the process unless the event is set; time while stopped does not count."""
        assert self._process is not None
        answered, process = threading.Event(), self._process

        def wait() -> None:
            left_s = seconds
            while left_s > 0.0:
                begun_s = time.monotonic()
                if answered.wait(min(left_s, _SLICE_S)):
                    return
                left_s -= min(time.monotonic() - begun_s, 2.0 * _SLICE_S)
            process.kill()

        threading.Thread(target=wait, name="vision-timeout", daemon=True).start()
        return answered

    def _note(self, compiling: Compiling) -> None:
        self._compiling = compiling.kernel
        if self._warm:
            self._compiled += not compiling.kernel
            self._compiled_s += compiling.seconds

    def _start(self) -> bool:
        self._pipe, theirs = SPAWNED.Pipe()
        process = SPAWNED.Process(target=self._target(), args=(theirs, *self._files), name="landfix-vision")
        process.start()
        self._process = process  # not before: close() kills it, and what has not begun cannot be killed
        theirs.close()
        if self._stopping.is_set():
            return False
        ready = self._exchange(None, _START_S)
        if not isinstance(ready, Ready):
            self._restart(ready.reason if isinstance(ready, Unable) else "does not start")
            return False
        self._offset_ns, self._state, self._warm = ready.time_offset_ns, "ready", True
        self._shots.clear()
        return True

    def _restart(self, why: str) -> None:
        self._stop_process()
        if self._stopping.is_set():
            return
        self._state = why
        self._run += 1
        self._good = 0
        self._stopping.wait(self._backoff_s)
        self._backoff_s = min(2.0 * self._backoff_s, _LONGEST_BACKOFF_S)

    def _stop_process(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
        if self._process is not None:
            self._process.kill()
            self._process.join(timeout=1.0)
        self._process = self._pipe = self._asked_ns = None
        self._warm, self._compiling = False, ""
