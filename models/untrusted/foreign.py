"""What stands where a log should: a pointer, a web page, an archive."""

from typing import Final

HEAD_BYTES: Final = 64
_UNPACK: Final = "unpack it first"
_SIGNS: Final = {
    b"version https://git-lfs": "a Git LFS pointer, not the file itself: git lfs pull",
    b"<!doctype html": "a web page, not a log: download the file itself",
    b"<html": "a web page, not a log: download the file itself",
    b"pk\x03\x04": f"a ZIP archive or a spreadsheet: {_UNPACK}",
    b"\x1f\x8b": f"packed by gzip: {_UNPACK}",
    b"\xfd7zxz\0": f"packed by xz: {_UNPACK}",
    b"bzh": f"packed by bzip2: {_UNPACK}",
    b"7z\xbc\xaf\x27\x1c": f"packed by 7-Zip: {_UNPACK}",
    b"\x28\xb5\x2f\xfd": f"packed by zstd: {_UNPACK}",
}


def foreign(head: bytes) -> str:
    """What a file of these first bytes is; empty: it may be a log."""
    plain = head.lstrip().lower()
    return next((what for sign, what in _SIGNS.items() if plain.startswith(sign)), "")


_LOGS: Final = {
    b"\x89MCAP0": "rosbag",
    b"#ROSBAG V": "rosbag",
    b"SQLite format 3\0": "rosbag",
    b"ULog\x01\x12\x35": "ulog",
    b"\xa3\x95\x80\x80": "dataflash",
}


def kind_of(head: bytes) -> str:
    """The kind of log that a file of these first bytes is; empty: they do not show it."""
    return next((kind for sign, kind in _LOGS.items() if head.startswith(sign)), "")
