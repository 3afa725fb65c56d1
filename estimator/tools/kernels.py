"""Compiles all kernels of a flight or the demonstration that are not compiled yet, in two processes.

python -m estimator.tools.kernels
"""

import gc
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Final

from estimator.frontend.workers import SPAWNED
from estimator.service.base import compilation

_SCENARIO: Final = """
duration_s = 4.0
origin = [47.3977, 8.5456, 488.0]
[vehicle]
kind = "multirotor"
area_m = 160.0
height_m = 75.0
[gnss]
[pose_fix]
[cameras]
"""
_SIGNATURES: Final = 131  # are compiled, of which the bar is a share

Report = Callable[[float, str], None]  # share that is done, and what is compiled now


class KernelsError(Exception):
    """They could not be compiled."""


def prepare(report: Report = lambda _, __: None, parts: Sequence[Callable[[], None]] = ()) -> None:
    """Compile all where a source has changed; parts: one process each (none: vision, and all else). Raises KernelsError."""
    if compilation.is_current():
        return
    compilation.forget()
    processes, pipes = list[BaseProcess](), list[Connection]()
    try:
        for part in parts or (_vision, _flight):
            ours, theirs = SPAWNED.Pipe(duplex=False)
            process = SPAWNED.Process(target=_compile, args=(theirs, part), name=f"landfix-compile{part.__name__}")
            process.start()
            theirs.close()
            processes.append(process)
            pipes.append(ours)
        _follow(pipes, report)
    except BaseException:
        for begun in processes:
            begun.terminate()
        raise
    for ended in processes:
        ended.join()
        if ended.exitcode != 0:
            raise KernelsError(f"kernels cannot be compiled: {ended.name} ended with {ended.exitcode}, and said above why")
    compilation.mark_current()


def _follow(pipes: list[Connection], report: Report) -> None:
    """Report what the processes say until they have ended."""
    done, names = 0, dict[Connection, str]()
    while pipes:
        for pipe in wait(pipes):
            assert isinstance(pipe, Connection)
            try:
                names[pipe] = pipe.recv()
                done += bool(names[pipe])
            except EOFError:
                pipes.remove(pipe)
                names.pop(pipe, None)
            report(min(done / _SIGNATURES, 1.0), ", ".join(filter(None, names.values())))


def _compile(pipe: Connection, part: Callable[[], None]) -> None:
    """A process: it reports what it compiles."""
    gc.disable()  # a sixth of the time: the compiler makes many objects, and few that refer to each other
    compilation.listen(lambda kernel, _: pipe.send(kernel))
    part()
    pipe.close()


def _vision() -> None:
    from estimator.service.vision.warm_up import warm_up  # noqa: PLC0415  (each process loads what it needs)

    warm_up()


def _flight() -> None:
    """What estimates, then what simulates and draws."""
    from estimator.replay import flight_images  # noqa: PLC0415
    from estimator.service.warm_up import warm_up  # noqa: PLC0415
    from models.sim.scenario import simulate  # noqa: PLC0415
    from models.sim.scenario_file import loads  # noqa: PLC0415

    warm_up()
    plan = loads(_SCENARIO)
    simulation = simulate(plan, 0)
    assert plan.cameras is not None
    flight_images.plan(plan.cameras, simulation, 0).draw(0)


def main() -> None:
    """With a line on stderr that reports progress."""
    terminal = sys.stderr.isatty()

    def report(share: float, now: str) -> None:
        if terminal:
            print(f"\r\x1b[Kcompiling {share:4.0%} {now[:100]}", end="", file=sys.stderr, flush=True)

    prepare(report)
    if terminal:
        print("\r\x1b[K", end="", file=sys.stderr)


if __name__ == "__main__":
    main()
