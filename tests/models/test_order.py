import numpy as np
import pytest

from models import order


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 500])
def test_median_and_quantiles_are_numpys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    values[: count // 3] = values[-1]  # ties
    before = values.copy()
    assert order.median(values) == np.median(values)
    for share in (0.25, 0.75, 0.8):
        np.testing.assert_allclose(order.quantile(values, share), np.quantile(values, share), rtol=1e-12)
    np.testing.assert_array_equal(values, before)
    np.testing.assert_array_equal(order.ranked(values), np.argsort(values, kind="stable"))
    order.sort(values)
    np.testing.assert_array_equal(values, np.sort(before))


def test_of_nothing_and_of_what_is_no_number_there_is_none() -> None:
    assert np.isnan(order.median(np.zeros(0)))
    assert np.isnan(order.quantile(np.array([1.0, np.nan, 3.0]), 0.25))
