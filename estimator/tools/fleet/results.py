"""Results as Parquet: RESULTS/label=NAME/*.parquet in any store."""

import types
from collections.abc import Iterable, Iterator, Sequence
from hashlib import sha256
from pathlib import PurePosixPath
from typing import Any, Final, get_args, get_origin
from urllib.parse import quote, unquote

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.rows import Row
from estimator.tools.fleet.store import open_at

_ROWS_A_FILE: Final = 50_000  # after compaction
_TYPES: Final = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}


def _type(of: Any) -> pa.DataType:
    if isinstance(of, types.UnionType):
        (of,) = (t for t in get_args(of) if t is not types.NoneType)
    if get_origin(of) is dict:
        key, value = get_args(of)
        return pa.map_(_TYPES[key], _TYPES[value])
    return _TYPES[of]


SCHEMA: Final = pa.schema([(f.name, _type(f.type)) for f in msgspec.structs.fields(Row) if f.name != "label"])


class Results:
    """The folder of one label. Raises FleetError."""

    def __init__(self, folder: str, label: str) -> None:
        self._fs, root = open_at(folder)
        self._folder = str(PurePosixPath(root) / f"label={quote(label, safe='')}")
        try:
            self._fs.makedirs(self._folder, exist_ok=True)
        except OSError as error:
            raise FleetError(f"{folder}: cannot be written ({error.strerror or error})") from None

    def keys(self) -> dict[str, str]:
        """Keys of logs with a row."""
        tables = (self._read(file, ["log", "key"]) for file in self._files())
        return {row["log"]: row["key"] for table in tables for row in table.to_pylist()}

    def tables(self) -> Iterator[pa.Table]:
        """The rows, a table a file."""
        return (self._read(file) for file in self._files())

    def add(self, rows: Sequence[Row]) -> None:
        """Write a file with these rows, named by their keys."""
        if rows:
            self._write(_table(rows))

    def compact(self) -> None:
        """Merge small files into files of _ROWS_A_FILE rows."""
        group: list[tuple[str, pa.Table]] = []
        for file in [*self._files(), ""]:
            table = self._read(file) if file else None
            if table is not None and len(table) >= _ROWS_A_FILE:
                continue
            if len(group) > 1 and (table is None or sum(len(t) for _, t in group) + len(table) > _ROWS_A_FILE):
                name = self._write(_once(pa.concat_tables([t for _, t in group])))
                self._remove(f for f, _ in group if PurePosixPath(f).name != name)
                group = []
            if table is not None:
                group.append((file, table))

    def _remove(self, files: Iterable[str]) -> None:
        for file in files:
            self._fs.rm_file(file)

    def _write(self, table: pa.Table) -> str:
        name = sha256("".join(table.column("key").to_pylist()).encode()).hexdigest()[:24] + ".parquet"
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        path = f"{self._folder}/{name}"
        local = "file" in ((self._fs.protocol,) if isinstance(self._fs.protocol, str) else self._fs.protocol)
        draft = f"{self._folder}/.{name}.draft" if local else path  # an object appears whole, a file does not
        try:
            self._fs.pipe_file(draft, sink.getvalue().to_pybytes())
            if local:
                self._fs.mv(draft, path)
        except OSError as error:
            raise FleetError(f"{path}: cannot be written ({error.strerror or error})") from None
        return name

    def _files(self) -> list[str]:
        self._fs.invalidate_cache(self._folder)
        return sorted(self._fs.glob(f"{self._folder}/*.parquet"))

    def _read(self, file: str, columns: Sequence[str] | None = None) -> pa.Table:
        try:
            table: pa.Table = pq.read_table(pa.BufferReader(self._fs.cat_file(file)), columns=columns)
        except (OSError, pa.ArrowException) as error:
            raise FleetError(f"{file}: no row can be read there ({' '.join(str(error).split())[:100]})") from None
        return table


def keep_configuration(folder: str, text: str) -> None:
    """Keep a configuration with the rows, by its sha256."""
    fs, root = open_at(folder)
    fs.makedirs(f"{root.rstrip('/')}/configurations", exist_ok=True)
    fs.pipe_file(f"{root.rstrip('/')}/configurations/{sha256(text.encode()).hexdigest()}.toml", text.encode())


def configuration(folder: str, digest: str) -> str | None:
    """Configuration of that sha256; None: each log's own."""
    fs, root = open_at(folder)
    try:
        text: str = fs.cat_file(f"{root.rstrip('/')}/configurations/{digest}.toml").decode()
    except FileNotFoundError:
        return None
    return text


def read(folder: str, labels: Iterable[str] = ()) -> pa.Table:
    """Rows of these labels (none: all) with the column label. Raises FleetError without any."""
    fs, root = open_at(folder)
    found = sorted(unquote(PurePosixPath(p).name.partition("=")[2]) for p in fs.glob(f"{root.rstrip('/')}/label=*"))
    labels = list(labels) or found
    if missing := [label for label in labels if label not in found]:
        raise FleetError(f"{folder}: no label {missing[0]}; there are {', '.join(found) or 'none'}")
    tables = []
    for label in labels:
        results = Results(folder, label)
        tables += [table.append_column("label", pa.array([label] * len(table), pa.string())) for table in results.tables()]
    if not tables:
        raise FleetError(f"{folder}: holds no rows; make them first: landfix fleet run LOGS -o {folder}")
    return _once(pa.concat_tables(tables, promote_options="default"))


def _once(table: pa.Table) -> pa.Table:
    names = [name for name in ("label", "log", "key") if name in table.column_names]
    table = table.sort_by([(name, "ascending") for name in names])
    keys = list(zip(*(table.column(name).to_pylist() for name in names), strict=True))
    return table.take([k for k in range(len(keys)) if k == 0 or keys[k] != keys[k - 1]])


def _table(rows: Sequence[Row]) -> pa.Table:
    columns = {
        field.name: [list(v.items()) if isinstance(v := getattr(row, field.name), dict) else v for row in rows]
        for field in SCHEMA
    }
    return pa.table(columns, SCHEMA)
