"""The chi-square gate lets its share of good innovations pass; the CUSUM sees a small bias that the gate cannot."""

import numpy as np
import pytest

from estimator.sources.base.gating import cusum, gate
from models.messages import Array

SLACK, LIMIT = 1.0, 10.0


@pytest.mark.parametrize(
    ("probability", "dof", "value"), [(0.95, 1, 3.841), (0.95, 3, 7.815), (0.99, 2, 9.210), (0.999, 6, 22.458), (0.99, 6, 16.812)]
)
def test_gate_is_the_tables_value(probability: float, dof: int, value: float) -> None:
    assert gate(probability, dof) == pytest.approx(value, abs=1e-3)


def test_the_share_that_passes_is_the_share_asked_for() -> None:
    nu = np.random.default_rng(0).normal(size=(100_000, 3))
    share = np.mean(np.sum(nu**2, axis=1) <= gate(0.99, 3))
    assert 0.988 < share < 0.992


def _run(nu: Array, sigma: Array) -> Array:
    """The largest sum after each innovation."""
    sums: tuple[float, ...] = ()
    largest = []
    for each in nu:
        sums = cusum(sums, each, sigma, SLACK)
        largest.append(max(sums))
    return np.array(largest)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bias_of_two_sigma_is_found_out_in_about_limit_steps_whatever_its_side(axis: int, sign: float) -> None:
    nu = 0.5 * np.random.default_rng(axis).normal(size=(50, 3))
    nu[:, axis] += sign * 2.0 * 0.5
    found = int(np.argmax(_run(nu, np.full(3, 0.5)) > LIMIT))
    assert 5 <= found <= 25  # the sum grows by bias - slack = 1 a step
    assert np.mean(np.sum((nu / 0.5) ** 2, axis=1) < gate(0.9999, 3)) > 0.9


def test_good_innovations_stay_far_below_the_limit() -> None:
    largest = _run(0.3 * np.random.default_rng(1).normal(size=(2_000, 3)), np.full(3, 0.3))
    assert 0.5 < largest.max() < LIMIT


def test_sums_are_those_of_page() -> None:
    sums = cusum((), np.array([3.0, -4.0]), np.array([1.0, 2.0]), 1.0)
    assert sums == (2.0, 0.0, 0.0, 1.0)
    assert cusum(sums, np.array([0.5, 0.0]), np.array([1.0, 2.0]), 1.0) == (1.5, 0.0, 0.0, 0.0)


def test_sums_begin_anew_where_the_number_of_components_changes() -> None:
    assert cusum((5.0, 5.0), np.zeros(2), np.ones(2), 1.0) == (0.0, 0.0, 0.0, 0.0)
