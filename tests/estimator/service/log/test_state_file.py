"""A state file that nobody should trust: the daemon starts anew, with a reason, and overwrites it."""

import os
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from estimator.service.base.clock import SECOND_NS, Clock
from estimator.service.log import state_file
from estimator.service.log.state_file import SavedState, boot_id
from models.messages import Estimate, Mode

WALL_NS = 1_795_000_000 * SECOND_NS
STEADY_NS = 5000 * SECOND_NS
GOOD = SavedState(1, boot_id(), WALL_NS - STEADY_NS, WALL_NS - SECOND_NS, "x", b"")


def _load(path: Path, saved: SavedState) -> tuple[SavedState | None, str]:
    path.write_bytes(msgspec.msgpack.encode(saved))
    return state_file.load(path, wall_ns=WALL_NS, steady_ns=STEADY_NS)


def test_a_state_of_this_boot_or_another_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "landfix.state"
    assert state_file.load(path) == (None, "")
    assert _load(path, GOOD) == (GOOD, "")
    other = msgspec.structs.replace(GOOD, boot="another", anchor_ns=2**62)
    assert _load(path, other) == (other, "")
    stepped = msgspec.structs.replace(GOOD, anchor_ns=GOOD.anchor_ns - 10**18, t_ns=GOOD.t_ns - 10**18)
    assert _load(path, stepped) == (stepped, ""), "the wall clock was set after the start, as without a battery"


@pytest.mark.parametrize(
    ("anchor_ns", "t_ns", "reason"),
    [
        (2**62, WALL_NS, "its clock is outside 1970 to 2038"),
        (-(2**62), WALL_NS, "its clock is outside 1970 to 2038"),
        (GOOD.anchor_ns, 2**63 - 1, "its clock is outside 1970 to 2038"),
        (GOOD.anchor_ns, -1, "its clock is outside 1970 to 2038"),
        (GOOD.anchor_ns, WALL_NS + SECOND_NS, "its state is not of this boot's time"),
        (GOOD.anchor_ns, GOOD.anchor_ns - 1, "its state is not of this boot's time"),
        (GOOD.anchor_ns + 10**15, GOOD.t_ns + 10**15, "its clock is more than a day ahead of the wall clock"),
    ],
)
def test_an_absurd_clock_is_refused(tmp_path: Path, anchor_ns: int, t_ns: int, reason: str) -> None:
    saved = msgspec.structs.replace(GOOD, anchor_ns=anchor_ns, t_ns=t_ns)
    assert _load(tmp_path / "landfix.state", saved) == (None, reason)


def test_what_is_no_regular_file_of_its_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "landfix.state"
    os.mkfifo(path)
    assert state_file.load(path)[1] == "is no state file, or a damaged one"
    path.unlink()
    path.write_bytes(bytes(2_000_000))
    assert state_file.load(path)[1] == "is no state file, or a damaged one"
    (tmp_path / "elsewhere").write_bytes(msgspec.msgpack.encode(GOOD))
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    assert state_file.load(path)[1] == "too many levels of symbolic links"


def test_a_link_in_its_place_is_replaced_and_not_followed(tmp_path: Path) -> None:
    path, elsewhere = tmp_path / "landfix.state", tmp_path / "elsewhere"
    elsewhere.write_bytes(b"somebody's")
    for name in (path, tmp_path / "landfix.state.part"):
        name.symlink_to(elsewhere)
    clock = Clock()
    t_ns = clock.now_ns()
    keeper = state_file.StateKeeper(path, clock, "x")
    try:
        keeper.note(Estimate(t_ns, t_ns, np.arange(16.0), np.eye(15), (0.0, 0.0, 0.0), Mode.AIDED, 4, t_ns, (47.0, 8.0, 400.0)))
        time.sleep(1.2)
    finally:
        keeper.close()
    assert keeper.report() == {"file": "kept"}
    assert elsewhere.read_bytes() == b"somebody's"
    assert not path.is_symlink()
    saved, why = state_file.load(path)
    assert why == ""
    assert saved is not None
    assert saved.config == "x"
