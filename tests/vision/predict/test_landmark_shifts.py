"""Pose and map errors from places of landmarks: the same as one large least-squares problem, and as the camera's derivatives."""

import numpy as np
import pytest

from models import so3
from models.camera import CameraModel
from vision.predict.landmark_shifts import motions, shifted
from vision.predict.motion import moved

RNG = np.random.default_rng(5)
CAMERA = CameraModel(160, 120, 150.0, 148.0, 79.5, 59.5)


def test_motions_are_the_mean_of_the_points_of_a_landmark() -> None:
    R_nk = so3.matrix(so3.from_euler(0.1, -0.2, 1.0))
    x_c = RNG.uniform((-5.0, -5.0, 20.0), (5.0, 5.0, 40.0), (9, 3))
    p_n, p_nk, mark = RNG.normal(size=3), RNG.normal(size=3), np.array([0, 0, 0, 0, 2, 2, 2, 2, 2])
    points_n = p_nk + x_c @ R_nk.T
    D = motions(points_n, p_n, p_nk, R_nk, mark, 3, CAMERA.fx, CAMERA.fy)
    every = moved(CAMERA, x_c, points_n - p_n, R_nk)
    np.testing.assert_allclose(D[0], every[:4].mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(D[2], every[4:].mean(axis=0), atol=1e-9)
    assert not D[1].any()


@pytest.mark.parametrize("trusted", [(True, True, True, True), (True, False, True, False), (False,) * 4])
def test_settled_is_the_joint_least_squares_solution(trusted: tuple[bool, ...]) -> None:
    """x = (dx, m) minimises |P^-1/2 dx|^2 + |m / s|^2 + |(y - D dx + D_p m) / e|^2 over the landmarks that are trusted."""
    root = RNG.normal(size=(6, 6))
    P, sigma, position_px = root @ root.T, np.array([0.3, 0.5, 0.2, 0.7]), 1.7
    D, found, error = RNG.normal(size=(4, 2, 6)) * 5.0, RNG.normal(size=(4, 2)) * 9.0, RNG.normal(size=6)
    rows, right = [np.hstack((np.linalg.inv(np.linalg.cholesky(P)), np.zeros((6, 8))))], [np.zeros(6)]
    rows.append(np.hstack((np.zeros((8, 6)), np.diag(1.0 / np.repeat(sigma, 2)))))
    right.append(np.zeros(8))
    for m in np.flatnonzero(trusted):
        row = np.zeros((2, 14))
        row[:, :6], row[:, 6 + 2 * m : 8 + 2 * m] = D[m], -D[m, :, :2]
        rows.append(row / position_px)
        right.append((found[m] + D[m] @ error) / position_px)
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    total, shift_m = shifted(D, found, np.array(trusted), sigma, position_px, error, P)
    np.testing.assert_allclose(total, best[:6], atol=1e-8)
    np.testing.assert_allclose(shift_m, best[6:].reshape(4, 2), atol=1e-8)
