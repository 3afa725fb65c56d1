"""Parts of a rotated log read as one flight."""

import re
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Self

from mcap.records import Schema

from logs.store.reader import Attachment, LogError, LogReader, Record
from logs.store.recorder import METADATA_NAME

PART: Final = "part"  # key of the metadata record: the number of the file, from 0 on
_NUMBERED: Final = re.compile(r"(.*)-\d{3,}\.mcap")  # as landfix run names them
_FEW: Final = 5  # are named one by one
_RECOVERED: Final = ".recovered"  # before the suffix: what recovery could save of a damaged part, next to it


class PartsReader:
    """A LogReader of all parts in order of recording.

    source: a file, a folder of one flight's parts, or files. Complete after iteration. Raises LogError.
    """

    def __init__(self, source: Path | Sequence[Path]) -> None:
        with ExitStack() as stack:
            opened = [(path, stack.enter_context(LogReader(path))) for path in _without_copies(files_of(source))]
            begins = {path: next((r.log_time_ns for r in reader), 0) for path, reader in opened} if len(opened) > 1 else {}
            opened.sort(key=lambda part: begins.get(part[0], 0))
            self._names, self._parts = [path.name for path, _ in opened], [reader for _, reader in opened]
            _refuse_twins({path: _number(reader) for path, reader in opened})
            self._files = stack.pop_all()
        self._sizes = [path.stat().st_size for path, _ in opened]
        self._current = 0
        self.schemas: Mapping[str, Schema] = ChainMap(*(part.schemas for part in self._parts))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def __iter__(self) -> Iterator[Record]:
        for k, part in enumerate(self._parts):
            self._current = k
            yield from part

    @property
    def torn(self) -> list[str]:
        """Names of parts without proper end."""
        return [name for name, part in zip(self._names, self._parts, strict=True) if part.torn]

    @property
    def skipped_chunks(self) -> int:
        """Damaged places, each at least one chunk."""
        return sum(part.skipped_chunks for part in self._parts)

    @property
    def fraction(self) -> float:
        """Fraction read of all files, 0 to 1."""
        read = sum(self._sizes[: self._current]) + self._parts[self._current].fraction * self._sizes[self._current]
        return read / sum(self._sizes)

    @property
    def attachments(self) -> list[Attachment]:
        """Attachments in order, duplicates once."""
        return list(dict.fromkeys(a for part in self._parts for a in part.attachments))

    @property
    def imported_as(self) -> str:
        """Importer kind (ulog, dataflash ...), or empty."""
        return self._parts[0].metadata.get(METADATA_NAME, {}).get("import_kind", "")

    @property
    def missing(self) -> str:
        """Missing parts, as "part 0", "parts 1, 2"; "": none known."""
        there = {number for part in self._parts if (number := _number(part)) is not None}
        missing = [k for k in range(max(there, default=0)) if k not in there]
        if len(missing) > _FEW:
            return f"{len(missing)} of the parts {missing[0]} to {missing[-1]}"
        return ("part " if len(missing) == 1 else "parts ") + ", ".join(map(str, missing)) if missing else ""


def files_of(source: Path | Sequence[Path]) -> list[Path]:
    """Files named, or of the folder's flight. Raises LogError for none or several flights."""
    if not isinstance(source, Path):
        return list(source)
    if not source.is_dir():
        return [source]
    flights: dict[str, list[Path]] = {}
    for path in sorted(source.glob("*.mcap")):
        if (flight := flight_of(path.name)) != path.name:
            flights.setdefault(flight, []).append(path)
    if not flights:
        raise LogError(f"{source}: holds no parts of a flight (NAME-000.mcap, NAME-001.mcap ...)")
    if len(flights) > 1:
        raise LogError(f"{source}: holds {len(flights)} flights ({', '.join(flights)}); name the files of one")
    return next(iter(flights.values()))


def flight_of(name: str) -> str:
    """Flight of a part's name (NAME of NAME-000.mcap), else the name."""
    numbered = _NUMBERED.fullmatch(name)
    return numbered[1] if numbered else name


def _without_copies(files: Sequence[Path]) -> list[Path]:
    return [f for f in files if not (f.stem.endswith(_RECOVERED) and f.with_stem(f.stem.removesuffix(_RECOVERED)) in files)]


def _number(part: LogReader) -> int | None:
    number = part.metadata.get(METADATA_NAME, {}).get(PART, "")
    return int(number) if number.isdecimal() else None


def _refuse_twins(numbers: Mapping[Path, int | None]) -> None:
    seen: dict[int, Path] = {}
    for path, number in numbers.items():
        if number is None:
            continue
        if number in seen:
            raise LogError(f"{seen[number]} and {path}: are both part {number}, so of two flights; name the parts of one")
        seen[number] = path
