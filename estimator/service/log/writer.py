"""The log's thread: flushes every 50 ms (kill -9 loses < 0.1 s), rotates files.

A slow disk loses outputs first, then images, inputs last.
"""

import contextlib
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
from msgspec import Meta

from estimator.service.base.ports import Arrival
from estimator.service.log.recovery import FILE_MODE, FOLDER_MODE, FolderError
from logs.store.reader import Attachment, LogError
from logs.store.recorder import Recorder
from logs.wire.codec import Encoded
from logs.wire.schemas import is_known

_WAKE_S: Final = 0.025
_FLUSH_S: Final = 0.05
_RETRY_S: Final = 2.0
_STALL_S: Final = 1.5  # seen in a status of every second, within 2 s or so
_SPACE_EVERY_S: Final = 1.0
_MB: Final = 1_000_000
_IMAGES_LIMIT, _OUTPUTS_LIMIT, _INPUTS_LIMIT = 64 * _MB, 32 * _MB, 256 * _MB  # bytes that wait for the disk


class LogConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[log]: the flight recorder."""

    enabled: Annotated[bool, Meta(description="whether anything is recorded")] = True
    folder: Annotated[
        str, Meta(pattern=r"^[^$]*$", description="where logs are written, relative to the working directory; no $VARIABLE")
    ] = "logs"
    rotate_mb: Annotated[
        float, Meta(ge=1e-3, le=1e9, description="MB: a file that has grown so large is followed by another")
    ] = 4000.0
    rotate_min: Annotated[float, Meta(ge=1e-3, le=1e6, description="min: a file that is so old is followed by another")] = 120.0
    keep_gb: Annotated[float, Meta(ge=0, le=1e6, description="GB: oldest logs beyond this are deleted; 0: none ever is")] = 0.0
    least_free_mb: Annotated[
        float, Meta(ge=0, le=1e9, description="MB: with less free the log pauses, for the sake of the system")
    ] = 200.0
    sync_s: Annotated[
        float, Meta(ge=0, le=1e6, description="s: between writes that outlive a power cut; 0: left to the system")
    ] = 5.0
    images: Annotated[bool, Meta(description="whether images are recorded")] = True


class LogState(NamedTuple):
    """How the log is doing. lost_inputs must be 0."""

    state: str  # recording, waiting for space, failed, off
    file: str
    bytes_written: int
    waiting_bytes: int
    lost_inputs: int
    dropped_outputs: int
    dropped_images: int
    removed_files: int  # deleted, moved, replaced or shortened by somebody while they were written
    stalls: int  # times that the thread stood still for more than 2 s


class _Item(NamedTuple):
    topic: str
    schema: str
    data: bytes
    log_time_ns: int


class LogWriter:
    """A Log. name(n): path of file n; attachments, metadata: in every file."""

    def __init__(
        self,
        config: LogConfig,
        name: Callable[[int], Path],
        metadata: Mapping[str, str],
        attachments: Sequence[Attachment] = (),
        hold: Callable[[], None] = lambda: None,
    ) -> None:
        self._config, self._name, self._metadata, self._attachments = config, name, dict(metadata), attachments
        self._hold, self._shared = hold, ""
        self._queue: deque[_Item] = deque()
        self._images: deque[_Item] = deque()
        self._put_bytes = self._taken_bytes = 0  # each is changed by one thread only
        self._image_lock, self._image_bytes, self._taken_image_bytes = threading.Lock(), 0, 0
        self._lost_inputs = self._dropped_outputs = self._dropped_images = 0
        self._removed_files = 0
        self.files: list[Path] = []  # begun so far
        self._unflushed: list[_Item] = []  # written, but not yet safe: a full disk tears it off
        self._state, self._problem = "recording", ""
        self._recorder: Recorder | None = None
        self._number = self._written = self._file_bytes = 0
        self._taken = 0  # names that were there already
        self._beat_s, self._stalls = time.monotonic(), 0
        self._opened_s = self._retry_s = self._space_s = self._sync_s = self._flush_s = 0.0
        self._syncing: threading.Thread | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    # --- called by the loop and the links -----------------------------------------------------------------------------------

    def put_input(self, arrival: Arrival) -> None:
        """Keep an input."""
        if self.waiting_bytes > _INPUTS_LIMIT or not is_known(arrival.schema):
            self._lost_inputs += 1
            return
        self._put_bytes += len(arrival.data)
        self._queue.append(_Item(*arrival[:4]))

    def put_output(self, encoded: Encoded, log_time_ns: int) -> None:
        """Keep an output."""
        if self.waiting_bytes > _OUTPUTS_LIMIT:
            self._dropped_outputs += 1
            return
        self._put_bytes += len(encoded.data)
        self._queue.append(_Item(*encoded, log_time_ns))

    def put_image(self, arrival: Arrival) -> None:
        """Keep an image; the oldest make room."""
        if not self._config.images or not is_known(arrival.schema):
            return
        with self._image_lock:
            self._image_bytes += len(arrival.data)
            self._images.append(_Item(*arrival[:4]))
            while self._images and self._image_bytes - self._taken_image_bytes > _IMAGES_LIMIT:
                self._image_bytes -= len(self._images.popleft().data)
                self._dropped_images += 1

    @property
    def waiting_bytes(self) -> int:
        """Bytes waiting for the disk, without images."""
        return self._put_bytes - self._taken_bytes

    @property
    def state(self) -> LogState:
        """State of the log for the status."""
        file = str(self._recorder.path) if self._recorder else ""
        problem = self._problem or self._shared
        state = f"{self._state}: {problem}" if problem else self._state
        stalled_s = time.monotonic() - self._beat_s if self._thread.is_alive() else 0.0
        if stalled_s > _STALL_S:
            state = f"stalled: the disk has taken nothing for {stalled_s:.0f} s"
        drops = self._lost_inputs, self._dropped_outputs, self._dropped_images, self._removed_files
        return LogState(state, file, self._written, self.waiting_bytes, *drops, self._stalls + (stalled_s > _STALL_S))

    def report(self) -> dict[str, Any]:
        """For the status."""
        return self.state._asdict()

    def close(self, timeout_s: float = 10.0) -> None:
        """Write the queue and complete the file."""
        self._stop.set()
        self._thread.join(timeout_s)
        if self._thread.is_alive():  # what still waits will not be written
            self._lost_inputs += len(self._queue)

    def _beat(self) -> None:
        now_s = time.monotonic()
        self._stalls += now_s - self._beat_s > _STALL_S
        self._beat_s = now_s

    # --- the thread -----------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.wait(_WAKE_S):
            self._beat()
            self._turn(time.monotonic())
            self._beat()
        self._retry_s = 0.0  # what waits for a disk gets a last chance
        self._turn(time.monotonic())
        self._end_file()
        self._beat()

    def _turn(self, now_s: float) -> None:
        try:
            if self._recorder is None and now_s >= self._retry_s:
                self._begin_file(now_s)
            if self._recorder is not None:
                self._drain(self._recorder)
                if now_s - self._flush_s >= _FLUSH_S or self._stop.is_set():
                    self._flush(self._recorder, now_s)
                self._look_after(self._recorder, now_s)
        except FileExistsError as error:  # the next name at once
            self._fail(str(error), now_s - _RETRY_S)
        except Exception as error:  # LogError, OSError of a folder that is gone; whatever it is, this thread goes on
            self._fail(str(error), now_s)

    def _drain(self, recorder: Recorder) -> None:
        for _ in range(len(self._queue)):
            item = self._queue.popleft()
            self._beat()
            self._unflushed.append(item)
            self._taken_bytes += len(item.data)
            recorder.write(*item)
            self._count(item)
        while True:
            with self._image_lock:
                if not self._images:
                    return
                image = self._images.popleft()
                self._taken_image_bytes += len(image.data)
            recorder.write(*image)
            self._count(image)

    def _flush(self, recorder: Recorder, now_s: float) -> None:
        recorder.flush()
        self._unflushed.clear()
        self._flush_s = now_s

    def _count(self, item: _Item) -> None:
        self._file_bytes += len(item.data)
        self._written += len(item.data)

    def _look_after(self, recorder: Recorder, now_s: float) -> None:
        config = self._config
        if config.sync_s and now_s - self._sync_s >= config.sync_s and not (self._syncing and self._syncing.is_alive()):
            self._sync_s = now_s
            self._syncing = threading.Thread(target=_sync, args=(recorder.path,), name="sync", daemon=True)
            self._syncing.start()  # a card may take seconds, and kill -9 would cost what waits meanwhile
        if now_s - self._space_s < _SPACE_EVERY_S:
            return
        self._space_s = now_s
        self._hold_folder()
        if not recorder.is_in_place:
            self._removed_files += 1
            self._end_file()
            self._begin_file(now_s)
            return
        if _free_mb(recorder.path.parent) < config.least_free_mb:
            self._flush(recorder, now_s)
            self._end_file()
            self._pause(now_s)
        elif self._file_bytes > config.rotate_mb * _MB or now_s - self._opened_s > config.rotate_min * 60.0:
            self._flush(recorder, now_s)
            self._end_file()
            self._begin_file(now_s)

    def _begin_file(self, now_s: float) -> None:
        path = self._name(self._number + self._taken)
        path.parent.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
        self._hold_folder()
        self._thin_out(path.parent)
        if _free_mb(path.parent) < self._config.least_free_mb:
            self._pause(now_s)
            return
        try:
            recorder = Recorder(path, metadata=self._metadata | {"part": str(self._number)}, new_mode=FILE_MODE)
        except FileExistsError:  # another's, or a link: it stays as it is
            self._taken += 1
            raise
        self.files.append(path)
        self._recorder = recorder
        for attachment in self._attachments:
            self._recorder.attach(attachment.name, attachment.media_type, attachment.data)
        self._number, self._file_bytes = self._number + 1, 0
        self._opened_s = self._sync_s = now_s
        self._state, self._problem = "recording", ""

    def _hold_folder(self) -> None:
        self._shared = ""
        try:
            self._hold()
        except FolderError as error:
            self._shared = str(error)

    def _end_file(self) -> None:
        """Write index and end; without room the file is torn, all flushed messages kept."""
        if self._recorder is not None:
            with contextlib.suppress(LogError):
                self._recorder.close()
            self._recorder = None

    def _pause(self, now_s: float) -> None:
        least = self._config.least_free_mb
        self._state, self._problem, self._retry_s = "waiting for space", f"less than {least:g} MB free", now_s + _RETRY_S

    def _fail(self, problem: str, now_s: float) -> None:
        removed = self._recorder is not None and (self._recorder.truncated or not self._recorder.is_in_place)
        self._removed_files += removed
        self._end_file()
        self._queue.extendleft(reversed(self._unflushed))
        self._taken_bytes -= sum(len(item.data) for item in self._unflushed)
        self._unflushed.clear()
        self._state, self._problem, self._retry_s = "failed", problem, now_s + _RETRY_S

    def _thin_out(self, folder: Path) -> None:
        if not self._config.keep_gb:
            return
        logs = sorted(folder.glob("landfix-*.mcap"), key=lambda p: p.name, reverse=True)
        total = 0
        for log in logs:
            total += log.lstat().st_size
            if total > self._config.keep_gb * 1e9:
                log.unlink(missing_ok=True)


def _free_mb(folder: Path) -> float:
    return shutil.disk_usage(folder).free / _MB


def _sync(path: Path) -> None:
    with contextlib.suppress(OSError):
        fd = os.open(path, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
