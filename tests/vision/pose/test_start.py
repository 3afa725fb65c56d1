"""The start of the pose fit: from centres and sizes of regions, the prior and what the map may be off."""

import numpy as np
import pytest

from benchmarks.fixes.single_fix_start import centroid_and_size, start_from_regions
from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from tests.vision.roofs import nadir_rig
from vision.pose.sensitivity import eyes

RIG = nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
EYE = eyes(RIG)[0]
CORNERS = np.array([(-0.6, -1.0), (-0.6, 1.0), (0.6, 1.0), (0.6, -1.0)])
R_NB = so3.matrix(so3.from_euler(0.05, -0.1, 0.8))
P_N = np.array([0.3, -0.2, -12.0])


def marks(sigma_m: float = 0.0) -> list[Landmark]:
    positions = [(0.0, 0.0), (2.0, -2.5), (-2.0, 2.0)]
    return [Landmark.of(str(k), CORNERS + np.array(position), 0.0, 0.5, sigma_m=sigma_m) for k, position in enumerate(positions)]


def regions(true: list[Landmark]) -> tuple[Array, Array]:
    p, R = EYE.pose(P_N, R_NB)
    seen = [centroid_and_size(EYE.camera.project((np.column_stack((m.outline_n, np.full(4, m.roof_d))) - p) @ R)) for m in true]
    return np.array([centre for centre, _ in seen]), np.array([size for _, size in seen])


def prior(error: Array) -> Prior:
    sigma = np.array([5.0, 5.0, 3.0, *np.radians([0.5, 0.5, 2.0])])
    q = so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(R_NB))
    return Prior(P_N - error[:3], so3.normalise(q), np.diag(sigma**2))


@pytest.mark.parametrize("error", [(4.0, -3.0, 1.0, 0.0, 0.0, 0.03), (-6.0, 5.0, -3.0, 0.005, -0.01, -0.04)])
def test_roofs_lie_where_the_regions_are(error: tuple[float, ...]) -> None:
    """A prior metres off, at 12 m height: outlines come to within three pixels."""
    true = marks()
    p_n, R_nb, shift = start_from_regions(EYE, true, *regions(true), prior(np.array(error)))
    p, R = EYE.pose(p_n, R_nb)
    q, T = EYE.pose(P_N, R_NB)
    for mark in true:
        roof = np.column_stack((mark.outline_n, np.full(4, mark.roof_d)))
        np.testing.assert_allclose(EYE.camera.project((roof - p) @ R), EYE.camera.project((roof - q) @ T), atol=3.0)
    assert np.abs(shift).max() < 1e-3


def test_shifts_of_landmarks_are_found() -> None:
    """Half a metre is 25 pixels here: more than a search reaches."""
    mapped = marks(0.5)
    off = np.array([(0.4, 0.0), (0.0, -0.5), (-0.3, 0.3)])
    true = [Landmark.of(m.id, m.outline_n + d, 0.0, 0.5) for m, d in zip(mapped, off, strict=True)]
    p_n, R_nb, shift = start_from_regions(EYE, mapped, *regions(true), prior(np.zeros(6)))
    p, R = EYE.pose(p_n, R_nb)
    q, T = EYE.pose(P_N, R_NB)
    for k, mark in enumerate(mapped):
        there = np.array([*np.mean(mark.outline_n + shift[k, :2], axis=0), mark.roof_d])
        truth = np.array([*np.mean(true[k].outline_n, axis=0), mark.roof_d])
        np.testing.assert_allclose(
            EYE.camera.project(((there - p) @ R)[None]), EYE.camera.project(((truth - q) @ T)[None]), atol=3.0
        )
    np.testing.assert_allclose(shift[0, :2] - shift[1, :2], off[0] - off[1], atol=0.2)


def test_a_region_cut_off_gives_no_size() -> None:
    true = marks()
    centres, sizes = regions(true)
    sizes[:] = np.nan
    p_n, _, _ = start_from_regions(EYE, true, centres, sizes, prior(np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])))
    np.testing.assert_allclose(p_n[:2], P_N[:2], atol=0.4)
