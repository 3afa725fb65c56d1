"""Faults of files: each a change of the bytes of one small log, that `landfix import` is then given."""

import gzip
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks.attacks import seeds
from logs.importers import ROSBAG, convert
from logs.store.reader import LogError

Change = Callable[[bytes, np.random.Generator], bytes]


class FileFault(NamedTuple):
    """seed: format of the file; words: one of them names the cause; kind: that import is given, if it is another."""

    seed: str
    file: str
    change: Change
    words: tuple[str, ...]
    kind: str = ""


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    """Its end is missing: a full disk, or a copy that was broken off."""
    return data[: int(rng.uniform(0.4, 0.9) * len(data))]


def _damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A block of noise or zeros in the second half."""
    at, n = int(rng.uniform(0.5, 0.8) * len(data)), int(rng.integers(200, 1500))
    return data[:at] + (rng.bytes(n) if rng.random() < 0.5 else bytes(n)) + data[at + n :]


def _lines(change: Callable[[list[str], np.random.Generator], list[str]]) -> Change:
    return lambda data, rng: "\n".join(change(data.decode().splitlines(), rng)).encode()


def _without_column(lines: list[str], rng: np.random.Generator) -> list[str]:
    k = int(rng.integers(1, 7))
    return [",".join(cell for j, cell in enumerate(line.split(",")) if j != k) for line in lines]


def _words_in_column(lines: list[str], rng: np.random.Generator) -> list[str]:
    k, word = int(rng.integers(1, 7)), str(rng.choice(["nan", "N/A", "-", ""]))
    return lines[:1] + [",".join(word if j == k else cell for j, cell in enumerate(line.split(","))) for line in lines[1:]]


def _short_lines(lines: list[str], rng: np.random.Generator) -> list[str]:
    """Every few lines lack their last cells: two writers of one file."""
    n = int(rng.integers(3, 9))
    return [line if k == 0 or k % n else line[: len(line) // 2].rpartition(",")[0] for k, line in enumerate(lines)]


def _milliseconds(lines: list[str], _: np.random.Generator) -> list[str]:
    """Under a name that says seconds."""
    return lines[:1] + [f"{1e3 * float(line.partition(',')[0]):.0f},{line.partition(',')[2]}" for line in lines[1:]]


def _nanoseconds(lines: list[str], _: np.random.Generator) -> list[str]:
    """Since 1970, under a name that says seconds."""
    return lines[:1] + [f"{1.7e18 + 1e9 * float(line.partition(',')[0]):.0f},{line.partition(',')[2]}" for line in lines[1:]]


def _few_digits(lines: list[str], _: np.random.Generator) -> list[str]:
    """Seconds since 1970 with six digits."""
    return lines[:1] + [f"{1.7e9 + float(line.partition(',')[0]):.6g},{line.partition(',')[2]}" for line in lines[1:]]


_NO_TEXT: Final = ("not a CSV text file",)
_TORN = ("torn", "cut off", "last whole", "without 7 cells", "has no index", "damaged", "is missing", "truncated")
_EMPTY: Final = ("is empty", "seems to be empty")
_OTHER: Final = {
    "ulog": "not a PX4 log", "dataflash": "not an ArduPilot", "tlog": "not a MAVLink", "bag": "cannot be read as a ROS 1 bag",
}  # fmt: skip
_POINTER: Final = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"
_PAGE: Final = b"<!DOCTYPE html>\n<html><head><title>404 Not Found</title></head></html>\n"
_FILES: Final = {"ulog": "a.ulg", "dataflash": "a.bin", "tlog": "a.tlog", "bag": "a.bag"}
FILE_FAULTS: Final[dict[str, FileFault]] = {
    "csv empty": FileFault("csv", "imu.csv", lambda _d, _r: b"", ("is empty",)),
    "csv without header": FileFault("csv", "imu.csv", _lines(lambda lines, _: lines[1:]), ("no header",)),
    "csv header only": FileFault("csv", "imu.csv", _lines(lambda lines, _: lines[:1]), ("no line after the header",)),
    "csv semicolons": FileFault("csv", "imu.csv", lambda d, _: d.replace(b",", b";"), ("separated by",)),
    "csv decimal commas": FileFault("csv", "imu.csv", lambda d, _: d.replace(b",", b";").replace(b".", b","), ("separated by",)),
    "csv utf-16": FileFault("csv", "imu.csv", lambda d, _: d.decode().encode("utf-16"), _NO_TEXT),
    "csv a spreadsheet": FileFault("csv", "imu.csv", lambda _d, r: b"PK\x03\x04" + r.bytes(5000), ("a spreadsheet",)),
    "csv blanks": FileFault("csv", "imu.csv", lambda d, _: d.replace(b",", b" "), ("separated by",)),
    "csv column missing": FileFault("csv", "imu.csv", _lines(_without_column), ("no column for",)),
    "csv words for numbers": FileFault("csv", "imu.csv", _lines(_words_in_column), ("no number in the column",)),
    "csv cut": FileFault("csv", "imu.csv", _cut, _TORN),
    "csv short lines": FileFault("csv", "imu.csv", _lines(_short_lines), ("without 7 cells",)),
    "csv milliseconds": FileFault("csv", "imu.csv", _lines(_milliseconds), ("name the column t_ms",)),
    "csv nanoseconds": FileFault("csv", "imu.csv", _lines(_nanoseconds), ("name the column t_ms, t_us or t_ns",)),
    "ulog named dataflash": FileFault("ulog", "a.bin", lambda d, _: d, ("landfix import ulog",), "dataflash"),
    "bag named ulog": FileFault("bag", "a.ulg", lambda d, _: d, ("landfix import rosbag",), "ulog"),
    "dataflash as text": FileFault("dataflash", "a.bin", lambda _d, _r: b"FMT, 128, 89, FMT, BBnNZ\n" * 50, ("as text",)),
    "csv few digits": FileFault("csv", "imu.csv", _lines(_few_digits), ("write the time with all its digits",)),
    "csv.gz cut": FileFault("csv.gz", "imu.csv.gz", _cut, _TORN),
    "csv.gz damaged": FileFault("csv.gz", "imu.csv.gz", _damaged, (*_TORN, "not a CSV text file", "gzip")),
    "mcap empty": FileFault("mcap", "a.mcap", lambda _d, _r: b"", _EMPTY),
    "mcap cut": FileFault("mcap", "a.mcap", _cut, _TORN),
    "mcap damaged": FileFault("mcap", "a.mcap", _damaged, _TORN),
    "mcap of another program": FileFault("mcap", "a.mcap", lambda _d, r: r.bytes(5000), ("is not an MCAP file",)),
    "ulog damaged": FileFault("ulog", "a.ulg", _damaged, _TORN),
    "dataflash damaged": FileFault("dataflash", "a.bin", _damaged, _TORN),
    "tlog damaged": FileFault("tlog", "a.tlog", _damaged, _TORN),
    "ulog cut": FileFault("ulog", "a.ulg", _cut, _TORN),
    "bag cut": FileFault("bag", "a.bag", _cut, _TORN),
    "bag damaged": FileFault("bag", "a.bag", _damaged, _TORN),
    **{f"{kind} {name}": FileFault(kind, file, change, (words,)) for kind, file in _FILES.items()
       for name, change, words in (("a pointer", lambda _d, _r: _POINTER, "Git LFS pointer"),
                                   ("a web page", lambda _d, _r: _PAGE, "a web page"),
                                   ("packed", lambda d, _: gzip.compress(d), "packed by gzip"))},
    **{f"{kind} empty": FileFault(kind, file, lambda _d, _r: b"", _EMPTY) for kind, file in _FILES.items()},
    **{f"{kind} of another program": FileFault(kind, file, lambda _d, r: r.bytes(5000), (_OTHER[kind],))
       for kind, file in _FILES.items()},
}  # fmt: skip


def said_of(fault: FileFault, rng: np.random.Generator) -> str:
    """The first sentence of `landfix import`: its error, else its first note."""
    found = seeds.of(fault.seed)
    data = found[int(rng.integers(len(found)))]
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "in" / fault.file
        path.parent.mkdir()
        path.write_bytes(fault.change(data, rng))
        kind = fault.kind or {"csv.gz": "csv", "mcap": ROSBAG, "bag": ROSBAG}.get(fault.seed, fault.seed)
        try:
            summary = convert(kind, path.parent if kind == "csv" else path, Path(name) / "out.mcap")
        except LogError as error:
            return str(error).replace(f"{name}/", "")
        return next((text.replace(f"{name}/", "") for text in (*summary.notes, *map(str, summary.findings))), "")
