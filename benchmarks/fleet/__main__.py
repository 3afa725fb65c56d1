"""A fleet of recorded flights, cut and perturbed, in a bucket of this machine: cost, bytes, memory, rows after failures.

python -m benchmarks.fleet --flights 2000 --jobs 2 --out out/fleet

Each block of flights runs twice: as it is, and with a share of failing requests; in the middle block a worker is killed. What
has rows in OUT is not computed again: start it again to go on. OUT/fleet.json tells how far it came.
"""

import argparse
import os
import signal
import threading
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
from benchmarks.flights.tasks import ROOT
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.results import read
from estimator.tools.fleet.rows import COSTS
from estimator.tools.fleet.run import run, settings_of
from estimator.tools.fleet.store import flights
from estimator.version import version

BLOCK = 50
FAILING = 0.05
KILL_AFTER_S = 5.0
LABELS = ("clean", "stormy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    args = parser.parse_args()
    (args.out / "logs").mkdir(parents=True, exist_ok=True)
    command = f"python -m benchmarks.fleet --flights {args.flights} --jobs {args.jobs}"
    with bucket() as (store, application), cluster(args.jobs) as client:
        made = logs(args.out / "logs", args.flights)
        for start in range(0, args.flights, BLOCK):
            middle = start <= args.flights // 2 < start + BLOCK
            block(store, application, client, list(islice(made, BLOCK)), args.out, kill=middle)
            table = {
                "section": "Cut and perturbed flights in a bucket, clean and with failures",
                "command": command,
                "columns": ["quantity", "value"],
                "rows": list(summary(args.out).items()),
            }
            report = {"version": version(), "tables": [table]}
            (args.out / "fleet.json").write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")


def block(
    store: fsspec.AbstractFileSystem, application: Counted, client: Client, files: Sequence[Path], out: Path, *, kill: bool
) -> None:
    """Put the files into the bucket, run them under both labels, note what it took, and take them out again."""
    addresses = [f"s3://{NAME}/{file.name}" for file in files]
    store.put([str(file) for file in files], f"{NAME}/")
    found = flights(addresses)
    for label in LABELS:
        application.share = FAILING if label == "stormy" else 0.0
        gets, failed = application.gets, application.failed
        timer = threading.Timer(KILL_AFTER_S, kill_one, (client,))
        if kill and label == "stormy":
            timer.start()
        done = run(found, settings_of(label, None, "/truth"), str(out / "results"), client)
        timer.cancel()
        application.share = 0.0
        line = {
            "label": label,
            "done": done.done,
            "unfinished": len(done.unfinished),
            "requests": application.gets - gets,
            "failed_requests": application.failed - failed,
            "worker_killed": kill and label == "stormy",
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


def kill_one(client: Client) -> None:
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


def summary(out: Path) -> dict[str, Any]:
    """What the rows and the notes of all blocks say."""
    rows = {label: read(str(out / "results"), [label]).to_pylist() for label in LABELS}
    trace = [msgspec.json.decode(line) for line in (out / "trace.jsonl").read_bytes().splitlines()]
    clean = rows["clean"]
    speeds = [row["duration_s"] / row["cpu_s"] for row in clean if row["duration_s"]]
    hours = sum(row["duration_s"] or 0.0 for row in clean) / 3600.0
    seen = [row for row in clean if int(Path(row["log"]).stem) % WITH_IMAGES == 0]
    return {
        "flights": len(clean),
        "flights that failed": sum(bool(row["error"]) for row in clean),
        "flight hours": round(hours, 3),
        "flight hours a core hour, median": round(float(np.median(speeds)), 1),
        "bytes read of those stored, %": round(100.0 * share(clean), 2),
        "of logs with images, %": round(100.0 * share(seen), 2),
        "MB read a flight hour": round(sum(row["read_bytes"] for row in clean) / 1e6 / hours, 1),
        "requests": sum(line["requests"] for line in trace),
        "requests that failed": sum(line["failed_requests"] for line in trace),
        "workers killed": sum(line["worker_killed"] for line in trace),
        "flights without a row": sum(line["unfinished"] for line in trace),
        "rows equal in spite of failures": sum(a == b for a, b in zip(*map(bare, rows.values()), strict=True)),
        "memory of client and store after the first block, MB": trace[0]["client_mb"],
        "of client and store after the last, MB": trace[-1]["client_mb"],
        "memory of the largest worker after the first block, MB": max(trace[0]["workers_mb"]),
        "of the largest worker after the last, MB": max(trace[-1]["workers_mb"]),
    }


def share(rows: Sequence[dict[str, Any]]) -> float:
    """Bytes read of those that are stored."""
    return float(sum(row["read_bytes"] for row in rows) / max(1, sum(row["stored_bytes"] for row in rows)))


def bare(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows without what differs between equal runs."""
    return [{name: x for name, x in row.items() if name not in COSTS | {"label"}} for row in rows]


if __name__ == "__main__":
    main()
