"""Fused fixes of several sources: what they differ by on average, and nothing of their noise."""

from collections.abc import Sequence

import numpy as np
import pytest

from estimator.filter.mismatch import Means, between
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND

NOISE = 0.04 * np.eye(6)


def _means(north_m: Sequence[float], *, seed: int = 0, count: int = 100) -> Means:
    """Sources in turns, so far north of the estimate, with white noise of the reported sigma."""
    rng, means = np.random.default_rng(seed), dict[str, between.Mean]()
    for k in range(count):
        for i, north in enumerate(north_m):
            nu = np.concatenate(([north, 0.0, 0.0], np.zeros(3))) + rng.multivariate_normal(np.zeros(6), NOISE)
            means = dict(between.noted(means, f"/{i}", EPOCH_NS + k * SECOND // 4, nu, NOISE))
    return means


@pytest.mark.parametrize("half_m", [0.5, 5.0])
def test_half_of_the_distance_of_two_is_its_sigma(half_m: float) -> None:
    found = between.covariance(_means([half_m, -half_m]), ())
    assert found is not None
    assert np.sqrt(found[0, 0]) == pytest.approx(half_m, rel=0.25)
    assert found[1, 1] < 0.02


def test_sources_that_agree_are_rarely_widened_and_little() -> None:
    found = [between.covariance(_means([0.0, 0.0], seed=seed, count=60), ()) for seed in range(60)]
    sizes = [0.0 if f is None else float(np.sqrt(f.trace())) for f in found]
    assert sum(size > 0.0 for size in sizes) < 9
    assert max(sizes) < 0.2


def test_one_source_and_one_that_is_rejected_or_old_differ_from_none() -> None:
    means = _means([0.5, -0.5])
    assert between.covariance(_means([0.5]), ()) is None
    assert between.covariance(means, {"/1"}) is None
    later = between.noted(means, "/0", EPOCH_NS + 60 * SECOND, np.zeros(6), NOISE)
    assert between.covariance(later, ()) is None
    np.testing.assert_array_equal(later["/0"].m, np.zeros(3))
