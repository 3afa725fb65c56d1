"""Files that nobody should write, by the thousand, through importers and map readers.

    python -m benchmarks.service.fuzz_files --mutants 10000 [--formats csv map ...] [--seed 1] [--seconds 60] [--out FILE.json]

Formats that --out holds already, of as many mutants, are not read again. A mutant is a small real file, that is read as it is
before, with bytes changed, cut, doubled, moved or set to counts of 2^32 - 1. It is read in a child
process with a limit on CPU time (10 s) and on the memory that it may have above what the child begins with (1 GB). What must not
happen: an exception other than LogError or MapError, a message of more than one line, a limit reached, an end by a signal.
"""

import argparse
import json
import os
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.service import fuzz_seeds
from estimator.map_files import orthophoto, store
from estimator.map_files.extract.footprint import Place
from estimator.map_files.extract.get import get
from estimator.tools.maps import route
from estimator.version import version
from logs.importers import convert
from logs.store.reader import LogError, LogReader
from models.maps.table import MapError
from models.untrusted import toml_text

CPU_S: Final = 10
MEMORY_BYTES: Final = 2**30
_BATCH: Final = 200  # mutants of one child
_COUNTS: Final = (
    b"\xff\xff\xff\xff",
    b"\0\0\0\0",
    b"\xff\xff\xff\x7f",
    b"\0\0\0\x80",
    b"\xff" * 8,
    b"nan",
    b"[[",
    b'"x"',
    b"1e999",
)
_PLACE: Final = Place(47.4, 8.5, 3000.0)


_VALUES: Final[tuple[Any, ...]] = (
    None,
    True,
    0,
    -1,
    2**31,
    2**63,
    1e308,
    -1e308,
    1e-320,
    "",
    "nan",
    "x" * 4000,
    [],
    {},
    [[]],
    [None],
    91.0,
    181.0,
)


