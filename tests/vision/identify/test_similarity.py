import numpy as np
import pytest

from models.maps.landmarks import WEIGHTS
from vision.identify.similarity import normalised, similarity

PAD = np.array([24.0, 4.0, 6.0, 1.0])
GENERAL = normalised(WEIGHTS)


def test_the_thesis_weights_are_normalised() -> None:
    assert GENERAL.sum() == pytest.approx(1.0, abs=1e-15)
    assert GENERAL[1] / GENERAL[0] == pytest.approx(0.304130 / 0.20966)
    assert similarity(PAD, PAD, GENERAL) == pytest.approx(1.0)


def test_twice_too_large_is_as_wrong_as_twice_too_small() -> None:
    assert similarity(2.0 * PAD, PAD, GENERAL) == pytest.approx(0.5)
    assert similarity(0.5 * PAD, PAD, GENERAL) == pytest.approx(0.5)


def test_one_feature_counts_by_its_weight() -> None:
    wider = PAD * [1.0, 1.25, 1.0, 1.0]
    assert similarity(wider, PAD, GENERAL) == pytest.approx(1.0 - 0.2 * 0.304130 / 1.025662, abs=1e-6)
    assert similarity(wider, PAD, normalised([1.0, 0.0, 0.0, 0.0])) == pytest.approx(1.0)


def test_many_against_many_each_landmark_with_its_own_weights() -> None:
    measured, described = np.stack([PAD, 2.0 * PAD]), np.stack([PAD, PAD / 3.0, PAD * [4.0, 1.0, 1.0, 1.0]])
    weights = normalised([WEIGHTS, WEIGHTS, (1.0, 0.0, 0.0, 1.0)])
    table = similarity(measured[:, None], described[None], weights)
    np.testing.assert_allclose(table, [[1.0, 1 / 3, 5 / 8], [1 / 2, 1 / 6, 1 / 2]])


def test_what_is_not_a_figure_agrees_with_nothing() -> None:
    assert similarity(np.full(4, np.nan), PAD, GENERAL) == 0.0
    assert similarity(PAD, np.zeros(4), GENERAL) == 0.0
    assert similarity(PAD * [1.0, 1.0, 1.0, -1.0], PAD, GENERAL) == pytest.approx(1.0 - GENERAL[3])


@pytest.mark.parametrize("bad", [(-1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0), (float("nan"), 1.0, 1.0, 1.0)])
def test_weights_that_weigh_nothing_are_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="weights"):
        normalised(bad)
