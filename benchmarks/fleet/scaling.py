"""Constants of the engine and the results, measured, and what they make of a million flights on a thousand workers.

python -m benchmarks.fleet.scaling --tasks 4000 --rows 20000 --out out/fleet
"""

import argparse
import json
import resource
import time
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from estimator.tools.fleet.engine import cluster, results
from estimator.tools.fleet.results import Results, read
from estimator.tools.fleet.rows import Row
from estimator.version import version

_FLIGHTS, _WORKERS, _CPU_S = 1_000_000, 1_000, 30.0
_ROWS_A_FILE = 330  # that come in 10 s from so many workers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=4000)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found = {"version": version(), "command": f"python -m benchmarks.fleet.scaling --tasks {args.tasks} --rows {args.rows}"}
    of_engine, of_results = engine(args.tasks), kept(args.rows)
    report = {**found, "engine": of_engine, "results": of_results, "a million flights": extrapolated(of_engine, of_results)}
    (args.out / "scaling.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


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


def engine(tasks: int) -> dict[str, float]:
    """Empty tasks that answer with a row: time of client and scheduler for each, memory, tasks known at a time."""
    with cluster(1) as client:
        list(results(client, row, range(100)))
        cpu_s, memory_mb = time.process_time(), _memory_mb()
        known = 0
        for k, _ in enumerate(results(client, row, range(tasks))):
            if k % 500 == 0:
                known = max(known, client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))
        return {
            "ms_a_task": 1e3 * (time.process_time() - cpu_s) / tasks,
            "tasks_known_at_most": known,
            "memory_growth_mb": _memory_mb() - memory_mb,
        }


def kept(count: int) -> dict[str, float]:
    """Rows in files as they come, compacted, read."""
    with TemporaryDirectory() as folder:
        results_ = Results(folder, "run")
        began = time.process_time()
        for start in range(0, count, _ROWS_A_FILE):
            results_.add([row(k) for k in range(start, min(start + _ROWS_A_FILE, count))])
        written = time.process_time()
        results_.compact()
        compacted = time.process_time()
        length = len(read(folder))
        files = list(Path(folder).rglob("*.parquet"))
        return {
            "rows": length,
            "write_us_a_row": 1e6 * (written - began) / count,
            "compact_us_a_row": 1e6 * (compacted - written) / count,
            "read_us_a_row": 1e6 * (time.process_time() - compacted) / count,
            "bytes_a_row": sum(f.stat().st_size for f in files) / count,
            "files": len(files),
        }


def extrapolated(of_engine: dict[str, float], of_results: dict[str, float]) -> dict[str, Any]:
    """Arithmetic with the constants above; a flight costs _CPU_S."""
    hours = _FLIGHTS * _CPU_S / _WORKERS / 3600.0
    rate = _WORKERS / _CPU_S
    return {
        "assumed": {"flights": _FLIGHTS, "workers": _WORKERS, "cpu_s_a_flight": _CPU_S},
        "hours": hours,
        "tasks_known_to_the_scheduler": 3 * _WORKERS,
        "tasks_a_second": rate,
        "load_of_client_and_scheduler": rate * (of_engine["ms_a_task"] * 1e-3 + of_results["write_us_a_row"] * 1e-6),
        "workers_at_full_load": 1.0 / (of_engine["ms_a_task"] * 1e-3) * _CPU_S,
        "files_before_compaction": hours * 3600.0 / 10.0,
        "compaction_minutes": of_results["compact_us_a_row"] * _FLIGHTS / 6e7,
        "result_gb": of_results["bytes_a_row"] * _FLIGHTS / 1e9,
    }


def _memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    main()
