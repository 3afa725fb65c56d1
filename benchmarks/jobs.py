"""Long work in small jobs on the fleet's engine: with progress, each result kept as it comes, and never done again."""

import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import cv2
import msgspec
from rich.console import Console
from rich.progress import track

from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.engine import results as results_of

Job = TypeVar("Job", bound=tuple[object, ...])
Result = TypeVar("Result")


def run_jobs(
    jobs: Sequence[Job],
    work: Callable[[Job], Result],
    kind: type[Result],
    kept: Path,
    *,
    processes: int | None = 1,
    resume: bool = False,
    scheduler: str = "",
) -> list[Result]:
    """The jobs' results in their order. kept: file of one line a job; with resume those that stand there are not done again;
    processes: None: one a core.

    work: a function of a module; kind: what it returns, for msgspec; scheduler: of workers in place of processes here. Raises
    what a job raised.
    """
    decoder = msgspec.json.Decoder(tuple[str, kind])  # type: ignore[valid-type]
    results = dict(results_in(kept, kind)) if resume else {}
    left = [job for job in jobs if _name(job) not in results]
    kept.parent.mkdir(parents=True, exist_ok=True)
    with cluster(processes, scheduler) as client, kept.open("w") as file:
        for name, result in results.items():  # anew: the last line may have been cut off
            file.write(_line(name, result))
        file.flush()  # nothing is lost when the process is killed before its first job is done
        done = results_of(client, _alone, left, importable(work))
        for job, outcome in track(done, "jobs", len(left), console=Console(stderr=True)):
            if isinstance(outcome, Exception):
                raise outcome
            line = _line(_name(job), outcome)
            results[_name(job)] = decoder.decode(line)[1]
            file.write(line)
            file.flush()
    return [results[_name(job)] for job in jobs]


def _alone(job: Job, work: Callable[[Job], Result]) -> Result:
    """A job on a worker, of which there is one a core."""
    cv2.setNumThreads(1)
    return work(job)


def importable(work: Callable[[Job], Result]) -> Callable[[Job], Result]:
    """The function under the name by which a worker imports it, also where its module was started with python -m."""
    if work.__module__ != "__main__":
        return work
    spec = sys.modules["__main__"].__spec__
    assert spec is not None, "start benchmarks with python -m"
    found: Callable[[Job], Result] = getattr(import_module(spec.name), work.__name__)
    return found


def _name(job: tuple[object, ...]) -> str:
    return " ".join(map(str, job))


def _line(name: str, result: object) -> str:
    return msgspec.json.encode((name, result)).decode() + "\n"


def results_in(kept: Path, kind: type[Result]) -> Iterator[tuple[str, Result]]:
    """Names and results of a file; a last line that was cut off does not count."""
    decoder = msgspec.json.Decoder(tuple[str, kind])  # type: ignore[valid-type]
    for line in kept.read_text().splitlines() if kept.is_file() else []:
        try:
            yield decoder.decode(line)
        except msgspec.DecodeError:
            return
