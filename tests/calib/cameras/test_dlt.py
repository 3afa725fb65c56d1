import numpy as np
import pytest

from calib.cameras import dlt
from calib.errors import CalibrationError
from models import so3
from models.messages import Array

K = np.array([[800.0, 0.0, 320.0], [0.0, 805.0, 240.0], [0.0, 0.0, 1.0]])
R_co = so3.matrix(so3.quat_exp(np.array([0.4, -2.2, 0.3])))
P_o = np.array([1.5, -0.4, 2.5])


def points(sigma_px: float = 0.0) -> tuple[Array, Array]:
    """Three planes at right angles, as on the thesis' calibration object, before the camera."""
    rng = np.random.default_rng(0)
    middle = P_o + 3.0 * R_co[2]
    faces = []
    for k in range(3):
        face = rng.uniform(-0.5, 0.5, (12, 3))
        face[:, k] = 0.5
        faces.append(middle + face)
    x_o = np.concatenate(faces)
    x_c = (x_o - P_o) @ R_co.T
    u = x_c @ K.T
    return x_o, u[:, :2] / u[:, 2:] + rng.normal(0.0, sigma_px, (36, 2))


def test_the_camera_matrix_and_its_parts_come_back() -> None:
    x_o, px = points()
    A = dlt.camera_matrix(x_o, px)
    assert A[2, 3] == 1.0
    np.testing.assert_allclose(dlt.project(A, x_o), px, atol=1e-8)
    parts = dlt.decompose(A)
    np.testing.assert_allclose(parts.K, K, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(parts.R_co, R_co, atol=1e-9)
    np.testing.assert_allclose(parts.p_o, P_o, atol=1e-9)


def test_the_equations_of_the_thesis_hold_as_they_are_written() -> None:
    x_o, px = points()
    A = dlt.camera_matrix(x_o, px)
    (X, Y, Z), (x, y) = x_o.T, px.T
    a = {f"a{row}{column + 1}": A[k, column] for k, row in enumerate((1, 2, 4)) for column in range(4)}
    ch4 = X * a["a41"] + Y * a["a42"] + Z * a["a43"] + a["a44"]
    np.testing.assert_allclose(x * ch4 - (X * a["a11"] + Y * a["a12"] + Z * a["a13"] + a["a14"]), 0.0, atol=1e-6)
    np.testing.assert_allclose(y * ch4 - (X * a["a21"] + Y * a["a22"] + Z * a["a23"] + a["a24"]), 0.0, atol=1e-6)
    parts = dlt.decompose(A)
    z_axis = parts.R_co[2]  # optical axis in the frame of the points
    assert np.tan(parts.pan) == pytest.approx(z_axis[1] / -z_axis[2])
    assert np.sin(parts.tilt) == pytest.approx(-z_axis[0])


def test_noise_moves_it_as_little_as_it_should() -> None:
    x_o, px = points(0.3)
    parts = dlt.decompose(dlt.camera_matrix(x_o, px))
    assert 1e-4 < np.abs(parts.p_o - P_o).max() < 0.1
    np.testing.assert_allclose(parts.K, K, rtol=0.03, atol=15.0)


def test_too_few_flat_or_unequal_points_are_refused() -> None:
    x_o, px = points()
    with pytest.raises(CalibrationError, match="6 or more"):
        dlt.camera_matrix(x_o[:5], px[:5])
    with pytest.raises(CalibrationError, match="6 or more"):
        dlt.camera_matrix(x_o, px[:7])
    with pytest.raises(CalibrationError, match="one plane"):
        dlt.camera_matrix(x_o[:12], px[:12])
