"""Compiles missing kernels: python -m estimator.tools.kernels"""

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
_SIGNATURES: Final = 128  # are compiled, of which the bar is a share
_AT_A_TIME: Final = 2

Report = Callable[[float, str], None]  # share that is done, and what is compiled now


class KernelsError(Exception):
    """They could not be compiled."""


def prepare(report: Report = lambda _, __: None, parts: Sequence[Callable[[], None]] = ()) -> None:
    """Compile all where a source has changed. Raises KernelsError."""
    if compilation.is_current():
        return
    compilation.forget()
    waiting, processes = list(parts or PARTS), list[BaseProcess]()
    pipes, now, done = list[Connection](), dict[Connection, str](), 0
    try:
        while waiting or pipes:
            while waiting and len(pipes) < _AT_A_TIME:
                process, pipe = _begun(waiting.pop(0))
                processes.append(process)
                pipes.append(pipe)
            for pipe in _ready(pipes):
                try:
                    now[pipe] = pipe.recv()
                    done += bool(now[pipe])
                except EOFError:
                    pipes.remove(pipe)
                    now.pop(pipe, None)
                report(min(done / _SIGNATURES, 1.0), ", ".join(filter(None, now.values())))
    except BaseException:
        for begun in processes:
            begun.terminate()
        raise
    for ended in processes:
        ended.join()
        if ended.exitcode != 0:
            raise KernelsError(f"kernels cannot be compiled: {ended.name} ended with {ended.exitcode}, and said above why")
    compilation.mark_current()


def _begun(part: Callable[[], None]) -> tuple[BaseProcess, Connection]:
    ours, theirs = SPAWNED.Pipe(duplex=False)
    process = SPAWNED.Process(target=_compile, args=(theirs, part), name=f"landfix-compile{part.__name__}")
    process.start()
    theirs.close()
    return process, ours


def _ready(pipes: list[Connection]) -> list[Connection]:
    return [pipe for pipe in wait(pipes) if isinstance(pipe, Connection)]


def _compile(pipe: Connection, part: Callable[[], None]) -> None:
    def heard(kernel: str, _: float) -> None:
        pipe.send(kernel)
        if not kernel:  # it is done, and most of what it took refers to itself; what is left is not looked at again
            gc.collect()
            gc.freeze()

    gc.disable()  # a sixth of the time: the compiler makes many objects
    compilation.listen(heard)
    part()
    pipe.close()


def _seen_at_once() -> None:
    _images(0)


def _searched() -> None:
    _images(1)


def _segmented() -> None:
    _images(2)


def _images(k: int) -> None:
    from estimator.service.vision.warm_up import PRIORS_M, warm_up  # noqa: PLC0415  (each process loads what it needs)

    warm_up(PRIORS_M[k : k + 1])


def _flight() -> None:
    from estimator.service.warm_up import warm_up  # noqa: PLC0415

    warm_up()


def _drawing() -> None:
    from estimator.replay import flight_images  # noqa: PLC0415
    from models.sim.scenario import simulate  # noqa: PLC0415
    from models.sim.scenario_file import loads  # noqa: PLC0415

    plan = loads(_SCENARIO)
    simulation = simulate(plan, 0)
    assert plan.cameras is not None
    flight_images.plan(plan.cameras, simulation, 0).draw(0)


# The dearest first. A part finds what the ones before it have compiled, and gives its memory back.
PARTS: Final = (_seen_at_once, _flight, _drawing, _segmented, _searched)


def each_tenth(title: str) -> Report:
    """Progress on stderr without a terminal: a line a tenth."""
    reached = -1

    def report(share: float, now: str = "") -> None:
        nonlocal reached
        if int(10.0 * share) > reached:
            reached = int(10.0 * share)
            print(f"{title} {share:4.0%} {now}".rstrip(), file=sys.stderr, flush=True)

    return report


def main() -> None:
    """Compile, with progress on stderr."""
    if not sys.stderr.isatty():
        prepare(each_tenth("compiling"))
        return
    prepare(lambda share, now: print(f"\r\x1b[Kcompiling {share:4.0%} {now[:100]}", end="", file=sys.stderr, flush=True))
    print("\r\x1b[K", end="", file=sys.stderr)


if __name__ == "__main__":
    main()
