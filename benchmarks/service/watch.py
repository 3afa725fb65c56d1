"""Processor time, memory, handles and threads of running processes, from /proc."""

import os
import resource
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_WARM_S = 30.0  # the beginning is not counted as growth


class _Reading(NamedTuple):
    s: float
    rss_mb: float
    cpu_s: float
    handles: int
    threads: int


def watch(processes: dict[str, int], over: Callable[[], bool]) -> dict[str, dict[str, float | list[float]]]:
    """Of each process (name -> id) each second until it is over: share of a core, memory, handles, threads, growth when warm.

    And memory and threads at the end of each minute.
    """
    readings: dict[str, list[_Reading]] = {name: [] for name in processes}
    while not over():
        for name, pid in processes.items():
            with suppress(FileNotFoundError):  # it is gone
                readings[name].append(_Reading(time.monotonic(), _rss_mb(pid), _cpu_s(pid), *_counts(pid)))
        time.sleep(1.0)
    return {name: _summary(taken) for name, taken in readings.items()}


def children(pid: int, words: str, count: int) -> list[int]:
    """The oldest children of a process whose command lines contain these words; waits until there are so many."""
    while True:
        found = {int(other) for other in _of_threads(pid) if words in Path(f"/proc/{other}/cmdline").read_text()}
        if len(found) >= count:
            return sorted(found)[:count]
        time.sleep(0.1)


def _of_threads(pid: int) -> list[str]:
    """Children that any of its threads has started."""
    return [other for task in Path(f"/proc/{pid}/task").iterdir() for other in (task / "children").read_text().split()]


def _summary(taken: list[_Reading]) -> dict[str, float | list[float]]:
    taken = [r for r in taken if r.rss_mb] or taken  # at its end a process has none
    first, last = taken[0], taken[-1]
    minutes = {int((r.s - first.s) / 60.0): r for r in taken}.values()
    warm = next((r for r in taken if r.s - first.s >= min(_WARM_S, (last.s - first.s) / 2)), last)
    share = (last.cpu_s - warm.cpu_s) / max(last.s - warm.s, 1e-9)
    return {
        "cpu_percent": round(100.0 * share, 1),
        "rss_mb": round(last.rss_mb, 1),
        "rss_growth_mb": round(last.rss_mb - warm.rss_mb, 2),
        "handles": last.handles,
        "handles_growth": last.handles - warm.handles,
        "threads": last.threads,
        "threads_growth": last.threads - warm.threads,
        "rss_mb_each_minute": [round(r.rss_mb, 1) for r in minutes],
        "threads_each_minute": [r.threads for r in minutes],
    }


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _counts(pid: int) -> tuple[int, int]:
    """Open files and threads."""
    handles, threads = (sum(1 for _ in Path(f"/proc/{pid}/{what}").iterdir()) for what in ("fd", "task"))
    return handles, threads


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
