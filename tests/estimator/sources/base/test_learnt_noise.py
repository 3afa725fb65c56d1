"""The noise of an odometry is learnt from its innovations, as far as they show it."""

import numpy as np
import pytest

from estimator.sources.base.learnt_noise import LearntNoise
from models.messages import Array

ROWS = np.arange(6)
NOISE = np.diag([0.02**2] * 3 + [3e-3**2] * 3)
HALF_S = 0.5


def _learnt(sigma: float, known: Array, *, seconds: float = 30.0, start: LearntNoise | None = None) -> LearntNoise:
    """After increments whose errors are sigma times what is configured; known: P of the prediction, (6,), in units of R."""
    rng, learnt = np.random.default_rng(3), start or LearntNoise()
    predicted = np.diag(known) * NOISE
    for _ in range(round(seconds / HALF_S)):
        nu = sigma * np.sqrt(NOISE.diagonal()) * rng.standard_normal(6)
        nu += np.sqrt(predicted.diagonal()) * rng.standard_normal(6)
        noise = np.outer(learnt.roots, learnt.roots) * NOISE
        learnt = learnt.also(nu, predicted + noise, noise, ROWS, HALF_S)
    return learnt


@pytest.mark.parametrize(("sigma", "factor"), [(0.3, 0.5), (0.8, 0.64), (1.0, 1.0), (3.0, 9.0)])
def test_factors_are_what_increments_have_but_a_half_at_least(sigma: float, factor: float) -> None:
    for found in _learnt(sigma, np.full(6, 0.1), seconds=60.0).factors:
        assert found == pytest.approx(factor, rel=0.35)


def test_up_within_three_seconds_and_down_over_tens() -> None:
    up = _learnt(4.0, np.full(6, 0.3), seconds=3.0)
    assert min(up.factors) > 5.0
    down = _learnt(1.0, np.full(6, 0.3), seconds=10.0, start=_learnt(4.0, np.full(6, 0.3)))
    assert min(down.factors) > 5.0


def test_what_the_prediction_hides_is_not_learnt() -> None:
    for factor in _learnt(3.0, np.full(6, 1e4)).factors:
        assert factor == pytest.approx(1.0, abs=0.2)


def test_translation_and_rotation_each_have_their_own() -> None:
    rng, learnt = np.random.default_rng(4), LearntNoise()
    for _ in range(60):
        noise = np.outer(learnt.roots, learnt.roots) * NOISE
        nu = np.sqrt(NOISE.diagonal()) * rng.standard_normal(6) * np.repeat((1.0, 3.0), 3)
        learnt = learnt.also(nu, 1.1 * noise, noise, ROWS, HALF_S)
    translation, rotation = learnt.factors
    assert translation == pytest.approx(1.0, rel=0.35)
    assert rotation == pytest.approx(9.0, rel=0.35)


def test_beyond_five_times_the_noise_it_is_none() -> None:
    assert _learnt(4.0, np.full(6, 0.3)).is_noise
    assert not _learnt(15.0, np.full(6, 0.3)).is_noise
