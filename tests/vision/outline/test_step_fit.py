"""Steps on profiles: where they are to a few hundredths of a pixel, alone, next to a wall's foot, next to a shadow."""

import numpy as np
import pytest
from scipy.special import ndtr

from vision.outline.step_fit import fit

HALF, POINTS = 5, 20
POSITION = np.arange(-HALF, HALF + 1.0)
ONE = np.zeros(POINTS, dtype=np.int64)


def run(grey: np.ndarray, gap: float = 0.0, farthest: float = 2.5) -> tuple[np.ndarray, float, float]:
    offsets, blur, opened = fit(grey, ONE, np.array([gap]), farthest, 1.0, np.ones(len(grey), dtype=np.bool_))
    return offsets, float(blur[0]), float(opened[0])


def step(s0: float, sigma: float, contrast: float = 80.0) -> np.ndarray:
    result: np.ndarray = contrast * ndtr((POSITION - s0) / sigma)
    return result


@pytest.mark.parametrize("sigma", [0.5, 0.9, 1.6])
@pytest.mark.parametrize("s0", [-1.3, 0.0, 0.45, 2.0])
@pytest.mark.parametrize("contrast", [-60.0, 60.0])
def test_one_step(s0: float, sigma: float, contrast: float) -> None:
    offsets, blur, _ = run(np.tile(100.0 + step(s0, sigma, contrast), (POINTS, 1)))
    np.testing.assert_allclose(offsets, s0, atol=0.01)
    assert blur == pytest.approx(sigma, rel=0.05)


def test_points_are_placed_one_by_one() -> None:
    """A turned edge: the mean profile is its middle, each point has its own shift."""
    truth = np.linspace(-0.4, 0.4, POINTS)
    offsets, _, _ = run(np.array([100.0 + step(s, 0.9) for s in truth]))
    np.testing.assert_allclose(offsets, truth, atol=0.03)


def test_noise_is_used_well() -> None:
    """Within 1.6 of the bound of a known step, sigma_s = noise / sqrt(sum (dg/ds)^2), and not below it."""
    rng, noise = np.random.default_rng(1), 4.0
    shape = step(0.2, 0.9)
    slope = (step(0.201, 0.9) - step(0.199, 0.9)) / 0.002
    spread = []
    for _ in range(60):
        offsets, _, _ = run(100.0 + shape + noise * rng.normal(size=(POINTS, len(POSITION))))
        assert np.isfinite(offsets).all()
        spread.append(np.std(offsets))
        assert abs(np.mean(offsets) - 0.2) < 0.1
    bound = noise / np.sqrt(np.sum(slope**2))
    assert 0.9 * bound < np.mean(spread) < 1.6 * bound


@pytest.mark.parametrize("gap", [1.0, 2.2, 4.0])
@pytest.mark.parametrize("levels", [(60.0, 40.0), (-70.0, 90.0), (50.0, -40.0)])
def test_a_wall_of_known_width(gap: float, levels: tuple[float, float]) -> None:
    """Roof, wall, ground: the roof's edge is found whatever the wall's brightness."""
    profile = 100.0 + step(0.3, 0.8, levels[0]) + step(0.3 + gap, 0.8, levels[1])
    offsets, _, opened = run(np.tile(profile, (POINTS, 1)), gap)
    np.testing.assert_allclose(offsets, 0.3, atol=0.1)
    assert 0.0 < opened < 0.5


def test_a_narrower_wall_leaves_more_open() -> None:
    opened = [run(np.tile(100.0 + step(0.0, 0.8, 60.0) + step(gap, 0.8, 40.0), (POINTS, 1)), gap)[2] for gap in (0.6, 1.5, 4.0)]
    assert opened[0] > 2.0 * opened[1] > 2.0 * opened[2]


def test_a_strip_of_shadow_of_unknown_width() -> None:
    """Roof 150, shadow 60, ground 110: one step through both would lie elsewhere."""
    profile = 150.0 + step(0.2, 0.7, -90.0) + step(3.2, 0.7, 50.0)
    offsets, _, _ = run(np.tile(profile, (POINTS, 1)))
    np.testing.assert_allclose(offsets, 0.2, atol=0.2)


@pytest.mark.parametrize(
    "profile", [np.full(11, 90.0), 90.0 + step(4.0, 0.7), 90.0 + step(0.0, 0.7, 2.0)], ids=["flat", "far off", "faint"]
)
def test_what_is_no_edge_here(profile: np.ndarray) -> None:
    offsets, _, _ = run(np.tile(profile, (POINTS, 1)), farthest=1.5)
    assert np.isnan(offsets).all()


def test_a_point_without_the_step_is_left_out() -> None:
    profiles = np.tile(100.0 + step(0.0, 0.8), (POINTS, 1))
    profiles[3] = 120.0
    offsets, _, _ = run(profiles)
    assert np.isnan(offsets[3])
    assert np.isfinite(np.delete(offsets, 3)).all()


def test_texture_makes_no_edge() -> None:
    """Roughness whose mean profile has more than the least contrast, without a step; with one it is found."""
    rng, found = np.random.default_rng(3), [0, 0]
    for _ in range(50):
        rough = 100.0 + 15.0 * rng.normal(size=(POINTS, len(POSITION)))
        for k, contrast in enumerate((0.0, 40.0)):
            found[k] += bool(np.isfinite(run(rough + step(0.3, 0.8, contrast))[0]).any())
    assert found[0] <= 5
    assert found[1] == 50
