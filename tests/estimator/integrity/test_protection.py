import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import norm

from estimator.integrity.protection import Mode, Tail, allowed, exceeded, in_plane, one_axis, protection_level

GAUSS = Tail(1.0, 1.0, 0.0)
HEAVY = Tail(1.2, 2.0, 0.02)
SIZES = st.floats(1e-3, 1e3)


def test_one_mode_has_the_quantile_of_its_distribution() -> None:
    only = [Mode("nominal", 1.0, 0.0, 2.0)]
    assert protection_level(only, 1e-7, GAUSS, one_axis) == pytest.approx(2.0 * norm.isf(0.5e-7), rel=2e-3)
    assert protection_level(only, 1e-7, GAUSS, in_plane) == pytest.approx(2.0 * math.sqrt(-2.0 * math.log(1e-7)), rel=2e-3)


def test_a_likely_fault_is_within_the_bound_and_one_less_probable_than_the_risk_is_not() -> None:
    nominal = Mode("nominal", 1.0, 0.0, 0.1)
    likely = protection_level([nominal, Mode("fault", 1e-3, 20.0, 0.1)], 1e-6, GAUSS, one_axis)
    rare = protection_level([nominal, Mode("fault", 1e-8, 20.0, 0.1)], 1e-6, GAUSS, one_axis)
    assert likely == pytest.approx(20.0 + 0.1 * norm.isf(1e-3 / 2), rel=2e-3)
    assert rare < 1.0


def test_a_fault_that_nothing_bounds_leaves_a_bound_only_above_its_own_probability() -> None:
    modes = [Mode("nominal", 1.0, 0.0, 1.0), Mode("fault", 1e-6, 0.0, math.inf)]
    assert math.isinf(protection_level(modes, 1e-6, GAUSS, one_axis))
    assert protection_level(modes, 2e-6, GAUSS, one_axis) == pytest.approx(norm.isf(0.5e-6), rel=2e-3)


def test_what_is_always_known_needs_no_bound() -> None:
    assert protection_level([], 1e-6, GAUSS, one_axis) == 0.0
    assert protection_level([Mode("nominal", 1.0, 0.0, 0.0)], 1e-6, GAUSS, one_axis) == pytest.approx(0.0, abs=1e-7)
    assert protection_level([Mode("fixed", 1.0, 3.0, 0.0)], 1e-6, GAUSS, one_axis) == pytest.approx(3.0, rel=1e-2)


@example([(0.0078125, 1.0, 1.0), (1e-9, 0.0, 1.0)], 0.0078125)  # a fault whose probability is the risk
@given(st.lists(st.tuples(st.floats(1e-9, 1.0), st.floats(0, 1e3), SIZES), min_size=1, max_size=8), st.floats(1e-11, 1e-2))
def test_the_bound_holds_and_is_tight(of: list[tuple[float, float, float]], probability: float) -> None:
    modes = [Mode(str(k), *m) for k, m in enumerate(of)]
    for exceeds in (one_axis, in_plane):
        level = protection_level(modes, probability, HEAVY, exceeds)
        assert sum(exceeded(modes, level, HEAVY, exceeds)) <= probability * (1.0 + 1e-9)
        if level > 0.0:
            assert (
                sum(exceeded(modes, 0.997 * level, HEAVY, exceeds)) >= probability
            )  # as much, where a fault has its whole probability


def test_a_rarer_risk_needs_a_wider_bound() -> None:
    modes = [Mode("nominal", 1.0, 0.0, 1.0), Mode("fault", 1e-4, 5.0, 2.0)]
    levels = [protection_level(modes, allowed(risk, 10.0), HEAVY, in_plane) for risk in (1e-3, 1e-5, 1e-7)]
    assert all(a < b for a, b in pairwise(levels))


def test_the_risk_of_one_error_is_that_of_an_hour_by_the_number_of_errors_in_it() -> None:
    assert allowed(1e-5, 10.0) == pytest.approx(1e-5 / 360.0)


def test_the_tail_covers_drawn_errors_of_two_sizes() -> None:
    rng = np.random.default_rng(0)
    scale = np.where(rng.random(400_000) < 0.02, 2.0, 1.2)
    error = np.abs(scale * rng.standard_normal(len(scale)))
    for probability in (1e-2, 1e-3, 1e-4):
        level = protection_level([Mode("nominal", 1.0, 0.0, 1.0)], probability, HEAVY, one_axis)
        assert np.mean(error > level) == pytest.approx(probability, rel=0.35)
