"""The search against every joint assignment written out."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from models.messages import Array
from vision.identify.assignment import COLUMNS, GROWTH, SCALE, STATES, Expected, Options, search

NOWHERE = Expected(
    np.zeros((0, 3)), np.zeros((0, 3, STATES)), np.zeros(0), np.zeros(0), math.log(0.1), np.array([-1.0, 1.0, -1.0, 1.0]),
    np.zeros((0, 3)),
)  # fmt: skip


def draw_options(rng: np.random.Generator, regions: int, landmarks: int, growth: bool = False) -> Options:
    """Clutter and every landmark for each region, with random rows."""
    count = regions * (landmarks + 1)
    y, A = rng.normal(0.0, 2.0, (count, 7)), rng.normal(0.0, 1.0, (count, 7, COLUMNS))
    if not growth:
        A[..., GROWTH] = 0.0
    landmark = np.tile(np.arange(-1, landmarks), regions)
    y[landmark < 0], A[landmark < 0] = 0.0, 0.0
    return Options(np.arange(regions + 1) * (landmarks + 1), landmark, y, A, rng.normal(0.0, 1.0, count))


def enumerated(o: Options, covariance: Array) -> dict[tuple[int, ...], float]:
    """Probability of each joint assignment, by the joint Gaussian of all rows at once."""
    weights = {}
    for chosen in itertools.product(*(range(a, b) for a, b in itertools.pairwise(o.start))):
        named = [o.landmark[k] for k in chosen if o.landmark[k] >= 0]
        if len(set(named)) < len(named):
            continue
        y, A = o.y[list(chosen)].ravel(), o.A[list(chosen), :, :STATES].reshape(-1, STATES)
        S = A @ covariance @ A.T + np.eye(len(y))
        weights[chosen] = float(o.log_weight[list(chosen)].sum() - 0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1]))
    top = max(weights.values())
    total = sum(math.exp(w - top) for w in weights.values())
    return {chosen: math.exp(w - top) / total for chosen, w in weights.items()}


@pytest.mark.parametrize("seed", range(5))
def test_joint_posterior_is_that_of_all_assignments_written_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    o = draw_options(rng, 3, 4)
    root = rng.normal(0.0, 1.0, (STATES, STATES))
    covariance = root @ root.T + 0.1 * np.eye(STATES)
    found = search(o, NOWHERE, covariance, breadth=10_000, drop=200.0)
    expected = enumerated(o, covariance)
    assert len(found.probability) == len(expected)
    for chosen, p in zip(found.option, found.probability, strict=True):
        assert p == pytest.approx(expected[tuple(chosen)], rel=1e-8)
    assert found.unexplored == 0.0
    assert np.all(np.diff(found.probability) <= 0.0)


def test_a_landmark_is_one_region_only() -> None:
    o = draw_options(np.random.default_rng(1), 4, 2)
    found = search(o, NOWHERE, np.eye(STATES), breadth=10_000, drop=200.0)
    named = o.landmark[found.option]
    for j in range(2):
        assert ((named == j).sum(axis=1) <= 1).all()


def test_what_is_cut_off_is_counted() -> None:
    o = draw_options(np.random.default_rng(2), 4, 4)
    o = replace(o, y=0.1 * o.y, A=0.1 * o.A)  # nearly everything is possible
    whole = search(o, NOWHERE, np.eye(STATES), breadth=100_000, drop=300.0)
    narrow = search(o, NOWHERE, np.eye(STATES), breadth=3, drop=300.0)
    missing = 1.0 - sum(p for chosen, p in enumerated(o, np.eye(STATES)).items() if chosen in map(tuple, narrow.option.tolist()))
    assert 0.3 < narrow.unexplored < missing + 0.1
    assert narrow.probability.sum() + narrow.unexplored == pytest.approx(1.0)
    assert narrow.probability[0] < 2.0 * whole.probability[0]  # of the same order though only 3 of hundreds were followed


def test_state_is_that_of_the_kalman_filter() -> None:
    o = draw_options(np.random.default_rng(3), 2, 1)
    P = np.diag(np.arange(1.0, 8.0))
    found = search(o, NOWHERE, P, drop=300.0)
    A, y = o.A[found.option[0], :, :STATES].reshape(-1, STATES), o.y[found.option[0]].ravel()
    information = np.linalg.inv(P) + A.T @ A
    np.testing.assert_allclose(found.covariance[0], np.linalg.inv(information), atol=1e-10)
    np.testing.assert_allclose(found.x[0], np.linalg.solve(information, A.T @ y), atol=1e-10)


def test_distances_grow_with_the_exponential_of_the_scale() -> None:
    """Sizes first say s = 0.5; a distance of 60 m then is off by 60 (exp(0.5) - 1), not by 60 x 0.5."""
    y, A = np.zeros((1, 7)), np.zeros((1, 7, COLUMNS))
    y[0, 0], A[0, 0, SCALE] = 0.5 / 1e-4, 1.0 / 1e-4
    y[0, 4], A[0, 4, GROWTH], A[0, 4, 0] = 60.0 * (math.exp(0.5) - 1.0) / 0.1, 60.0 / 0.1, 1.0 / 0.1
    o = Options(np.array([0, 1]), np.array([0]), y, A, np.zeros(1))
    found = search(o, NOWHERE, np.diag([25.0] * 3 + [1e-4] * 3 + [0.09]))
    assert found.x[0, SCALE] == pytest.approx(0.5, abs=1e-3)
    assert found.x[0, 0] == pytest.approx(0.0, abs=0.05)


def test_a_landmark_in_view_that_no_image_shows_counts_against_it() -> None:
    """One region, two equal landmarks; if it is the first, a third must be in view, and none is seen."""
    y, A = np.zeros((2, 7)), np.zeros((2, 7, COLUMNS))
    y[:, 4], A[:, 4, 0] = [0.0, 30.0 / 0.1], 1.0 / 0.1
    o = Options(np.array([0, 2]), np.array([0, 1]), y, A, np.zeros(2))
    x_c = np.array([[0.0, 0.0, 60.0], [30.0, 0.0, 60.0], [25.0, 0.0, 60.0]])
    moving = np.zeros((3, 3, STATES))
    moving[:, 0, 0] = -1.0
    missed = math.log(0.2)
    expected = Expected(
        x_c, moving, np.full(3, 2.0), np.full(3, missed), math.log(0.1), np.array([-0.5, 0.5, -0.5, 0.5]), np.zeros((1, 3))
    )
    P = np.diag([1e4, *[1e-4] * 6])
    blind = search(o, NOWHERE, P).probability
    seeing = search(o, expected, P)
    second = seeing.probability[list(o.landmark[seeing.option[:, 0]]).index(1)]
    # as the first: landmarks 1 (at +30 m) and 2 (at +25 m, x/z 0.42) should be seen; as the second: 0 (-30 m) and 2 (-5 m)
    assert blind[0] == pytest.approx(0.5, abs=0.02)
    assert second == pytest.approx(0.5, abs=0.02)
    narrow = Expected(
        x_c, moving, np.full(3, 2.0), np.full(3, missed), math.log(0.1), np.array([-0.3, 0.3, -0.3, 0.3]), np.zeros((1, 3))
    )
    seeing = search(o, narrow, P)  # now only landmark 2 as seen from the second is in view
    second = seeing.probability[list(o.landmark[seeing.option[:, 0]]).index(1)]
    assert second == pytest.approx(0.2 / 1.2, abs=0.02)


def test_no_region_at_all() -> None:
    none = Options(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, 7)), np.zeros((0, 7, COLUMNS)), np.zeros(0))
    found = search(none, NOWHERE, np.eye(STATES))
    assert found.option.shape == (1, 0)
    assert found.probability.tolist() == [1.0]
