"""A file that a person names: opened without waiting, read to a bound."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from models.untrusted.limits import FILE_BYTES, PIPE_BYTES


def opened(path: Path) -> BufferedReader:
    """Open for reading; a pipe without writer is empty. Raises OSError."""
    return open(path, "rb", opener=_opener)


def content(path: Path, most: int = FILE_BYTES) -> bytes:
    """Content, at most `most` bytes, of a pipe or device PIPE_BYTES. Raises OSError."""
    with opened(path) as file:
        about = os.fstat(file.fileno())
        regular = stat.S_ISREG(about.st_mode)
        most = most if regular else min(most, PIPE_BYTES)
        large = regular and about.st_size > most
        wanted = (about.st_size if regular else most) + 1  # read() takes memory for all that it is asked for
        data = b"" if large else file.read(wanted)
    if large or len(data) > most:
        raise OSError(errno.EFBIG, f"is larger than {most / 1e6:g} MB", str(path))
    return data


def _opener(path: str, flags: int) -> int:
    fd = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    os.set_blocking(fd, True)
    return fd
