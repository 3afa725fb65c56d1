"""The lines of `landfix run` on stderr, by a thread of its own; lines that wait too long are dropped."""

import contextlib
import os
import threading
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, Full, Queue
from types import TracebackType
from typing import Final, Self

from estimator.service.log.recovery import is_torn
from models.messages import Alert, Estimate, Health, Integrity, Mode, Output

_STDERR: Final = 2
_WAITING_LINES: Final = 200
_LAST_S: Final = 1.0  # at the end, for the lines that still wait
_PERIOD_S: Final = 0.2
_NO_ESTIMATE_YET: Final = frozenset({Mode.STARTING, Mode.ALIGNING})


class Console:
    """Prints until the context ends; quiet: prints nothing. say() and note() never block and never raise."""

    def __init__(self, *, quiet: bool = True) -> None:
        self._quiet = quiet
        self._lines: Queue[str] = Queue(_WAITING_LINES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="console", daemon=True)
        self._mode: Mode | None = None
        self._alert = Alert.NOT_JUDGED
        self._estimated = False

    def __enter__(self) -> Self:
        if not self._quiet:
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_LAST_S)

    def say(self, line: str) -> None:
        """Print one line."""
        if not self._quiet:
            with contextlib.suppress(Full):
                self._lines.put_nowait(line)

    def note(self, output: Output) -> None:
        """Print the first estimate and every change of mode."""
        if isinstance(output, Estimate) and not self._estimated:
            self._estimated = True
            self.say("first estimate: published")
        elif isinstance(output, Health) and output.mode is not self._mode:
            self._mode = output.mode
            radius = "" if output.mode in _NO_ESTIMATE_YET else f", 95 % radius {output.radius95_m:.1f} m"
            detail = f": {output.detail}" if output.detail else ""
            self.say(f"mode: {output.mode.value}{radius}{detail}")

        elif isinstance(output, Integrity) and output.state is not self._alert:
            self._alert = output.state
            levels = f"HPL {output.hpl_m:.1f} m, VPL {output.vpl_m:.1f} m"
            limits = "no alert limits configured, " if output.state is Alert.NOT_JUDGED else ""
            self.say(f"integrity: {output.state.value}, {output.reason or limits + levels}")

    def closed(self, logs: Sequence[Path], lost_inputs: int) -> None:
        """Print each log file of this run with its size, and whether it is complete; called after the log is closed."""
        if self._quiet:
            return
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
