"""The messages of a bag as CDR, whatever its storage.

    NAME.mcap, a folder of them        ROS 2; by logs.store
    NAME.db3, a folder of them         ROS 2; by rosbags
    NAME.bag, NAME.bag.active          ROS 1; by rosbags, without an index record by record

A folder is one recording, in the order of names.
"""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import apsw
from msgspec.structs import replace
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection

from logs.importers.rosbag import unindexed
from logs.store.reader import LogError, LogReader, Record
from logs.wire.receiver import FLAGS
from logs.wire.schemas import STORE, is_known
from models.untrusted.file import content, opened
from models.untrusted.toml_text import one_line

_STORAGES: Final = (".mcap", ".db3", ".bag")
_SIGNS: Final = {b"\x89MCAP0": ".mcap", b"#ROSBAG V": ".bag"}
_HEAD_BYTES: Final = 16
_ACTIVE: Final = ".active"  # NAME.bag.active: of a recorder that was killed
_COMPRESSED: Final = re.compile(r"^\s*compression_mode:\s*[\"']?(?:file|message)", re.MULTILINE | re.IGNORECASE)
_MOST_METADATA: Final = 500_000  # bytes; YAML is parsed at 50 kB a second
# MemoryError: rosbags asks for as many bytes as a damaged header declares, up to 4 GiB
_FAILURES: Final = (rosbag1.ReaderError, rosbag2.ReaderError, apsw.Error, OSError, ValueError, KeyError, MemoryError)


_IN_CDR: Final = (
    b"\x00\x01\x00\x00"  # and the bytes of ROS 1, for types without strings whose fields lie on multiples of their size
)


class Topic(NamedTuple):
    """A topic with its type; readable: as CDR."""

    name: str
    schema: str
    readable: bool


