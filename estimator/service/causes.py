"""Inputs at fault, named on stderr: a process of lowest priority judges the log of the first minutes."""

import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Final

from models.messages import Health, Mode, Output

_LATEST_S: Final = 60.0  # the first look comes without an IMU too
_LOOKS_S: Final = (30.0, 120.0)  # after that, one after the other
_SCRIPT: Final = """\
import os, sys
os.setpriority(os.PRIO_PROCESS, 0, 19)
from estimator.config import parse
from logs.findings import Watch
from logs.store.reader import LogReader
config = parse(sys.stdin.read())
decoder, watch = config.decoder(), Watch(config.fusion().origin)
with LogReader(sys.argv[1]) as log:
    for r in log:
        message = decoder.decode(r.topic, r.schema, r.data, r.log_time_ns)
        if message is not None:
            watch.add(message)
for finding in watch.findings():
    print(finding)
"""


def causes_of(config: str, log: str, began: Callable[["subprocess.Popen[str]"], None] = lambda _: None) -> list[str]:
    """A line for each stream at fault, likeliest first. config: TOML; began(process): that reads the log."""
    words = [sys.executable, "-c", _SCRIPT, log]
    process = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, errors="replace"
    )
    began(process)
    return process.communicate(config)[0].splitlines()


class CauseFinder:
    """say(line): each topic's first cause; log(): file being written."""

    def __init__(self, config: str, log: Callable[[], str], say: Callable[[str], None]) -> None:
        self._config, self._log, self._say = config, log, say
        self._begun, self._stop = threading.Event(), threading.Event()
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, name="causes", daemon=True)
        self._thread.start()

    def note(self, output: Output) -> None:
        """Called by the loop."""
        if isinstance(output, Health) and output.mode is not Mode.STARTING:
            self._begun.set()

    def close(self) -> None:
        """End the thread, and the process that reads."""
        self._stop.set()
        self._begun.set()
        if self._process is not None:
            self._process.kill()
        self._thread.join()

    def _run(self) -> None:
        said = set[str]()
        self._begun.wait(_LATEST_S)
        for pause_s in _LOOKS_S:
            if self._stop.wait(pause_s):
                return
            for line in causes_of(self._config, self._log(), self._began):
                who = line.partition(" since ")[0]
                if who not in said:
                    said.add(who)
                    self._say(line)
            self._begun.wait()

    def _began(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        if self._stop.is_set():
            process.kill()
