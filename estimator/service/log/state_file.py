"""The last state on disk, twice a second: CDR bytes of the Checkpoint, and its clock."""

import contextlib
import os
import stat
import threading
import time
from pathlib import Path
from typing import Final

import msgspec

from estimator.service.base.clock import SECOND_NS, Clock
from estimator.service.log.recovery import FILE_MODE
from logs.wire.codec import encode_input
from models.messages import Checkpoint, Estimate, Health, LastGnss, Mode, Output

_PERIOD_S: Final = 0.5
_FORMAT: Final = 1
_MOST_BYTES: Final = 1_000_000
_LAST_NS: Final = 2**31 * SECOND_NS  # 2038: the wire's seconds have 31 bits
_AHEAD_NS: Final = 86_400 * SECOND_NS
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


class SavedState(msgspec.Struct, frozen=True):
    """config: checksum of the configuration."""

    format: int
    boot: str
    anchor_ns: int
    t_ns: int
    config: str
    checkpoint: bytes


def boot_id() -> str:
    """The machine's boot; empty if unknown."""
    try:
        return _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def load(path: Path, *, wall_ns: int | None = None, steady_ns: int | None = None) -> tuple[SavedState | None, str]:
    """The last daemon's state, or None with the reason; "" without a file."""
    try:
        saved = msgspec.msgpack.decode(_content(path), type=SavedState)
    except FileNotFoundError:
        return None, ""
    except OSError as error:
        return None, (error.strerror or "cannot be read").lower()
    except (ValueError, RecursionError):  # a DecodeError too
        return None, "is no state file, or a damaged one"
    if saved.format != _FORMAT:
        return None, "is of another version"
    wall_ns = time.time_ns() if wall_ns is None else wall_ns
    why = _absurd(saved, wall_ns, time.monotonic_ns() if steady_ns is None else steady_ns)
    return (None, why) if why else (saved, "")


def _content(path: Path) -> bytes:
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:  # noqa: PTH123
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode) or about.st_size > _MOST_BYTES:
            raise ValueError("no state")
        return file.read(_MOST_BYTES)


def _absurd(saved: SavedState, wall_ns: int, steady_ns: int) -> str:
    same_boot = bool(saved.boot) and saved.boot == boot_id()
    now_ns = saved.anchor_ns + steady_ns if same_boot else saved.t_ns
    if not 0 <= saved.t_ns < _LAST_NS or not 0 <= now_ns < _LAST_NS:
        return "its clock is outside 1970 to 2038"
    if same_boot and not 0 <= saved.t_ns - saved.anchor_ns <= steady_ns:
        return "its state is not of this boot's time"
    if now_ns - wall_ns > _AHEAD_NS:
        return "its clock is more than a day ahead of the wall clock"
    return ""


def clock_of(saved: SavedState | None) -> Clock:
    """The last daemon's clock within a boot, or a new one."""
    return Clock(saved.anchor_ns) if saved and saved.boot and saved.boot == boot_id() else Clock()


def usable(saved: SavedState | None, now_ns: int, config: str, oldest_s: float) -> SavedState | None:
    """The state, if young and of this configuration."""
    if saved is None or saved.config != config or not 0 <= now_ns - saved.t_ns <= oldest_s * SECOND_NS:
        return None
    return saved


class StateKeeper:
    """Writes the newest state every half second; problem: why not."""

    def __init__(self, path: Path, clock: Clock, config: str) -> None:
        self._path, self._clock, self._config, self._boot = path, clock, config, boot_id()
        self._newest: Estimate | None = None
        self._last_gnss: LastGnss | None = None
        self.problem = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="state", daemon=True)
        self._thread.start()

    def note(self, output: Output) -> None:
        """Called by the loop."""
        if isinstance(output, Estimate):
            if output.mode is not Mode.ALIGNING_HEADING:  # who goes on from it would be aligned
                self._newest = output
        elif isinstance(output, Health):
            self._last_gnss = output.last_gnss

    def report(self) -> dict[str, str]:
        """For the status."""
        return {"file": self.problem or "kept"}

    def close(self) -> None:
        """Write the last state."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        written: Estimate | None = None
        while True:
            stopping = self._stop.wait(_PERIOD_S)
            newest = self._newest
            if newest is not None and newest is not written:
                self._write(newest)
                written = newest
            if stopping:
                return

    def _write(self, estimate: Estimate) -> None:
        part = self._path.with_name(self._path.name + ".part")
        try:
            data = encode_input(checkpoint_of(estimate, self._last_gnss)).data
            saved = SavedState(_FORMAT, self._boot, self._clock.anchor_ns, estimate.t_ns, self._config, data)
            part.unlink(missing_ok=True)  # of a daemon that was killed; a link in its place is not followed
            with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE), "wb") as file:  # noqa: PTH123
                file.write(msgspec.msgpack.encode(saved))
            part.replace(self._path)
            self.problem = ""
        except Exception as error:  # whatever it is, the next state is tried again
            self.problem = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            with contextlib.suppress(OSError):
                part.unlink()


def checkpoint_of(estimate: Estimate, last_gnss: LastGnss | None) -> Checkpoint:
    """The next daemon's checkpoint."""
    e = estimate
    absolute_ns, counter = e.last_absolute_ns, e.reset_counter
    return Checkpoint(e.t_ns, e.arrived_ns, e.nav, e.covariance, absolute_ns, counter, origin=e.origin, last_gnss=last_gnss)
