"""The last state, kept on disk twice a second, so that a daemon that was killed goes on where it was.

The file holds the CDR bytes of the Checkpoint that the next daemon feeds to Fusion (and logs, so that a replay begins alike), and
the clock it was stamped with: within one boot the next daemon's clock carries the last one's on, whatever the wall clock did.
"""

import contextlib
import threading
from pathlib import Path
from typing import Final

import msgspec

from estimator.service.base.clock import SECOND_NS, Clock
from estimator.service.log.recovery import FILE_MODE
from logs.wire.codec import encode_input
from models.messages import Checkpoint, Estimate, Health, LastGnss, Mode, Output

_PERIOD_S: Final = 0.5
_FORMAT: Final = 1
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


class SavedState(msgspec.Struct, frozen=True):
    """The content of the file; config: checksum of the configuration, for a state of another one is not ours."""

    format: int
    boot: str
    anchor_ns: int
    t_ns: int
    config: str
    checkpoint: bytes


def boot_id() -> str:
    """Which start of the machine this is; empty where the system does not say."""
    try:
        return _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def load(path: Path) -> SavedState | None:
    """The state of the last daemon; None where there is none that can be read."""
    try:
        saved = msgspec.msgpack.decode(path.read_bytes(), type=SavedState)
    except (OSError, msgspec.DecodeError):
        return None
    return saved if saved.format == _FORMAT else None


def clock_of(saved: SavedState | None) -> Clock:
    """The last daemon's clock carried on, within one boot; a new one otherwise."""
    return Clock(saved.anchor_ns) if saved and saved.boot and saved.boot == boot_id() else Clock()


def usable(saved: SavedState | None, now_ns: int, config: str, oldest_s: float) -> SavedState | None:
    """The state, if it is young enough and of this configuration."""
    if saved is None or saved.config != config or not 0 <= now_ns - saved.t_ns <= oldest_s * SECOND_NS:
        return None
    return saved


class StateKeeper:
    """Writes the newest state every half second, on a thread of its own. problem: why it could not, empty if it could."""

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
            part.touch(FILE_MODE)
            part.write_bytes(msgspec.msgpack.encode(saved))
            part.replace(self._path)
            self.problem = ""
        except Exception as error:  # whatever it is, the next state is tried again
            self.problem = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            with contextlib.suppress(OSError):
                part.unlink()


def checkpoint_of(estimate: Estimate, last_gnss: LastGnss | None) -> Checkpoint:
    """What the next daemon begins with."""
    e = estimate
    absolute_ns, counter = e.last_absolute_ns, e.reset_counter
    return Checkpoint(e.t_ns, e.arrived_ns, e.nav, e.covariance, absolute_ns, counter, origin=e.origin, last_gnss=last_gnss)
