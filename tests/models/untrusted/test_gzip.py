"""A gzip file as a stream, whole, torn, in members, and one that holds far more than it should."""

import gzip
import random
from io import BufferedReader
from pathlib import Path

import pytest

from models.untrusted.gzip import GzipFile
from models.untrusted.limits import TooLargeError

TEXT = "".join(f"{random.Random(k).random():.9f},{k}\n" for k in range(20_000)).encode()


def _read(path: Path, data: bytes) -> tuple[bytes, bool]:
    path.write_bytes(data)
    with GzipFile(path) as file:
        return file.readall(), file.torn


def test_it_reads_what_was_packed_in_one_member_or_several(tmp_path: Path) -> None:
    packed = gzip.compress(TEXT)
    assert _read(tmp_path / "a.gz", packed) == (TEXT, False)
    assert _read(tmp_path / "a.gz", packed + packed) == (TEXT + TEXT, False)
    with BufferedReader(GzipFile(tmp_path / "a.gz")) as lines:
        assert list(lines)[:2] == TEXT.splitlines(keepends=True)[:2]


def test_a_torn_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    packed = gzip.compress(TEXT)
    content, torn = _read(tmp_path / "a.gz", packed[:-2000])
    assert torn
    assert TEXT.startswith(content)
    assert len(content) > 0.9 * len(TEXT)
    content, torn = _read(tmp_path / "a.gz", packed + b"garbage")
    assert (content, torn) == (TEXT, True)


def test_what_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not a gzip file"):
        _read(tmp_path / "a.gz", b"t_s,gx\n1,2\n")


def test_a_text_that_is_packed_too_small_is_refused_early(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "bomb.gz", "wb") as packed:
        for _ in range(600):
            packed.write(bytes(2**20))
    with GzipFile(tmp_path / "bomb.gz") as file, pytest.raises(TooLargeError, match=r"more than 2\d\d MiB"):
        list(iter(lambda: len(file.read(2**20) or b""), 0))
    assert file._read < 2**19
