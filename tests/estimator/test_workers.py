"""Processes that work for this one: Ctrl-C ends them with it, quietly."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from estimator.workers import pool

# A shell that starts a command in the background lets it ignore SIGINT; a person's terminal does not.
LANDFIX = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from estimator.cli import main
main()
"""


def _members(group: int) -> list[int]:
    """Process ids of a process group, without the dead ones."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, of = stat.read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):
            continue
        if int(of) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.mark.parametrize("after_s", [0.0, 3.0])
def test_ctrl_c_while_others_draw_ends_all_of_them_without_a_traceback(tmp_path: Path, after_s: float) -> None:
    """At once the new processes are still importing; later they draw and compile."""
    demo = subprocess.Popen(
        [sys.executable, "-c", LANDFIX, "demo", "-o", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True, text=True,
    )  # fmt: skip
    try:
        began = time.monotonic()
        while len(_members(demo.pid)) < 4 and time.monotonic() - began < 60.0:  # itself, multiprocessing's tracker, two more
            time.sleep(0.01)
        time.sleep(after_s)
        os.killpg(demo.pid, signal.SIGINT)
        said, _ = demo.communicate(timeout=60.0)
    finally:
        if alive := _members(demo.pid):
            os.killpg(demo.pid, signal.SIGKILL)
    assert demo.returncode not in (0, None)
    assert "Traceback" not in said, said
    assert "KeyboardInterrupt" not in said, said
    assert not alive


def test_no_more_tasks_begin_after_an_exception() -> None:
    began = time.monotonic()
    tasks: list[Future[None]] = []
    with pytest.raises(RuntimeError, match="enough"):
        _give_up(tasks)
    assert time.monotonic() - began < 15.0
    assert sum(task.cancelled() for task in tasks) > 90


def _give_up(tasks: list[Future[None]]) -> None:
    with pool(1) as workers:
        tasks += [workers.submit(time.sleep, 0.2) for _ in range(100)]
        tasks[0].result()
        raise RuntimeError("enough")
