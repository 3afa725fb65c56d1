"""Lines of edges and their covariance: robust, and as large as the errors are."""

import numpy as np
import pytest

from vision.outline.edge_lines import compress, fit_lines
from vision.outline.edge_noise import NoiseConfig, line_covariance
from vision.outline.visibility import Kind

EDGES, POINTS = 12, 16
EDGE = np.repeat(np.arange(EDGES), POINTS)
T = np.tile((np.arange(POINTS) + 0.5) / POINTS, EDGES)


def test_a_line_with_outliers() -> None:
    rng = np.random.default_rng(1)
    offsets = 0.7 - 0.4 * (2.0 * T - 1.0) + rng.normal(0.0, 0.05, len(T))
    offsets[::7] += 3.0
    offsets[3] = np.nan
    lines = fit_lines(offsets, 2.0 * T - 1.0, EDGE, EDGES, 4)
    assert lines.found.all()
    np.testing.assert_allclose(lines.line, np.tile([0.7, -0.4], (EDGES, 1)), atol=0.09)
    assert (lines.weight[::7] < 0.05).all()
    np.testing.assert_allclose(compress(lines.gain, np.nan_to_num(offsets)[:, None], EDGE, EDGES)[:, :, 0], lines.line, atol=0.02)


def test_too_few_points_make_no_line() -> None:
    offsets = np.full(len(T), np.nan)
    offsets[:3] = 0.5
    offsets[POINTS : 2 * POINTS] = 0.5
    lines = fit_lines(offsets, 2.0 * T - 1.0, EDGE, EDGES, 4)
    assert lines.found.tolist() == [False, True] + [False] * (EDGES - 2)
    assert not lines.gain[:POINTS].any()


def made(rng: np.random.Generator, white: float, texture: float, neighbours: float, common: float) -> np.ndarray:
    """Offsets (2, N) of two images: noise of the sensor each, texture that runs along the edge and a common offset in both."""
    rough = rng.normal(size=len(T))
    for i in range(1, len(T)):
        if EDGE[i] == EDGE[i - 1]:
            rough[i] = neighbours * rough[i - 1] + np.sqrt(1.0 - neighbours**2) * rough[i]
    shared = texture * rough + common * rng.normal(size=EDGES)[EDGE]
    result: np.ndarray = shared + white * rng.normal(size=(2, len(T)))
    return result


@pytest.mark.parametrize(("white", "texture", "neighbours"), [(0.1, 0.02, 0.0), (0.03, 0.1, 0.3), (0.05, 0.15, 0.5)])
def test_covariance_is_as_large_as_the_errors(white: float, texture: float, neighbours: float) -> None:
    """Mean squared offset, tilt and difference of the images, over what is claimed: near 1 in each."""
    rng = np.random.default_rng(7)
    config = NoiseConfig(offset_share=0.3, tilt_share=0.0)
    kind = np.full(EDGES, Kind.ROOF, dtype=np.int64)
    scatter = np.hypot(white, texture)
    ratios = []
    for _ in range(60):
        offsets = made(rng, white, texture, neighbours, 0.3 * scatter)
        lines = [fit_lines(each, 2.0 * T - 1.0, EDGE, EDGES, 4) for each in offsets]
        V = line_covariance(lines, EDGE, kind, np.zeros((2, EDGES)), config)
        a, b = lines[0].line, lines[1].line
        between = V[:, 0, 0, 0, 0] + V[:, 1, 0, 1, 0] - 2.0 * V[:, 0, 0, 1, 0]
        ratios.append([a[:, 0] ** 2 / V[:, 0, 0, 0, 0], a[:, 1] ** 2 / V[:, 0, 1, 0, 1], (a - b)[:, 0] ** 2 / between])
    offset, tilt, difference = np.mean(ratios, axis=(0, 2))
    assert 0.6 < offset < 1.8
    assert 0.5 < tilt < 1.8
    assert 0.15 < difference < 1.6


def test_what_a_gap_leaves_open_and_base_edges_count_more() -> None:
    rng = np.random.default_rng(3)
    lines = [fit_lines(each, 2.0 * T - 1.0, EDGE, EDGES, 4) for each in made(rng, 0.05, 0.05, 0.0, 0.0)]
    kind = np.repeat([Kind.ROOF, Kind.BASE, Kind.UPRIGHT], EDGES // 3).astype(np.int64)
    opened = np.zeros((2, EDGES))
    opened[:, 0] = 0.25
    V = line_covariance(lines, EDGE, kind, opened, NoiseConfig())
    variance = V[:, 0, 0, 0, 0]
    assert variance[0] - variance[1] == pytest.approx(0.25, abs=0.01)
    assert variance[4:8].min() > 0.09 > 0.0225 + 0.01 > variance[1:4].max()
    assert (np.linalg.eigvalsh(V.reshape(EDGES, 4, 4)) > 0.0).all()