class Bag:
    """A recording; `notes` reports damage after iteration. Raises LogError."""

    def __init__(self, source: Path) -> None:
        self.files = _files(source)
        self.kind = _kind(self.files[0])
        self.topics: dict[str, Topic] = {}
        self.notes: list[str] = []
        self._done = 0  # files that are through
        self._share = 0.0  # of the one that is read

    @property
    def fraction(self) -> float:
        """Fraction read, 0 to 1."""
        return (self._done + self._share) / len(self.files)

    def messages(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Messages in order; wanted: topics; unknown types are dropped."""
        read = {".mcap": self._mcap, ".db3": self._sqlite, ".bag": self._ros1}[self.kind]
        self.notes = []
        for done, path in enumerate(self.files):
            self._done, self._share = done, 0.0
            for record in read(path):
                if not record.topic.isprintable():
                    record = replace(record, topic=one_line(record.topic))  # noqa: PLW2901
                if wanted is None or record.topic in wanted:
                    yield record
        self._done, self._share = len(self.files), 0.0

    def _note(self, path: Path, why: str) -> None:
        self.notes.append(f"{path.name}: {why}; what stands before was read")

    def _add(self, name: str, schema: str, *, readable: bool) -> bool:
        name = one_line(name)
        self.topics.setdefault(name, Topic(name, schema, readable))
        return readable

    def _mcap(self, path: Path) -> Iterator[Record]:
        with LogReader(path) as reader:
            for record in reader:
                self._share = reader.fraction
                if self._add(record.topic, record.schema, readable=_is_read(record.schema)):
                    yield record
            for name, encoding in reader.foreign.items():
                self._add(name, encoding, readable=False)
            if reader.torn or reader.skipped_chunks:
                self._note(path, "torn" if reader.torn else "damaged in places")

    def _sqlite(self, path: Path) -> Iterator[Record]:
        """A file without metadata.yaml, as of a killed recorder; one that is too large is passed over."""
        try:
            metadata = content(path.with_name("metadata.yaml"), _MOST_METADATA).decode(errors="replace")
        except OSError:
            metadata = ""
        if _COMPRESSED.search(metadata):
            raise LogError(f"{path}: is compressed, as a whole or message by message; convert it first: ros2 bag convert")
        try:
            reader = rosbag2.Reader(path.parent if metadata and len(self.files) == 1 else path)
            reader.open()
        except _FAILURES as error:
            raise _unreadable(path, error) from None
        passed = 0
        try:
            connections = [c for c in reader.connections if self._add(c.topic, c.msgtype, readable=_is_read(c.msgtype))]
            total = max(1, reader.message_count)
            if not connections:
                return
            for passed, (connection, t_ns, data) in enumerate(reader.messages(connections), 1):
                self._share = min(1.0, passed / total)
                yield Record(connection.topic, connection.msgtype, t_ns, bytes(data))
        except _FAILURES as error:
            if not passed:
                raise _unreadable(path, error) from None
            self._note(path, f"damaged ({_words(error)})")
        finally:
            reader.close()

    def _ros1(self, path: Path) -> Iterator[Record]:
        try:
            reader = rosbag1.Reader(path)
            reader.open()
        except _FAILURES as error:
            try:
                yield from self._converted(path, unindexed.messages(path))
            except ValueError:
                raise LogError(f"{path}: cannot be read as a ROS 1 bag: {_words(error)}") from None
            self._note(path, "has no index")
            return
        try:
            _bound(reader, path)
            known = [c for c in reader.connections if self._add(c.topic, c.msgtype, readable=_is_read(c.msgtype))]
            if known:
                yield from self._converted(path, _of(reader, known))
        except _FAILURES as error:
            self._note(path, f"damaged ({_words(error)})")
        finally:
            reader.close()

    def _converted(self, path: Path, messages: Iterator[tuple[str, str, int, bytes, float]]) -> Iterator[Record]:
        """A type that only shares a ROS 2 name is refused."""
        broken: set[str] = set()
        for topic, schema, t_ns, raw, share in messages:
            self._share = share
            if topic in broken or not self._add(topic, schema, readable=_is_read(schema)):
                continue
            try:
                data = bytes(STORE.ros1_to_cdr(raw, schema)) if is_known(schema) else _IN_CDR + raw
            except Exception:  # whatever bytes from outside trip over
                broken.add(topic)
                self.topics[topic] = Topic(topic, schema, readable=False)
                self.notes.append(f"{path.name}: {topic} is no {schema} as ROS 2 has it; left out")
                continue
            yield Record(topic, schema, t_ns, data)


def _is_read(schema: str) -> bool:
    return is_known(schema) or schema in FLAGS.values()


def _bound(reader: rosbag1.Reader, path: Path) -> None:
    unpack = unindexed.Unpacker(path.stat().st_size)
    kinds = {decompressor: kind for kind, decompressor in rosbag1.reader.decompressors.items()}
    for at, chunk in reader.chunks.items():
        reader.chunks[at] = chunk._replace(decompressor=partial(unpack, kinds[chunk.decompressor], chunk=at))


def _of(reader: rosbag1.Reader, known: list[Connection]) -> Iterator[tuple[str, str, int, bytes, float]]:
    total = max(1, reader.message_count)
    for k, (connection, t_ns, raw) in enumerate(reader.messages(known)):
        yield connection.topic, connection.msgtype, t_ns, raw, min(1.0, k / total)


def _unreadable(path: Path, why: Exception) -> LogError:
    remedy = f"; rescue what is whole: sqlite3 {path.name} .recover | sqlite3 whole.db3"
    damaged = remedy if "malformed" in str(why) else ""
    return LogError(f"{path}: cannot be read as a ROS 2 bag ({_words(why)}){damaged}")


def _files(source: Path) -> list[Path]:
    if not source.is_dir():
        if source.suffix not in (*_STORAGES, _ACTIVE):
            raise LogError(f"{source}: is no bag by its name; a bag is NAME.mcap, NAME.db3, NAME.bag or a folder of them")
        return [source]
    for suffix in _STORAGES:
        if found := sorted(source.glob(f"*{suffix}"), key=_natural):
            return found
    if found := sorted(source.glob(f"*.bag{_ACTIVE}"), key=_natural):
        return found
    if packed := [*source.glob("*.zstd")]:
        raise LogError(f"{packed[0]}: unpack it: zstd -d")
    raise LogError(f"{source}: holds no bag (*.mcap, *.db3 or *.bag)")


def _kind(path: Path) -> str:
    """Its storage: by its first bytes, else by its name."""
    with opened(path) as file:
        head = file.read(_HEAD_BYTES)
    named = ".bag" if path.suffix == _ACTIVE else path.suffix
    return next((kind for sign, kind in _SIGNS.items() if head.startswith(sign)), named)


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.stem)]


def _words(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "a record declares more content than there is"
    return " ".join(str(error).split()) or type(error).__name__
