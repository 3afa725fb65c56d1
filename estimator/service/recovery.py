"""Logs that a killed daemon left torn are made whole, beside the flight and never in its way."""

import subprocess
import sys
from pathlib import Path
from typing import Final

from mcap.writer import MCAP0_MAGIC as MAGIC

_SCRIPT: Final = """\
import os, sys
os.nice(19)
from pathlib import Path
from logs.recover import recover
for name in sys.argv[1:]:
    torn, whole = Path(name), Path(name).with_suffix(".recovered")
    try:
        if recover(torn, whole).chunks_lost == 0:
            whole.replace(torn)
        else:
            whole.rename(torn.with_suffix(".recovered.mcap"))
    except Exception as error:
        print(f"{name}: {error}", file=sys.stderr)
"""


def torn_logs(folder: Path) -> list[Path]:
    """The logs in a folder that lack their proper end, oldest first."""
    return [path for path in sorted(folder.glob("landfix-*.mcap")) if _is_torn(path)]


def recover_in_background(folder: Path) -> subprocess.Popen[bytes] | None:
    """A process of lowest priority that makes them whole; None where there is nothing to do.

    A whole log takes the torn one's place; where a part is damaged beyond that, both are kept.
    """
    torn = torn_logs(folder)
    if not torn:
        return None
    return subprocess.Popen([sys.executable, "-c", _SCRIPT, *map(str, torn)], stdin=subprocess.DEVNULL)


def _is_torn(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - len(MAGIC)))
            return size <= len(MAGIC) or file.read() != MAGIC
    except OSError:
        return False
