"""Processes that work for this one: Ctrl-C ends them with it, quietly."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from estimator.frontend.workers import pool


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


def test_ctrl_c_while_others_begin_to_draw_ends_all_of_them_without_a_traceback(tmp_path: Path) -> None:
    """The new processes are still importing."""
    with subprocess.Popen(
        [sys.executable, "-m", "estimator", "demo", "-o", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True, text=True,
    ) as demo:  # fmt: skip
        try:
            began = time.monotonic()
            while len(_members(demo.pid)) < 4 and time.monotonic() - began < 60.0:  # itself, multiprocessing's tracker, two more
                time.sleep(0.01)
            os.killpg(demo.pid, signal.SIGINT)
            said, _ = demo.communicate(timeout=60.0)
            ended = time.monotonic()
            while _members(demo.pid) and time.monotonic() - ended < 10.0:  # the tracker leaves when it sees that the others have
                time.sleep(0.01)
        finally:
            if alive := _members(demo.pid):
                os.killpg(demo.pid, signal.SIGKILL)
    assert demo.returncode not in (0, None)
    assert "Traceback" not in said, said
    assert "KeyboardInterrupt" not in said, said
    assert not alive


def test_an_exception_ends_tasks_that_wait_and_the_one_in_hand() -> None:
    began, before = time.monotonic(), set(multiprocessing.active_children())
    with pytest.raises(RuntimeError, match="enough"):
        _give_up()
    assert time.monotonic() - began < 20.0
    assert set(multiprocessing.active_children()) <= before


def _give_up() -> None:
    with pool(1) as workers:
        assert workers.submit(abs, -1).result() == 1
        for _ in range(5):
            workers.submit(time.sleep, 60.0)
        raise RuntimeError("enough")
