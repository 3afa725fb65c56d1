"""Logs at fsspec addresses, parts grouped into flights."""

from collections.abc import Iterable, Sequence
from glob import has_magic
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import Any, Final

import fsspec
import msgspec
from fsspec.core import url_to_fs

from estimator.tools.fleet.errors import FleetError
from logs.store.parts import flight_of

_LISTS: Final = (".txt", ".lst")
_STATE: Final = (  # the first that a store lists, a digest of the content before a time
    "ETag", "etag", "md5", "md5Hash", "content_md5", "mtime", "LastModified", "last_modified",
)  # fmt: skip


class Flight(msgspec.Struct, frozen=True):
    """One flight; parts: addresses; state: size and version of each."""

    log: str
    parts: tuple[str, ...]
    stored_bytes: int
    state: str


def flights(sources: Sequence[str]) -> list[Flight]:
    """Flights of addresses, globs and lists (.txt), by name. Raises FleetError."""
    files: dict[str, dict[str, Any]] = {}
    for source in sources:
        for address in _lines(source) if source.endswith(_LISTS) else [source]:
            files.update(_found(address))
    groups: dict[str, list[str]] = {}
    for address in sorted(files):
        folder, _, name = address.rpartition("/")
        groups.setdefault(f"{folder}/{flight_of(name)}" if folder else flight_of(name), []).append(address)
    return [_flight(log, parts, files) for log, parts in sorted(groups.items())]


def open_at(address: str) -> tuple[fsspec.AbstractFileSystem, str]:
    """File system and path of an address. Raises FleetError where its package is missing."""
    try:
        fs, path = url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise FleetError(f"{address}: {' '.join(str(error).split())[:150]}") from None
    return fs, path


def is_stored(address: str) -> bool:
    """Whether an address is in a store, not a local path."""
    return "://" in address


def local_path(address: str) -> Path:
    """Local file of a log, or fsspec's copy. Raises FleetError."""
    if not is_stored(address):
        return Path(address)
    try:
        return Path(fsspec.open_local(f"simplecache::{address}"))
    except (OSError, ImportError, ValueError) as error:
        raise FleetError(f"{address}: cannot be read ({' '.join(str(error).split())[:100]})") from None


def _lines(source: str) -> Iterable[str]:
    fs, path = open_at(source)
    try:
        text = fs.cat_file(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise FleetError(f"{source}: no list of logs can be read there ({error})") from None
    return [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]


def _found(address: str) -> dict[str, dict[str, Any]]:
    fs, path = open_at(address)
    local = fs.protocol == "file" or "file" in fs.protocol
    try:
        found = fs.glob(path, detail=True) if has_magic(path) else {path: fs.info(path)}
    except (OSError, ValueError) as error:
        raise FleetError(f"{address}: {error.strerror if isinstance(error, OSError) and error.strerror else error}") from None
    named = {name if local else fs.unstrip_protocol(name): info for name, info in found.items() if info["type"] == "file"}
    if not named:
        raise FleetError(f"{address}: no log there; give files or a glob, as {address.rstrip('/')}/*.mcap")
    return named


def _flight(log: str, parts: list[str], files: dict[str, dict[str, Any]]) -> Flight:
    infos = [files[part] for part in parts]
    states = [
        (PurePosixPath(p).name, i.get("size"), next((str(i[k]) for k in _STATE if k in i), ""))
        for p, i in zip(parts, infos, strict=True)
    ]
    return Flight(log, tuple(parts), sum(i.get("size") or 0 for i in infos), sha256(repr(states).encode()).hexdigest())
