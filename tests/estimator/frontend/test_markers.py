"""Viewers hear of the landmarks when there is news, and not more often than once a second."""

from typing import Any

import numpy as np
import pytest

from estimator.frontend.markers import LandmarkBoard
from logs.wire.schemas import STORE
from models.maps.landmarks import Landmark, LandmarkMap

SECOND = 1_000_000_000
SQUARE = np.array([(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)])
HERE = np.array([0.0, 0.0, -50.0])
NONE: frozenset[str] = frozenset()


@pytest.fixture
def board() -> LandmarkBoard:
    """A street of 100 landmarks, 10 m apart to the north."""
    street = [Landmark.of(str(k), np.add(SQUARE, [10.0 * k, 0.0]), height_m=3.0) for k in range(100)]
    return LandmarkBoard(LandmarkMap.from_landmarks((47.0, 8.0, 500.0), street))


def _names(messages: list[Any]) -> set[str]:
    (message,) = messages
    return {m.text for m in STORE.deserialize_cdr(message.data, message.schema).markers if m.text}  # type: ignore[attr-defined]


def test_reported_at_the_start_and_when_those_in_use_change(board: LandmarkBoard) -> None:
    assert _names(board.news(0, HERE, NONE)) == {str(k) for k in range(30)} | {"30"}
    assert board.news(5 * SECOND, HERE, NONE) == []
    assert board.news(6 * SECOND, HERE, frozenset({"1"}))
    assert board.news(8 * SECOND, HERE, frozenset({"1"})) == []
    assert board.news(9 * SECOND, HERE, NONE)


def test_a_change_waits_for_its_second(board: LandmarkBoard) -> None:
    board.news(0, HERE, NONE)
    assert board.news(SECOND // 2, HERE, frozenset({"1"})) == []
    assert board.news(SECOND, HERE, frozenset({"1"}))


def test_reported_anew_further_on(board: LandmarkBoard) -> None:
    board.news(0, HERE, NONE)
    assert board.news(2 * SECOND, np.add(HERE, [90.0, 0.0, 300.0]), NONE) == []
    assert "40" in _names(board.news(4 * SECOND, np.add(HERE, [110.0, 0.0, 0.0]), NONE))


def test_a_step_back_in_time_is_news_again(board: LandmarkBoard) -> None:
    board.news(10 * SECOND, HERE, NONE)
    assert board.news(5 * SECOND, HERE, frozenset({"1"}))


def test_never_more_than_three_hundred() -> None:
    crowd = [Landmark.of(str(k), np.add(SQUARE, [6.0 * (k // 25), 6.0 * (k % 25)])) for k in range(625)]
    board = LandmarkBoard(LandmarkMap.from_landmarks((47.0, 8.0, 500.0), crowd))
    assert len(_names(board.news(0, HERE, NONE))) == 300
