"""Lines of `landfix run` on stderr, by an own thread; late lines are dropped."""

import contextlib
import os
import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, Full, Queue
from types import TracebackType
from typing import Final, Self

from estimator.service.log.recovery import is_torn
from models.messages import AidStatus, Alert, Estimate, Health, Integrity, Mode, Output, Reason

_STDERR: Final = 2
_WAITING_LINES: Final = 200
_LAST_S: Final = 1.0  # at the end, for the lines that still wait
_PERIOD_S: Final = 0.2
_SILENT_NS: Final = 3 * 10**9
_NO_IMU: Final = frozenset({Mode.STARTING, Mode.COASTING})
_NO_ESTIMATE_YET: Final = frozenset({Mode.STARTING, Mode.ALIGNING})


class Console:
    """Prints until the context ends; say() and note() never block or raise."""

    def __init__(self, *, quiet: bool = True) -> None:
        self.quiet = quiet
        self._lines: Queue[str] = Queue(_WAITING_LINES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="console", daemon=True)
        self._mode: Mode | None = None
        self._detail = ""
        self._alert = Alert.NOT_JUDGED
        self._estimated = False
        self._silent_ns: int | None = None  # since when there is no IMU; 0: said
        self._malformed = Counter[str]()

    def __enter__(self) -> Self:
        if not self.quiet:
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_LAST_S)

    def say(self, line: str) -> None:
        """Print one line."""
        if not self.quiet:
            with contextlib.suppress(Full):
                self._lines.put_nowait(line)

    def note(self, output: Output) -> None:
        """Print the first estimate, changes of mode or alert, a silent IMU, malformed messages."""
        if isinstance(output, Estimate) and not self._estimated:
            self._estimated = True
            self.say("first estimate: published")
        elif isinstance(output, Health):
            self._health(output)
        elif isinstance(output, Integrity) and output.state is not self._alert:
            self._alert = output.state
            levels = f"HPL {output.hpl_m:.1f} m, VPL {output.vpl_m:.1f} m"
            limits = "no alert limits configured, " if output.state is Alert.NOT_JUDGED else ""
            self.say(f"integrity: {output.state.value}, {output.reason or limits + levels}")
        elif isinstance(output, AidStatus) and output.reason is Reason.MALFORMED:
            self._malformed[output.topic] += 1
            if self._malformed[output.topic] == 1:
                self.say(f"malformed message on {output.topic}: {output.detail}; see what writes this topic (more are counted)")

    def _health(self, health: Health) -> None:
        if health.mode is not self._mode:
            self._mode = health.mode
            radius = "" if health.mode in _NO_ESTIMATE_YET else f", 95 % radius {health.radius95_m:.1f} m"
            detail = f": {health.detail}" if health.detail not in {"", self._detail} else ""
            self._detail = health.detail
            self.say(f"mode: {health.mode.value}{radius}{detail}")
        if health.mode not in _NO_IMU:
            self._silent_ns = None
        elif self._silent_ns is None:
            self._silent_ns = health.t_ns
        elif 0 < self._silent_ns <= health.t_ns - _SILENT_NS:
            self.say(f"no IMU sample for {_SILENT_NS * 1e-9:.0f} s: is the topic of [inputs] imu sent, on this ROS domain?")
            self._silent_ns = 0  # said

    def closed(self, logs: Sequence[Path], lost_inputs: int) -> None:
        """Print each log file's size and completeness."""
        if self.quiet:
            return
        for topic, count in self._malformed.items():
            self.say(f"malformed messages on {topic}: {count}")
        for path in logs:
            self.say(_log_line(path))
        if not logs:
            self.say("log: no file could be written")
        if lost_inputs:
            self.say(f"log: {lost_inputs} inputs are missing in it, the disk was too slow or full")

    def _run(self) -> None:
        while not (self._stop.is_set() and self._lines.empty()):
            with contextlib.suppress(Empty, OSError):  # nothing to print; the terminal is gone
                line = f"landfix: {self._lines.get(timeout=_PERIOD_S)}\n"
                os.write(_STDERR, line.encode())  # not sys.stderr, whose lock would be held at the exit if this write blocks


def _log_line(path: Path) -> str:
    try:
        size, torn = path.stat().st_size, is_torn(path)
    except OSError as error:
        return f"log lost: {path} ({(error.strerror or 'cannot be read').lower()})"
    if torn:
        return f"log incomplete: {path}, {size / 1e6:.1f} MB; the next start repairs it, or `landfix recover {path}`"
    return f"log complete: {path}, {size / 1e6:.1f} MB"
