"""A fleet of recorded flights, cut and perturbed, in a bucket of this machine that fails a share of the requests.

In every tenth block of flights a worker is killed; every fifth block runs without failures too: the rows have to be equal.
What has a row in OUT is not computed again.
"""

import os
import signal
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import fsspec
import msgspec
import numpy as np
from distributed import Client

from benchmarks.fleet.bucket import NAME, Counted, bucket
from benchmarks.fleet.logs import WITH_IMAGES, logs
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.results import Results, read
from estimator.tools.fleet.rows import COSTS
from estimator.tools.fleet.run import run, settings_of
from estimator.tools.fleet.store import flights

BLOCK = 50
FAILING = 0.05
CLEAN, STORMY = "clean", "stormy"


def table(count: int, jobs: int, out: Path) -> dict[str, Any]:
    """`count` flights on `jobs` workers."""
    with bucket() as (store, application), cluster(jobs) as client:
        made = logs(out / "logs", count)
        known = {label: Results(str(out / "results"), label).keys() for label in (STORMY, CLEAN)}
        for k in range(-(-count // BLOCK)):
            files, labels = list(islice(made, BLOCK)), (STORMY, CLEAN) if k % 5 == 0 else (STORMY,)
            if any(f"s3://{NAME}/{file.name}" not in known[label] for file in files for label in labels):
                block(store, application, client, files, out, labels, kill=k % 10 == 0)
    quantities = [[name, value] for name, value in summary(out).items()]
    section = "Cut and perturbed flights in a bucket with failing requests and killed workers"
    return {"section": section, "columns": ["quantity", "value"], "rows": quantities}


def block(
    store: fsspec.AbstractFileSystem,
    application: Counted,
    client: Client,
    files: Sequence[Path],
    out: Path,
    labels: Sequence[str],
    *,
    kill: bool,
) -> None:
    """Put the files into the bucket, run them, note what it took, and take them out again."""
    addresses = [f"s3://{NAME}/{file.name}" for file in files]
    store.put([str(file) for file in files], f"{NAME}/")
    found = flights(addresses)
    for label in labels:
        application.share = FAILING if label == STORMY else 0.0
        gets, failed = application.gets, application.failed
        killer = Killer(client, armed=kill and label == STORMY)
        done = run(found, settings_of(label, None, "/truth"), str(out / "results"), client, killer)
        application.share = 0.0
        line = {
            "label": label,
            "done": done.done,
            "unfinished": len(done.unfinished),
            "requests": application.gets - gets,
            "failed_requests": application.failed - failed,
            "killed": killer.killed,
            "client_mb": memory_mb(),
            "workers_mb": sorted(client.run(memory_mb).values()),
        }
        if done.done:
            with (out / "trace.jsonl").open("ab") as trace:
                trace.write(msgspec.json.encode(line) + b"\n")
    store.rm(addresses)


def memory_mb() -> float:
    """Resident, of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)


class Killer:
    """Kills a worker when half of the flights are done; stands where a run has its progress bar."""

    def __init__(self, client: Client, *, armed: bool) -> None:
        self._client, self._armed, self.killed = client, armed, False

    def __call__(self, fraction: float, _: str) -> None:
        """A flight is done."""
        if self._armed and fraction >= 0.5:
            os.kill(next(iter(self._client.run(os.getpid).values())), signal.SIGKILL)
            self._armed, self.killed = False, True


def summary(out: Path) -> dict[str, Any]:
    """What the rows and the notes of all blocks say."""
    rows = {label: read(str(out / "results"), [label]).to_pylist() for label in (STORMY, CLEAN)}
    trace = [msgspec.json.decode(line) for line in (out / "trace.jsonl").read_bytes().splitlines()]
    all_rows, clean = rows[STORMY], {row["log"]: bare(row) for row in rows[CLEAN]}
    speeds = [row["duration_s"] / row["cpu_s"] for row in all_rows if row["duration_s"]]
    hours = sum(row["duration_s"] or 0.0 for row in all_rows) / 3600.0
    seen = [row for row in all_rows if int(Path(row["log"]).stem) % WITH_IMAGES == 0]
    return {
        "flights": len(all_rows),
        "flights that failed": sum(bool(row["error"]) for row in all_rows),
        "flight hours": round(hours, 3),
        "flight hours a core hour, median": round(float(np.median(speeds)), 1),
        "bytes read of those stored, %": round(100.0 * share(all_rows), 2),
        "of logs with images, %": round(100.0 * share(seen), 2),
        "MB read a flight hour": round(sum(row["read_bytes"] for row in all_rows) / 1e6 / hours, 1),
        "requests": sum(line["requests"] for line in trace),
        "requests that failed": sum(line["failed_requests"] for line in trace),
        "workers killed": sum(line["killed"] for line in trace),
        "flights without a row": sum(line["unfinished"] for line in trace),
        "flights with a clean run beside": len(clean),
        "of them equal rows": sum(bare(row) == clean.get(row["log"]) for row in all_rows),
        **memory(trace),
    }


def memory(trace: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Of the processes after each block, MB: the median of the first and the last quarter of the blocks."""
    quarter = max(1, len(trace) // 4)
    store, worker = ([line["client_mb"] for line in trace], [max(line["workers_mb"]) for line in trace])
    return {
        "memory of client and store, first quarter, MB": float(np.median(store[:quarter])),
        "last quarter": float(np.median(store[-quarter:])),
        "memory of the largest worker, first quarter, MB": float(np.median(worker[:quarter])),
        "last quarter of it": float(np.median(worker[-quarter:])),
    }


def share(rows: Sequence[dict[str, Any]]) -> float:
    """Bytes read of those that are stored."""
    return float(sum(row["read_bytes"] for row in rows) / max(1, sum(row["stored_bytes"] for row in rows)))


def bare(row: dict[str, Any]) -> dict[str, Any]:
    """The row without what differs between equal runs."""
    return {name: x for name, x in row.items() if name not in COSTS | {"label"}}
