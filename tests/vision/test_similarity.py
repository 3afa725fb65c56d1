import numpy as np
import pytest

from vision.similarity import GENERAL, Weights, similarity

PAD = np.array([24.0, 4.0, 6.0, 1.0])


def test_the_thesis_weights_are_normalised() -> None:
    w = GENERAL.normalised()
    assert w.sum() == pytest.approx(1.0, abs=1e-15)
    assert w[1] / w[0] == pytest.approx(0.304130 / 0.20966)
    assert similarity(PAD, PAD, w) == pytest.approx(1.0)


def test_twice_too_large_is_as_wrong_as_twice_too_small() -> None:
    w = GENERAL.normalised()
    assert similarity(2.0 * PAD, PAD, w) == pytest.approx(0.5)
    assert similarity(0.5 * PAD, PAD, w) == pytest.approx(0.5)


def test_one_feature_counts_by_its_weight() -> None:
    wider = PAD * [1.0, 1.25, 1.0, 1.0]
    assert similarity(wider, PAD, GENERAL.normalised()) == pytest.approx(1.0 - 0.2 * 0.304130 / 1.025662, abs=1e-6)
    assert similarity(wider, PAD, Weights(size=1.0, width=0.0, length=0.0, fill_ratio=0.0).normalised()) == pytest.approx(1.0)


def test_many_against_many() -> None:
    measured, described = np.stack([PAD, 2.0 * PAD]), np.stack([PAD, PAD / 3.0, 4.0 * PAD])
    table = similarity(measured[:, None], described[None], GENERAL.normalised())
    np.testing.assert_allclose(table, [[1.0, 1 / 3, 1 / 4], [1 / 2, 1 / 6, 1 / 2]])


def test_what_is_not_a_figure_agrees_with_nothing() -> None:
    w = GENERAL.normalised()
    assert similarity(np.full(4, np.nan), PAD, w) == 0.0
    assert similarity(PAD, np.zeros(4), w) == 0.0
    assert similarity(PAD * [1.0, 1.0, 1.0, -1.0], PAD, w) == pytest.approx(1.0 - w[3])


@pytest.mark.parametrize("bad", [Weights(size=-1.0), Weights(0.0, 0.0, 0.0, 0.0), Weights(width=float("nan"))])
def test_weights_that_weigh_nothing_are_refused(bad: Weights) -> None:
    with pytest.raises(ValueError, match="weights"):
        bad.normalised()