def mutant(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes of bytes; of a JSON document, every second time, of values: it stays one."""
    if data.startswith(b"{") and rng.random() < 0.5:
        return _other_values(data, rng)
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at, other = (int(rng.integers(0, max(1, len(changed)))) for _ in range(2))
        n = int(rng.integers(1, 40))
        match int(rng.integers(0, 6)):
            case 0:
                changed[at : at + 1] = bytes([int(rng.integers(0, 256))])
            case 1:
                word = _COUNTS[int(rng.integers(0, len(_COUNTS)))]
                changed[at : at + len(word)] = word
            case 2:
                del changed[at : at + n]
            case 3:
                changed[at:at] = changed[other : other + n]
            case 4 if rng.random() < 0.3:
                del changed[at:]
            case _:
                changed[at : at + n] = bytes(rng.integers(0, 256, n, dtype=np.uint8))
    return bytes(changed)


def _other_values(data: bytes, rng: np.random.Generator) -> bytes:
    """Values and whole parts of a JSON document replaced, taken out or moved."""
    document = json.loads(data)
    for _ in range(int(rng.integers(1, 5))):
        parts: list[dict[str, Any] | list[Any]] = [document]
        for part in parts:
            parts += [
                child for child in (part.values() if isinstance(part, dict) else part) if child and isinstance(child, dict | list)
            ]
        part, other = (parts[int(rng.integers(len(parts)))] for _ in range(2))
        keys = list(part) if isinstance(part, dict) else list(range(len(part)))
        if not keys:
            continue
        key = keys[int(rng.integers(len(keys)))]
        value = json.loads(json.dumps(_VALUES[int(rng.integers(len(_VALUES)))] if rng.random() < 0.8 else other))
        if rng.random() < 0.2:
            del part[key]  # type: ignore[arg-type]
        else:
            part[key] = value  # type: ignore[index]
    return json.dumps(document).encode()


def _imported(kind: str) -> Callable[[Path, Path], object]:
    return lambda path, out: convert(kind, path.parent if kind == "csv" else path, out / "out.mcap")


def _read_log(path: Path, _: Path) -> None:
    with LogReader(path) as reader:
        for _record in reader:
            pass


def _toml(path: Path, _: Path) -> None:
    try:
        toml_text.table(toml_text.decode(path.read_bytes()))
    except ValueError as error:
        raise MapError(str(error)) from None


READERS: Final[dict[str, tuple[str, Callable[[Path, Path], object]]]] = {  # format: name of its file, what reads it
    "csv": ("imu.csv", _imported("csv")),
    "csv.gz": ("imu.csv.gz", _imported("csv")),
    "ulog": ("a.ulg", _imported("ulog")),
    "dataflash": ("a.bin", _imported("dataflash")),
    "tlog": ("a.tlog", _imported("tlog")),
    "mcap": ("a.mcap", _read_log),
    "bag": ("a.bag", _imported("rosbag")),
    "map": ("a.geojson", lambda path, _: store.load(path)),
    "extract": ("a.geojson", lambda path, _: get(path, _PLACE)),
    "overpass": ("a.json", lambda path, _: get(path, _PLACE)),
    "geotiff": ("a.tif", lambda path, _: orthophoto.load(path)),
    "route": ("a.gpx", lambda path, _: route.read(path)),
    "toml": ("a.toml", _toml),
}


def fuzz(name: str, count: int, seed: int, seconds: float) -> dict[str, Any]:
    """Of one format: mutants, outcomes, findings, the most CPU time of one [s]."""
    file, read = READERS[name]
    seeds = fuzz_seeds.of(name)
    outcomes: Counter[str] = Counter()
    findings: list[str] = []
    worst, done, began = 0.0, 0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for data in seeds:  # read as they are, and what their readers import is there before a child is forked
            read(_written(Path(folder), file, data), Path(folder))
        while done < count and time.monotonic() - began < seconds and seeds:
            batch = range(done, min(count, done + _BATCH))
            for number, outcome, cpu_s in _batch(Path(folder), file, read, seeds, seed, batch):
                outcomes[outcome.partition(":")[0]] += 1
                worst = max(worst, cpu_s)
                if outcome not in {"read", "refused"}:
                    findings.append(f"seed {seed}, mutant {number}: {outcome}")
            done = batch.stop
    return {"mutants": done, "outcomes": dict(outcomes), "most_cpu_s": round(worst, 2), "findings": findings[:20]}


def _batch(
    folder: Path, file: str, read: Callable[[Path, Path], object], seeds: list[bytes], seed: int, numbers: range
) -> list[tuple[int, str, float]]:
    """Read in one child; the rest of the batch in another one where it dies."""
    results: list[tuple[int, str, float]] = []
    at = numbers.start
    while at < numbers.stop:
        theirs, ours = os.pipe()
        if (child := os.fork()) == 0:
            os.close(theirs)
            _in_child(ours, folder, file, read, seeds, seed, range(at, numbers.stop))
        os.close(ours)
        with os.fdopen(theirs) as pipe:
            lines = [json.loads(line) for line in pipe]
        _, status = os.waitpid(child, 0)
        results += [(n, outcome, cpu_s) for n, outcome, cpu_s in lines]
        at += len(lines)
        if at < numbers.stop and (status or not lines):
            results.append((at, f"died: status {status}", float(CPU_S)))
            at += 1
    return results


def _in_child(
    pipe: int, folder: Path, file: str, read: Callable[[Path, Path], object], seeds: list[bytes], seed: int, numbers: range
) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY_BYTES,) * 2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    for number in numbers:
        rng = np.random.default_rng((seed, number))
        path = _written(folder, file, mutant(seeds[number % len(seeds)], rng))
        used = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(used) + CPU_S + 1, resource.RLIM_INFINITY))
        outcome = _outcome(read, path, folder)
        cpu_s = time.process_time() - used
        if cpu_s > CPU_S:
            outcome = "slow"
        os.write(pipe, (json.dumps([number, outcome, cpu_s]) + "\n").encode())
    os._exit(0)


def _written(folder: Path, file: str, data: bytes) -> Path:
    path = folder / "in" / file
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def _outcome(read: Callable[[Path, Path], object], path: Path, out: Path) -> str:
    try:
        read(path, out)
    except (LogError, MapError) as error:
        return "refused" if "\n" not in str(error) and "fits into memory" not in str(error) else f"wrong message: {error}"
    except BaseException as error:
        return f"uncaught: {type(error).__name__}: {error}"
    return "read"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=10_000, help="of each format")
    parser.add_argument("--formats", nargs="*", choices=READERS, default=list(READERS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=3600.0, help="at most, of each format")
    parser.add_argument("--out", type=Path, help="results as JSON")
    given = parser.parse_args()
    kept = json.loads(given.out.read_text())["formats"] if given.out and given.out.is_file() else {}
    results: dict[str, Any] = {name: kept[name] for name in READERS if kept.get(name, {}).get("mutants", 0) >= given.mutants}
    for name in [name for name in given.formats if name not in results]:
        results[name] = fuzz(name, given.mutants, given.seed, given.seconds)
        print(name, results[name], flush=True)
        if given.out:
            words = f"--mutants {given.mutants} --seed {given.seed} --seconds {given.seconds:g}"
            command = f"python -m benchmarks.service.fuzz_files {words}"
            document = {"version": version(), "command": command, "cpu_limit_s": CPU_S, "memory_limit_bytes": MEMORY_BYTES}
            given.out.write_text(json.dumps(document | {"formats": results}, indent=1) + "\n")
    raise SystemExit(any(r["findings"] for r in results.values()))


if __name__ == "__main__":
    main()
