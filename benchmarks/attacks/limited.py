"""A command in a child process with a limit on CPU time and memory, and what it left behind."""

import os
import re
import resource
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

CPU_S: Final = 10
MEMORY_BYTES: Final = 2**30  # above what the child begins with
_WALL_S: Final = 900.0  # a busy machine is no hang
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]")
_OURS: Final = re.compile(r"Traceback|internal error, please|Exception ignored|Warning:|fits into memory")


class Ended(msgspec.Struct, frozen=True):
    """How a command ended; signal: 0 where it exited by itself; said: the end of its stdout and stderr."""

    code: int
    signal: int
    cpu_s: float
    memory_mb: float
    stdout: str
    stderr: str


def run(words: Sequence[str], folder: Path) -> Ended:
    """`landfix WORDS` in folder. The child is forked: what this process has imported costs it nothing."""
    sys.stdout.flush()
    sys.stderr.flush()
    if (child := os.fork()) == 0:
        _in_child(list(words), folder)
    out, err = folder / ".stdout", folder / ".stderr"
    status, usage = _waited(child)
    return Ended(
        os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1,
        os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0,
        round(usage.ru_utime + usage.ru_stime, 2),
        round(usage.ru_maxrss / 1024.0),
        out.read_text(errors="backslashreplace")[-3000:],
        err.read_text(errors="backslashreplace")[-3000:],
    )


def _waited(child: int) -> tuple[int, resource.struct_rusage]:
    """It is killed, with the processes of its own, when it takes too long by the clock."""
    end_s = time.monotonic() + _WALL_S
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage
        if time.monotonic() > end_s:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.005)


def _in_child(words: list[str], folder: Path) -> None:
    os.setsid()
    limit_memory()
    limit_cpu(3 * CPU_S)
    os.chdir(folder)
    for number, path in ((0, Path(os.devnull)), (1, folder / ".stdout"), (2, folder / ".stderr")):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
    os.environ["COLUMNS"] = "300"
    sys.argv = ["landfix", *words]
    code: Any = 0
    try:
        from estimator.cli import main  # noqa: PLC0415

        main()
    except SystemExit as ending:
        code = ending.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 70
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def limit_memory() -> None:
    """MEMORY_BYTES above what this process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY_BYTES,) * 2)


def limit_cpu(seconds: int) -> None:
    """From here on."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + seconds, resource.RLIM_INFINITY))


def flaw(ended: Ended, codes: frozenset[int]) -> tuple[str, str]:
    """("held", ""), or "degraded" or "failed" and why."""
    said = ended.stdout + ended.stderr
    if ended.signal:
        return "failed", f"ended by {signal.Signals(ended.signal).name}"
    if found := _OURS.search(said):
        line = said[found.start() :].splitlines()
        return "failed", f"{line[0][:200]} ... {line[-1][:200]}"
    if ended.code not in codes:
        return "failed", f"exit code {ended.code}: {said.strip()[-200:]}"
    if _CONTROL.search(said):
        return "failed", "control characters on the screen"
    if ended.cpu_s > CPU_S:
        return "failed", f"{ended.cpu_s} s of CPU"
    lines = [line for line in ended.stderr.splitlines() if line.strip()]
    if ended.code == 1 and not said.strip():
        return "failed", "no reason given"
    if ended.code == 1 and len(lines) > 2:
        return "degraded", f"{len(lines)} lines on stderr"
    return "held", ""
