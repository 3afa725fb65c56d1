"""Writing a log: MCAP, LZ4, profile ros2; a kill loses 0.1 s at most."""

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from mcap.records import Schema

from logs.store.mcap_writer import McapWriter
from logs.store.records import LogError
from logs.wire.schemas import COMPRESSED_IMAGE, IMAGE, is_known, schema_text, type_hash

METADATA_NAME: Final = "landfix"
CONFIG_ATTACHMENT: Final = "config.toml"  # what the estimator was configured with
FINDINGS_ATTACHMENT = "findings/findings.json"  # streams at fault, as a replay found them
REFERENCE_ATTACHMENT: Final = "reference.txt"  # says what /truth is where it is no ground truth
FLUSH_NS: Final = 100_000_000  # of log time
CHUNK_BYTES: Final = 64 * 1024
_ALONE: Final = frozenset({IMAGE, COMPRESSED_IMAGE})
_FAILURES: Final = (OSError, ValueError)  # disk full; file closed

_QOS: Final = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""  # as rosbag2 writes it; `ros2 bag play` offers the topic with it


class Recorder:
    """Writes messages. Equal calls write equal bytes. Raises LogError.

    metadata: of the record `landfix`; schemas: other types. An image has its own chunk; a chunk spans less than 0.1 s of log
    time.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        metadata: Mapping[str, str] | None = None,
        schemas: Mapping[str, Schema] | None = None,
        new_mode: int | None = None,
    ) -> None:
        """new_mode: the file must not exist, not even as a link, and gets this mode."""
        self.path = Path(path)
        self._on_disk = 0  # bytes
        self.truncated = False
        self._schemas = schemas or {}
        self._channels: dict[tuple[str, str], int] = {}
        self._schema_ids: dict[str, int] = {}
        self._chunk_start_ns: int | None = None
        try:
            self._file = (
                self.path.open("wb")
                if new_mode is None
                else open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, new_mode), "wb")  # noqa: PTH123, SIM115
            )
        except FileExistsError:
            raise FileExistsError(f"{path}: is there already") from None
        except OSError as error:
            raise LogError(f"{path}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None
        self._writer = McapWriter(self._file, CHUNK_BYTES)
        try:
            with self._one_line():
                self._writer.start(profile="ros2", library="landfix")
                self._writer.add_metadata(METADATA_NAME, metadata or {})
                self._file.flush()
        except LogError:
            with suppress(OSError):  # closing tries to write once more
                self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def write(self, topic: str, schema: str, data: bytes, log_time_ns: int) -> None:
        """Add a CDR message of the type `schema`."""
        if log_time_ns < 0:
            raise LogError(f"{self.path}: a log time before 1970 ({log_time_ns} ns, {topic}) cannot be written")
        start = self._chunk_start_ns
        try:
            alone = schema in _ALONE
            if start is None or alone or not -FLUSH_NS < log_time_ns - start < FLUSH_NS:
                self._hand_over()
                self._chunk_start_ns = log_time_ns
            channel = self._channels.get((topic, schema)) or self._channel(topic, schema)
            self._writer.add_message(channel, log_time_ns, data, log_time_ns)
            if alone:
                self._hand_over()
                self._chunk_start_ns = None
        except _FAILURES as error:
            raise self._error(error) from None

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file (configuration, calibration, map) in the log."""
        with self._one_line():
            self._writer.add_attachment(0, 0, name, media_type, data)
        self.flush()

    def flush(self) -> None:
        """Hand all to the operating system."""
        with self._one_line():
            self._hand_over()
        self._chunk_start_ns = None

    def _hand_over(self) -> None:
        """Raises OSError where another program has shortened the file."""
        if os.fstat(self._file.fileno()).st_size < self._on_disk:
            self.truncated = True
            raise OSError(errno.ESTALE, "another program has shortened it")
        self._writer.flush()
        self._file.flush()
        self._on_disk = self._file.tell()

    @property
    def is_in_place(self) -> bool:
        """Whether the path still leads to the written file."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except OSError:
            return False

    def close(self) -> None:
        """Write index and statistics, and close the file. Again: nothing."""
        if not self._file.closed:
            with self._one_line(), self._file:
                self._writer.finish()

    def _channel(self, topic: str, schema: str) -> int:
        encoding, text, metadata = "ros2msg", b"", {"offered_qos_profiles": _QOS}
        if is_known(schema):
            text, metadata["topic_type_hash"] = schema_text(schema).encode(), type_hash(schema)
        elif foreign := self._schemas.get(schema):
            encoding, text = foreign.encoding, foreign.data
        else:
            raise LogError(f"{self.path}: no definition of the type {schema} on {topic} is known, so it cannot be logged")
        if schema not in self._schema_ids:
            self._schema_ids[schema] = self._writer.register_schema(schema, encoding, text)
        channel = self._writer.register_channel(topic, "cdr", self._schema_ids[schema], metadata)
        self._channels[topic, schema] = channel
        return channel

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        try:
            yield
        except _FAILURES as error:
            raise self._error(error) from None

    def _error(self, error: Exception) -> LogError:
        detail = (error.strerror or "unknown error").lower() if isinstance(error, OSError) else str(error)
        return LogError(f"{self.path}: cannot be written ({detail})")
