"""A fleet of cut flights in a bucket of this machine: flight hours a core hour, bytes read, memory, rows after failures.

python -m benchmarks.fleet --flights 200 --jobs 1 --out out/fleet

The flights are windows of simulated ones, each with noise of its own on its fixes. One run, the same again with a share of
failing requests and one worker killed, and a run with one noise parameter changed on a tenth of the flights.
"""

import argparse
import json
import os
import resource
import signal
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec
import msgspec
import numpy as np
from distributed import Client

from benchmarks.fleet.bucket import NAME, Counted, bucket
from benchmarks.flights.tasks import ROOT
from estimator.config import parse
from estimator.replay import simulate as simulated
from estimator.tools.fleet.compare import compare
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.flight import Settings
from estimator.tools.fleet.results import read
from estimator.tools.fleet.rows import COSTS
from estimator.tools.fleet.run import RunSummary, run, settings_of
from estimator.tools.fleet.store import flights
from estimator.version import version
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

SCENARIO = """
duration_s = {seconds}
[imu]
rate_hz = 100.0
[gnss]
outages_s = [[{outage_s}, {seconds}]]
[pose_fix]
rate_hz = 1.0
delay_s = 0.3
"""
_FAILING = 0.05
_KILL_AFTER_S = 20.0


def main() -> None:
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    with bucket() as (store, application), TemporaryDirectory() as folder:
        config = filled(store, Path(folder), args.flights, args.seconds)
        settings = settings_of("first", config, "/truth")
        report: dict[str, Any] = {
            "version": version(),
            "command": f"python -m benchmarks.fleet --flights {args.flights} --seconds {args.seconds} --jobs {args.jobs}",
            "first": measured(store, application, settings, args.jobs),
            "with failures": measured(store, application, labelled(settings, "stormy"), args.jobs, storm=True),
        }
        report["rows equal"] = rows("first") == rows("stormy")
        print(json.dumps(report, indent=1), flush=True)
        report["change found"] = found_change(settings, args.jobs, args.flights)
    (args.out / "fleet.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report["change found"], indent=1))


def filled(store: fsspec.AbstractFileSystem, folder: Path, count: int, seconds: float) -> Path:
    """The flights in the bucket; their configuration."""
    config = folder / "vehicle.toml"
    for seed in range(count):
        flight = simulate(loads(SCENARIO.format(seconds=seconds, outage_s=seconds / 2)), seed=seed)
        simulated.write(flight, folder / "flight.mcap")
        store.put_file(str(folder / "flight.mcap"), f"{NAME}/{seed:05}.mcap")
        config.write_text(flight.config_toml)
    return config


def measured(
    store: fsspec.AbstractFileSystem, application: Counted, settings: Settings, jobs: int, *, storm: bool = False
) -> dict[str, Any]:
    """A run and what it cost; storm: requests fail and a worker is killed."""
    found = flights([f"s3://{NAME}/*.mcap"])
    application.share = _FAILING if storm else 0.0
    sent, gets, failed = application.sent_bytes, application.gets, application.failed
    began, cpu_s = time.monotonic(), time.process_time()
    memory = list[float]()
    with cluster(jobs) as client:
        if storm:
            threading.Timer(_KILL_AFTER_S, kill_one, (client,)).start()
        done = watched(client, settings, memory, found)
    application.share = 0.0
    speeds = [row["duration_s"] / row["cpu_s"] for row in read(f"s3://{NAME}/results", [settings.label]).to_pylist()]
    return {
        **msgspec.to_builtins(done),
        "hours_a_core_hour_median": float(np.median(speeds)),  # without the first flight of a process, which loads the kernels
        "wall_s": time.monotonic() - began,
        "client_and_store_cpu_s": time.process_time() - cpu_s,
        "requests": application.gets - gets,
        "failed_requests": application.failed - failed,
        "sent_bytes": application.sent_bytes - sent,
        "client_memory_mb": [round(mb) for mb in memory],
        "bytes_in_store": store.du(f"{NAME}/results"),
    }


def watched(client: Client, settings: Settings, memory: list[float], found: list[Any]) -> RunSummary:
    """The run, with the memory of this process (client, scheduler and store) at each quarter."""
    seen: set[int] = set()

    def progress(fraction: float, _: str) -> None:
        if (quarter := int(4 * fraction)) not in seen:
            seen.add(quarter)
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)

    return run(found, settings, f"s3://{NAME}/results", client, progress)


def kill_one(client: Client) -> None:
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


def rows(label: str) -> list[dict[str, Any]]:
    """The rows of a label without what differs between equal runs."""
    found: list[dict[str, Any]] = read(f"s3://{NAME}/results", [label]).to_pylist()
    return [{name: x for name, x in row.items() if name not in COSTS | {"label"}} for row in found]


def labelled(settings: Settings, label: str) -> Settings:
    return msgspec.structs.replace(settings, label=label)


def found_change(settings: Settings, jobs: int, count: int) -> dict[str, Any]:
    """Gyroscope noise x 3 on every tenth flight, the rest as before: which flights the comparison lists first."""
    text = settings.configuration or ""
    config = parse(text)
    wrong = msgspec.structs.replace(
        config, imu=msgspec.structs.replace(config.imu, gyro_noise=3.0 * config.imu.gyro_noise)
    ).toml()
    found = flights([f"s3://{NAME}/*.mcap"])
    changed = {flight.log for flight in found[::10]}
    with cluster(jobs) as client:
        for some, configuration in ((changed, wrong), ({f.log for f in found} - changed, text)):
            asked = msgspec.structs.replace(settings, label="changed", configuration=configuration)
            run([f for f in found if f.log in some], asked, f"s3://{NAME}/results", client)
    compared = compare(read(f"s3://{NAME}/results"), ("first", "changed"))
    equal = compare(read(f"s3://{NAME}/results"), ("first", "stormy"))
    moved = [change.log for change in sorted(compared.changes, key=lambda c: -abs(c.worse))]
    return {
        "changed flights": len(changed),
        "of them moved": sum(change.worse != 0.0 for change in compared.changes if change.log in changed),
        "others that moved": sum(change.worse != 0.0 for change in compared.changes if change.log not in changed),
        "of them first": sum(log in changed for log in moved[: len(changed)]),
        "moved between equal runs": sum(change.worse != 0.0 for change in equal.changes),
        "flights": count,
    }


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    return parser.parse_args()


if __name__ == "__main__":
    main()
