"""The folder of the logs, locked by one daemon; torn logs of a killed one are repaired during the flight."""

import fcntl
import subprocess
import sys
from pathlib import Path
from typing import IO, Final

from mcap.writer import MCAP0_MAGIC as MAGIC

FILE_MODE, FOLDER_MODE = 0o640, 0o750  # of what the daemon creates: where it flew is not for everybody; a stricter umask stays
_SCRIPT: Final = """\
import fcntl, os, sys
os.nice(19)
os.umask(0o027 | os.umask(0o027))
from pathlib import Path
from estimator.service.log.recovery import is_torn
from logs.store.recover import recover
alone = open(sys.argv[1], "w")
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


def claim(folder: Path) -> IO[str]:
    """Make the folder ours for as long as the file that is returned stays open. Raises FolderError when it is another's."""
    try:
        folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
        (folder / "landfix.lock").touch(FILE_MODE)
        lock = (folder / "landfix.lock").open("w")
    except OSError as error:
        raise FolderError(f"[log] {folder}: {(error.strerror or 'cannot be used').lower()}") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise FolderError(f"[log] {folder}: another landfix records there; give each its own folder") from None
    return lock


def torn_logs(folder: Path) -> list[Path]:
    """The logs in a folder that lack their proper end, oldest first."""
    return [path for path in sorted(folder.glob("landfix-*.mcap")) if is_torn(path)]


def recover_in_background(folder: Path) -> subprocess.Popen[bytes] | None:
    """A process of lowest priority that repairs them, or None; a damaged torn log is kept beside the repaired one."""
    torn = torn_logs(folder)
    if not torn:
        return None
    words = [str(folder / "landfix.recovery.lock"), *map(str, torn)]
    return subprocess.Popen([sys.executable, "-c", _SCRIPT, *words], stdin=subprocess.DEVNULL)


def is_torn(path: Path) -> bool:
    """Whether an MCAP file lacks its proper end."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - len(MAGIC)))
            return size <= len(MAGIC) or file.read() != MAGIC
    except OSError:
        return False
