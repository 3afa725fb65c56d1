"""The folder of the logs, locked by one daemon; torn logs are repaired during the flight."""

import fcntl
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Final, Self

from mcap.writer import MCAP0_MAGIC as MAGIC

FILE_MODE, FOLDER_MODE = 0o640, 0o750  # of what the daemon creates: where it flew is not for everybody; a stricter umask stays
_SCRIPT: Final = """\
import fcntl, os, sys
os.setpriority(os.PRIO_PROCESS, 0, 19)
os.umask(0o027 | os.umask(0o027))
from pathlib import Path
from estimator.service.log.recovery import is_torn
from logs.store.recover import recover
alone = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o640)
fcntl.flock(alone, fcntl.LOCK_EX)  # an earlier recovery may still be at it
for name in sys.argv[2:]:
    torn, whole = Path(name), Path(name).with_suffix(".recovered")
    try:
        if is_torn(torn):
            lost = recover(torn, whole).chunks_lost
            whole.replace(torn if lost == 0 else torn.with_suffix(".recovered.mcap"))
    except Exception as error:
        print(f"landfix: {name}: {error}", file=sys.stderr)
"""


class FolderError(Exception):
    """The folder cannot be used; one line for the user."""


class FolderLock:
    """The folder is ours while we hold its lock."""

    def __init__(self, folder: Path) -> None:
        self.path, self._fd = folder / "landfix.lock", -1
        self.hold()

    def hold(self) -> None:
        """Lock anew after deletion or replacement. Raises FolderError."""
        if self._fd >= 0 and self._is_in_place():
            return
        self.close()
        folder = self.path.parent
        try:
            folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
            self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, FILE_MODE)
        except OSError as error:
            raise FolderError(f"[log] {folder}: {(error.strerror or 'cannot be used').lower()}") from None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise FolderError(f"[log] {folder}: another landfix records there; give each its own folder") from None

    def close(self) -> None:
        """Let it go."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _is_in_place(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._fd), self.path.lstat())
        except OSError:
            return False


def torn_logs(folder: Path) -> list[Path]:
    """Torn logs, oldest first."""
    return [path for path in sorted(folder.glob("landfix-*.mcap")) if is_torn(path)]


def recover_in_background(folder: Path) -> subprocess.Popen[bytes] | None:
    """Repair at lowest priority, or None; the damaged log stays."""
    torn = torn_logs(folder)
    if not torn:
        return None
    words = [str(folder / "landfix.recovery.lock"), *map(str, torn)]
    return subprocess.Popen([sys.executable, "-c", _SCRIPT, *words], stdin=subprocess.DEVNULL)


def is_torn(path: Path) -> bool:
    """An MCAP file (no link) without proper end."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return False
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - len(MAGIC)))
            return size <= len(MAGIC) or file.read() != MAGIC
    except OSError:
        return False
