"""What a person names may be a pipe, a device or endless: it is neither waited for nor read without end."""

import os
import tracemalloc
from pathlib import Path

import pytest

from models.untrusted import file
from models.untrusted.file import content, opened


def test_a_regular_file_is_read_whole_up_to_the_bound(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    assert content(tmp_path / "a") == content(tmp_path / "a", 5) == b"12345"
    tracemalloc.start()
    content(tmp_path / "a")
    assert tracemalloc.get_traced_memory()[1] < 2_000_000  # and not memory for as much as it might have
    tracemalloc.stop()
    with pytest.raises(OSError, match="is larger than 4e-06 MB"):
        content(tmp_path / "a", 4)


def test_a_file_larger_than_the_bound_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as sparse:
        sparse.truncate(2**40)
    tracemalloc.start()
    with pytest.raises(OSError, match="is larger than"):
        content(tmp_path / "sparse")
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()


def test_an_endless_device_is_read_no_further_than_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file, "PIPE_BYTES", 2_000_000)
    with pytest.raises(OSError, match="is larger than 2 MB"):
        content(Path("/dev/zero"))


def test_a_pipe_without_a_writer_is_empty_and_one_with_a_writer_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert content(tmp_path / "pipe") == b""
    theirs, ours = os.pipe()
    os.write(ours, b"abc")
    os.close(ours)
    assert content(Path(f"/dev/fd/{theirs}")) == b"abc"
    os.close(theirs)


def test_a_folder_and_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        opened(tmp_path)
    with pytest.raises(FileNotFoundError):
        content(tmp_path / "none")
