"""A gzip file as a stream: bounded, read as far as it goes."""

import io
import zlib
from pathlib import Path
from typing import Final

from models.untrusted.file import opened
from models.untrusted.limits import TEXT_BYTES, TEXT_RATIO, TooLargeError, allowed

_STEP: Final = 64 * 1024  # bytes


class GzipFile(io.RawIOBase):
    """Content of all members; torn: end missing or damaged. Raises ValueError, TooLargeError, OSError."""

    def __init__(self, path: Path) -> None:
        self._file = opened(path)
        self._packed, self._read, self._given = b"", 0, 0
        self._unpack = zlib.decompressobj(wbits=31)
        self._whole = True  # between two members
        self.torn = False

    def readable(self) -> bool:
        """Always."""
        return True

    def close(self) -> None:
        """The file too."""
        self._file.close()
        super().close()

    def readinto(self, buffer: "memoryview") -> int:  # type: ignore[override]
        """The next bytes; 0 at the end."""
        while not self.torn:
            if not self._packed:
                self._packed = self._file.read(_STEP)
                self._read += len(self._packed)
                if not self._packed:
                    self.torn = not self._whole
                    break
            content = self._next(len(buffer))
            if content:
                self._given += len(content)
                if self._given > min(TEXT_BYTES, allowed(self._read, TEXT_RATIO)):
                    raise TooLargeError(f"{self._read} bytes hold more than {self._given >> 20} MiB: no text is packed so small")
                buffer[: len(content)] = content
                return len(content)
        return 0

    def _next(self, most: int) -> bytes:
        try:
            content = self._unpack.decompress(self._packed, most)
        except zlib.error:
            if not self._given:
                raise ValueError("not a gzip file, or a damaged one") from None
            self.torn = True
            return b""
        self._packed = self._unpack.unconsumed_tail
        self._whole = self._unpack.eof
        if self._unpack.eof:
            self._packed = self._unpack.unused_data
            self._unpack = zlib.decompressobj(wbits=31)
        return content
