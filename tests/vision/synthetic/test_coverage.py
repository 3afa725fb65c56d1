import numpy as np
import pytest

from vision.synthetic.coverage import coverage

W, H = 32, 24


def sampled(polygon: np.ndarray, n: int = 64) -> np.ndarray:
    """Coverage by point sampling, n x n a pixel: even-odd rule, written independently."""
    k = (np.arange(n) + 0.5) / n - 0.5
    v, u = np.meshgrid((np.arange(H)[:, None] + k).ravel(), (np.arange(W)[:, None] + k).ravel(), indexing="ij")
    inside = np.zeros(u.shape, dtype=bool)
    for (u0, v0), (u1, v1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if v0 != v1:
            inside ^= ((v0 > v) != (v1 > v)) & (u < u0 + (v - v0) * (u1 - u0) / (v1 - v0))
    return np.asarray(inside.reshape(H, n, W, n).mean(axis=(1, 3)))


def polygons() -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    result = []
    for k in range(40):
        corners = 3 + k % 6
        angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.9, corners)) / corners  # no gap: it stays simple
        radius = rng.uniform(0.5, 22.0, len(angle))
        centre = rng.uniform((-4, -4), (W + 4, H + 4))
        result.append(centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    return result


@pytest.mark.parametrize("polygon", polygons())
def test_area_of_every_pixel(polygon: np.ndarray) -> None:
    np.testing.assert_allclose(coverage(polygon, W, H), sampled(polygon), atol=0.03)
    np.testing.assert_allclose(coverage(polygon[::-1], W, H), coverage(polygon, W, H), atol=1e-5)


def test_total_is_the_polygons_area() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        polygon = rng.uniform((1, 1), (W - 2, H - 2), (3, 2))
        (a, b), (c, d) = polygon[1] - polygon[0], polygon[2] - polygon[0]
        assert coverage(polygon, W, H).sum() == pytest.approx(0.5 * abs(a * d - b * c), abs=2e-3)


def test_pixel_centres_are_at_integers() -> None:
    square = np.array([[3.5, 2.5], [7.5, 2.5], [7.5, 5.5], [3.5, 5.5]])
    expected = np.zeros((H, W))
    expected[3:6, 4:8] = 1.0
    np.testing.assert_allclose(coverage(square, W, H), expected, atol=1e-6)


def test_border_cuts_exactly() -> None:
    everything = np.array([[-900.0, -500.0], [800.0, -700.0], [900.0, 800.0], [-700.0, 900.0]])
    np.testing.assert_array_equal(coverage(everything, W, H), 1.0)
    shallow = np.array([[-50.0, 3.2], [90.0, 4.1], [90.0, 90.0], [-50.0, 90.0]])  # crosses both side borders within a row or so
    np.testing.assert_allclose(coverage(shallow, W, H), sampled(shallow), atol=0.03)


def test_not_a_number_covers_nothing() -> None:
    assert coverage(np.full((4, 2), np.nan), W, H).sum() == 0.0
