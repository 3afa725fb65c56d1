"""The bound on what is unpacked of a bag."""

import bz2

import pytest

from logs.importers.rosbag.unindexed import Unpacker
from models.untrusted.limits import PIECE_BYTES, TooLargeError

_MIB = 2**20


def test_chunks_that_are_wanted_in_turn_are_unpacked_once() -> None:
    """Of two that overlap in time each message may need the other one."""
    unpack, data = Unpacker(0), bz2.compress(bytes(_MIB))
    for k in range(3 * PIECE_BYTES // _MIB):
        assert len(unpack("bz2", data, chunk=k % 2)) == _MIB


def test_all_together_are_bounded() -> None:
    unpack, data = Unpacker(0), bz2.compress(bytes(64 * _MIB))
    for k in range(4):
        unpack("bz2", data, chunk=k)
    with pytest.raises(TooLargeError, match="0 are read at most"):
        unpack("bz2", data, chunk=4)
