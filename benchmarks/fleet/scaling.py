"""Constants of the engine and the results, measured, and what they make of a million flights on a thousand workers."""

import resource
import time
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
from distributed import Client, LocalCluster

from estimator.tools.fleet.engine import AHEAD, cluster, results
from estimator.tools.fleet.results import Results, read
from estimator.tools.fleet.rows import Row
from estimator.tools.fleet.run import KEPT_EVERY_S

_FLIGHTS, _WORKERS, _CPU_S = 1_000_000, 1_000, 30.0
_TASKS, _ROWS, _MANY = 4000, 20_000, 100  # measured with
_ROWS_A_FILE = 330  # that come in 10 s from so many workers


def table(*_: object) -> dict[str, Any]:
    """What is measured, with one worker beside and with many in this process, and what follows from it."""
    with cluster(1) as client:
        alone = engine(client, _TASKS)
    with (
        LocalCluster(n_workers=_MANY, threads_per_worker=1, processes=False, dashboard_address=None) as local,
        Client(local) as client,
    ):
        many = {f"{name}, {_MANY} workers": value for name, value in engine(client, _TASKS).items()}
    of_results = kept(_ROWS)
    found = {**alone, **many, **of_results, **extrapolated(alone, of_results)}
    rows = [[name, float(f"{value:.3g}")] for name, value in found.items()]
    return {"section": "A million flights on a thousand workers", "columns": ["quantity", "value"], "rows": rows}


def row(k: int) -> Row:
    """A row as large as a real one: digests, and numbers with all their digits."""
    drawn = iter(np.random.default_rng(k).random(64).tolist())
    measured = {f.name: next(drawn) for f in msgspec.structs.fields(Row) if f.type in {float, float | None}}
    digest = sha256(str(k).encode()).hexdigest()
    return Row(
        key=digest[:32], label="run", log=f"s3://flights/2026/{k:09}.mcap", parts=1, stored_bytes=k, inputs_sha256=digest,
        configuration_sha256="c" * 64, nis={"/gnss gnss_position": next(drawn), "/pose_fix pose": next(drawn)},
        refused={"gated": k % 7}, modes={"aided": next(drawn)}, **measured,
    )  # fmt: skip


def engine(client: Client, tasks: int) -> dict[str, float]:
    """Empty tasks that answer with a row: time of this process for each, its memory, tasks known at a time."""
    list(results(client, row, range(100)))
    cpu_s, memory_mb, known = time.process_time(), _memory_mb(), 0
    for k, _ in enumerate(results(client, row, range(tasks))):
        if k % 500 == 0:
            known = max(known, client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))
    spent_ms = 1e3 * (time.process_time() - cpu_s) / tasks
    return {"ms a task": spent_ms, "tasks known at most": known, "memory growth, MB": _memory_mb() - memory_mb}


def kept(count: int) -> dict[str, float]:
    """Rows in files as they come, compacted, read; microseconds and bytes a row."""
    rows = [row(k) for k in range(count)]
    with TemporaryDirectory() as folder:
        results_ = Results(folder, "run")
        began = time.process_time()
        for start in range(0, count, _ROWS_A_FILE):
            results_.add(rows[start : start + _ROWS_A_FILE])
        written = time.process_time()
        results_.compact()
        compacted = time.process_time()
        assert len(read(folder)) == count
        after = time.process_time()
        files = list(Path(folder).rglob("*.parquet"))
        return {
            "write, us a row": 1e6 * (written - began) / count,
            "compact, us a row": 1e6 * (compacted - written) / count,
            "read, us a row": 1e6 * (after - compacted) / count,
            "bytes a row": sum(f.stat().st_size for f in files) / count,
        }


def extrapolated(of_engine: dict[str, float], of_results: dict[str, float]) -> dict[str, float]:
    """Arithmetic with the constants above."""
    spent_s, rate = of_engine["ms a task"] * 1e-3, _WORKERS / _CPU_S
    hours = _FLIGHTS * _CPU_S / _WORKERS / 3600.0
    return {
        "flights": _FLIGHTS,
        "workers": _WORKERS,
        "assumed: core seconds a flight": _CPU_S,
        "hours": hours,
        "tasks known to the scheduler": AHEAD * _WORKERS,
        "tasks a second": rate,
        "load of client and scheduler, cores": rate * (spent_s + of_results["write, us a row"] * 1e-6),
        "workers at a load of one core": _CPU_S / spent_s,
        "files before compaction": hours * 3600.0 / KEPT_EVERY_S,
        "compaction, minutes": of_results["compact, us a row"] * _FLIGHTS / 6e7,
        "results, GB": of_results["bytes a row"] * _FLIGHTS / 1e9,
    }


def _memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
