"""One task through one estimator, scored: the work that benchmarks.flights.real spreads over processes."""

import hashlib
import json
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.flights import naive_filter
from benchmarks.flights.naive_filter import NaiveFilter
from benchmarks.flights.tasks import Task, make, score
from estimator.config import load
from estimator.replay.replay import replay
from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder, ImuMounting, Topics, encode
from models.imu import ImuNoise
from models.messages import ImuSample

OURS, NAIVE = "landfix", "naive"


class Job(NamedTuple):
    """A task for one or more estimators. config: in place of the task's own."""

    task: Task
    estimators: tuple[str, ...]
    config: str
    folder: str


def run(job: Job) -> list[dict[str, Any]]:
    """Make the task, run each estimator over it, score it; nothing if the flight is too short for the scenario."""
    folder = Path(job.folder)
    task_file = make(job.task, folder / "tasks")
    if task_file is None:
        return []
    config = Path(job.config) if job.config else task_file.with_suffix(".toml")
    return [_scored(job.task, name, task_file, config, folder) for name in job.estimators]


def _scored(task: Task, estimator: str, task_file: Path, config: Path, folder: Path) -> dict[str, Any]:
    """The score of one estimator. The naive filter's is kept next to the task, for none of what it is made of changes."""
    kept = task_file.with_suffix(f".naive-{_sha(Path(naive_filter.__file__))}-{_sha(config)}.json")
    if estimator == NAIVE and kept.exists():
        return dict(json.loads(kept.read_text()))
    estimate = folder / f"{task_file.stem}-{estimator}.mcap"
    began = time.perf_counter()
    extra = ESTIMATORS[estimator](task_file, config, estimate)
    elapsed = time.perf_counter() - began
    result = {**score(task_file, estimate), **extra, "estimator": estimator, "set": task.group, "elapsed_s": elapsed}
    result |= {"flight": task.flight, "scenario": task.scenario, "seed": task.seed}
    estimate.unlink()
    if estimator == NAIVE:
        kept.write_text(json.dumps(result))
    return result


def run_ours(task_file: Path, config: Path, out: Path) -> dict[str, Any]:
    """`landfix replay task.mcap -o out -c task.toml`."""
    summary = replay(task_file, out, load(config))
    return {"summary": msgspec.to_builtins(summary)}


def run_naive(task_file: Path, config: Path, out: Path) -> dict[str, Any]:
    """The same files through the plain filter: one Odometry per IMU sample."""
    settings = tomllib.loads(config.read_text())
    axes = settings["imu"].pop("axes")
    decoder, naive = Decoder(Topics.of(settings["inputs"]), ImuMounting(axes=axes)), NaiveFilter(ImuNoise(**settings["imu"]))
    with LogReader(task_file) as reader, Recorder(out, metadata={}) as recorder:
        for record in reader:
            message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
            if message is None:
                continue
            naive.handle(message)
            if isinstance(message, ImuSample) and naive.started:
                for topic, schema, data in encode(naive.estimate(message.arrived_ns)):
                    recorder.write(topic, schema, data, record.log_time_ns)
    return {}


ESTIMATORS: dict[str, Callable[[Path, Path, Path], dict[str, Any]]] = {OURS: run_ours, NAIVE: run_naive}


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:8]
