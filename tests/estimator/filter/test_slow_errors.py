"""Named blocks behind the 15 states: where they stand, which was used last, and what is left when one goes."""

import numpy as np

from estimator.filter.slow_errors import NO_SLOW_ERRORS, SlowErrors
from models.state import E


def _blocks() -> SlowErrors:
    slow = NO_SLOW_ERRORS.also("gnss", np.array([1.0, 2.0]), 60.0, estimated=False)
    slow = slow.also("fix/a", np.array([3.0]), 1e9, estimated=False)
    return slow.also("fix/b", np.array([4.0, 5.0, 6.0]), 1e8, estimated=True)


def test_blocks_stand_one_behind_the_other() -> None:
    slow = _blocks()
    assert slow.columns == {
        "gnss": slice(E.SIZE, E.SIZE + 2), "fix/a": slice(E.SIZE + 2, E.SIZE + 3), "fix/b": slice(E.SIZE + 3, E.SIZE + 6)
    }  # fmt: skip
    np.testing.assert_array_equal(slow.psd, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def test_without_one_the_others_close_up() -> None:
    slow = _blocks().moved(np.arange(1.0, 7.0)).without("fix/a")
    assert slow.columns == {"gnss": slice(E.SIZE, E.SIZE + 2), "fix/b": slice(E.SIZE + 2, E.SIZE + 5)}
    np.testing.assert_array_equal(slow.psd, [1.0, 2.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(slow.tau_s, [60.0, 60.0, 1e8, 1e8, 1e8])
    np.testing.assert_array_equal(slow.mean, [0.0, 0.0, 4.0, 5.0, 6.0])  # only what is estimated moves
    np.testing.assert_array_equal(slow.estimated, [0.0, 0.0, 1.0, 1.0, 1.0])


def test_the_oldest_of_a_kind_is_the_one_not_used_for_longest() -> None:
    slow = _blocks()
    assert slow.oldest("fix", 3) is None
    assert slow.oldest("fix", 2) == "fix/a"
    assert slow.used(["fix/a"]).oldest("fix", 2) == "fix/b"
    assert [*slow.used(["fix/b"]).columns] == [*slow.used(["of no block"]).columns] == [*slow.columns]
    assert slow.used(["gnss"]).columns == slow.columns  # the same places
    assert slow.oldest("gnss", 1) is None  # a kind has blocks called kind/...
    assert slow.oldest("", 1) is None
