"""Turn, scale and unit of a path are found; one that drifts, stands still, is moved, or is noise has none."""

import cmath
import math

import numpy as np
import pytest

from estimator.sources.base.similarity import Similarity

_TURN = cmath.exp(1j * math.radians(10.0))


def _path(seed: int) -> list[complex]:
    """A copter that flies legs of 40 m and waits at their ends."""
    rng, at, found = np.random.default_rng(seed), 0j, list[complex]()
    for _ in range(4):
        way = 40.0 * cmath.exp(1j * float(rng.uniform(-math.pi, math.pi)))
        found += [at + way * min(k / 40.0, 1.0) for k in range(60)]
        at += way
    return found


def _fitted(path: list[complex], other: list[complex], noise_m: float = 0.5) -> Similarity:
    rng, found = np.random.default_rng(0), Similarity()
    for k, (p, g) in enumerate(zip(path, other, strict=True)):
        found = found.also(p, g + noise_m * complex(*rng.standard_normal(2)), 0.2 * k)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("a", [_TURN, 1.2, 0.7 * _TURN], ids=["turned", "scaled", "both"])
def test_a_turn_and_a_scale_are_found(seed: int, a: complex) -> None:
    path = _path(seed)
    found = _fitted(path, [a * p + (3.0 - 2.0j) for p in path])
    assert found.is_turned
    assert abs(found.a - a) < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_what_is_no_turn_is_not_found(seed: int) -> None:
    path = _path(seed)
    others = {
        "true": path,
        "moved": [p + 200.0 for p in path],
        "drifts": [p + 0.2j * k for k, p in enumerate(path)],
        "pulled later": [p + 0.6 * max(k - 100, 0) for k, p in enumerate(path)],
        "jumps": [p + 30.0 * (k > 100) for k, p in enumerate(path)],
        "stands still": [0j for _ in path],
        "within the noise": [p * cmath.exp(0.01j) for p in path],
    }
    for name, other in others.items():
        found = _fitted(path, other)
        assert not found.is_turned, name
        assert not found.unit, name
    assert not _fitted(path, path, noise_m=25.0).is_turned


def test_on_a_straight_way_of_constant_speed_a_drift_may_be_a_turn_and_one_that_begins_later_is_none() -> None:
    path = [20.0 * 0.2 * k + 0j for k in range(300)]
    assert _fitted(path, [p + 0.5j * k for k, p in enumerate(path)]).is_turned
    assert not _fitted(path, [p + 0.5j * max(k - 150, 0) for k, p in enumerate(path)]).is_turned


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("k", "name"), [(3.28, "feet"), (100.0, "centimetres"), (1000.0, "millimetres"), (0.001, "kilometres")])
@pytest.mark.parametrize("turn", [1.0, _TURN])
def test_a_unit_is_named_and_the_difference_is_a_scale(seed: int, k: float, name: str, turn: complex) -> None:
    path = _path(seed)
    found = _fitted([k * turn * p for p in path], path)
    assert found.unit == name
    assert found.is_turned


@pytest.mark.parametrize("a", [0.4, 0.5, 0.7, 1.0, 1.4, 2.5])
def test_a_scale_that_is_no_unit_names_none(a: float) -> None:
    path = _path(2)
    assert not _fitted(path, [a * p for p in path]).unit


def test_on_a_straight_way_of_constant_speed_a_receiver_that_is_pulled_back_may_be_a_unit() -> None:
    path = [2.0 * 0.2 * k + 0j for k in range(300)]
    pulled = _fitted(path, [0.3048 * p for p in path])
    assert not pulled.unit
    assert pulled.is_turned


def test_the_sums_are_those_of_least_squares() -> None:
    path, rng = np.array(_path(1)), np.random.default_rng(3)
    other = 1.05 * _TURN * path + rng.standard_normal(len(path)) + 1j * rng.standard_normal(len(path))
    found = Similarity()
    for k, (p, g) in enumerate(zip(path.tolist(), other.tolist(), strict=True)):
        found = found.also(p, g, 0.2 * k)
    (a, _), left, *_ = np.linalg.lstsq(np.stack((path, np.ones(len(path))), axis=1), other, rcond=None)
    assert found.a == pytest.approx(a, rel=1e-9)
    assert found.gg - abs(found.gp) ** 2 / found.pp == pytest.approx(float(left[0]), rel=1e-9)


def test_nothing_is_found_in_too_few_or_in_one_place() -> None:
    assert not Similarity().is_turned
    assert Similarity().a == 1.0
    assert not _fitted(_path(0)[:20], [_TURN * p for p in _path(0)[:20]], noise_m=0.0).is_turned  # two points always fit
    assert not _fitted([0j] * 50, [1.0 + 0j] * 50, noise_m=0.0).is_turned
