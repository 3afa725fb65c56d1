"""Long work in small jobs over processes: with progress, each result kept as it comes, and taken up again where it was ended."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TypeVar

import cv2
import msgspec
from rich.console import Console
from rich.progress import track

Job = TypeVar("Job", bound=tuple[object, ...])
Result = TypeVar("Result")


def run_jobs(
    jobs: Sequence[Job],
    work: Callable[[Job], Result],
    kind: type[Result],
    kept: Path,
    *,
    processes: int = 1,
    resume: bool = False,
    executor: Executor | None = None,
) -> list[Result]:
    """The jobs' results in their order. kept: file of one line a job; with resume those that stand there are not done again.

    work: a function of a module; kind: what it returns, for msgspec; executor: does the work in place of processes here.
    """
    results = dict(results_in(kept, kind)) if resume else {}
    left = [job for job in jobs if _name(job) not in results]
    kept.parent.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    with kept.open("w") as file, context.Pool(processes, cv2.setNumThreads, (1,)) as pool:
        for name, result in results.items():  # anew: the last line may have been cut off
            file.write(_line(name, result))
        file.flush()  # nothing is lost when the process is killed before its first job is done
        done = pool.imap(work, left) if executor is None else executor.map(work, left)
        for job, result in track(zip(left, done, strict=True), "jobs", len(left), console=Console(stderr=True)):
            results[_name(job)] = result
            file.write(_line(_name(job), result))
            file.flush()
    return [results[_name(job)] for job in jobs]


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
