"""Damaged files of each format through importers and map readers.

A mutant is a small real file, which is read whole before, with bytes changed, cut, doubled, moved or set to counts of 2^32 - 1.
What must not happen: an exception other than LogError or MapError, a message of more than one line, a limit reached, a signal.
"""

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.attacks import limited, seeds
from benchmarks.attacks.cell import Row
from estimator.map_files import orthophoto, store
from estimator.map_files.extract.footprint import Place
from estimator.map_files.extract.get import get
from estimator.tools.maps import route
from logs.importers import convert
from logs.store.reader import LogError, LogReader
from models.maps.table import MapError
from models.untrusted import toml_text

AREA: Final = "damaged file"
_SEED, _BATCH = 1, 200  # mutants of one child
_COUNTS: Final = (
    b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff" * 8, b"nan", b"[[", b'"x"', b"1e999",
)  # fmt: skip
_VALUES: Final[tuple[Any, ...]] = (
    None, True, 0, -1, 2**31, 2**63, 1e308, -1e308, 1e-320, "", "nan", "x" * 4000, [], {}, [[]], [None], 91.0, 181.0,
)  # fmt: skip
_PLACE: Final = Place(47.4, 8.5, 3000.0)


class Reader(NamedTuple):
    """file: name of the mutants; read(path, folder for results)."""

    file: str
    read: Callable[[Path, Path], object]


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
        parts: list[Any] = [document]
        for part in parts:
            parts += [c for c in (part.values() if isinstance(part, dict) else part) if c and isinstance(c, dict | list)]
        part, other = (parts[int(rng.integers(len(parts)))] for _ in range(2))
        keys = list(part) if isinstance(part, dict) else list(range(len(part)))
        if not keys:
            continue
        key = keys[int(rng.integers(len(keys)))]
        value = json.loads(json.dumps(_VALUES[int(rng.integers(len(_VALUES)))] if rng.random() < 0.8 else other))
        if rng.random() < 0.2:
            del part[key]
        else:
            part[key] = value
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


READERS: Final = {
    "csv": Reader("imu.csv", _imported("csv")),
    "csv.gz": Reader("imu.csv.gz", _imported("csv")),
    "ulog": Reader("a.ulg", _imported("ulog")),
    "dataflash": Reader("a.bin", _imported("dataflash")),
    "tlog": Reader("a.tlog", _imported("tlog")),
    "mcap": Reader("a.mcap", _read_log),
    "bag": Reader("a.bag", _imported("rosbag")),
    "map": Reader("a.geojson", lambda path, _: store.load(path)),
    "extract": Reader("a.geojson", lambda path, _: get(path, _PLACE)),
    "overpass": Reader("a.json", lambda path, _: get(path, _PLACE)),
    "geotiff": Reader("a.tif", lambda path, _: orthophoto.load(path)),
    "route": Reader("a.gpx", lambda path, _: route.read(path)),
    "toml": Reader("a.toml", _toml),
}


def rows(folder: Path, count: int, wanted: Callable[[str, str], bool]) -> Iterator[Row]:
    """One of each format: what became of so many mutants."""
    for name, reader in READERS.items():
        title = f"{name}: {count} mutants"
        if not wanted(AREA, title) or not (files := seeds.of(name)):
            continue
        for data in files:  # what the readers import is there before a child is forked
            reader.read(_written(folder, reader.file, data), folder)
        results = [r for k in range(0, count, _BATCH) for r in _batch(folder, reader, files, range(k, min(count, k + _BATCH)))]
        outcomes = Counter(outcome.partition(":")[0] for _, outcome, _ in results)
        found = [f"seed {_SEED}, mutant {k}: {outcome}" for k, outcome, _ in results if outcome not in {"read", "refused"}]
        worst_s = round(max(cpu_s for *_, cpu_s in results), 2)
        said = ", ".join(f"{n} {outcome}" for outcome, n in sorted(outcomes.items()))
        yield Row(AREA, title, "failed" if found else "held", "; ".join(found[:20]), 0, worst_s, said)


def _batch(folder: Path, reader: Reader, files: list[bytes], numbers: range) -> list[tuple[int, str, float]]:
    """Read in one child; the rest of the batch in another one where it dies."""
    results: list[tuple[int, str, float]] = []
    at = numbers.start
    while at < numbers.stop:
        theirs, ours = os.pipe()
        if (child := os.fork()) == 0:
            os.close(theirs)
            _in_child(ours, folder, reader, files, range(at, numbers.stop))
        os.close(ours)
        with os.fdopen(theirs) as pipe:
            lines = [json.loads(line) for line in pipe]
        _, status = os.waitpid(child, 0)
        results += [(n, outcome, cpu_s) for n, outcome, cpu_s in lines]
        at += len(lines)
        if at < numbers.stop and (status or not lines):
            results.append((at, f"died: status {status}", float(limited.CPU_S)))
            at += 1
    return results


def _in_child(pipe: int, folder: Path, reader: Reader, files: list[bytes], numbers: range) -> None:
    limited.limit_memory()
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    for number in numbers:
        path = _written(folder, reader.file, mutant(files[number % len(files)], np.random.default_rng((_SEED, number))))
        used = time.process_time()
        limited.limit_cpu(limited.CPU_S + 1)
        outcome = _outcome(reader, path, folder)
        cpu_s = time.process_time() - used
        os.write(pipe, (json.dumps([number, "slow" if cpu_s > limited.CPU_S else outcome, cpu_s]) + "\n").encode())
    os._exit(0)


def _written(folder: Path, file: str, data: bytes) -> Path:
    path = folder / "in" / file
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def _outcome(reader: Reader, path: Path, out: Path) -> str:
    try:
        reader.read(path, out)
    except (LogError, MapError) as error:
        return "refused" if "\n" not in str(error) and "fits into memory" not in str(error) else f"wrong message: {error}"
    except BaseException as error:
        return f"uncaught: {type(error).__name__}: {error}"
    return "read"
