"""Camera matrix A from points known in space (thesis 3.5, 3.6).

    u (a41 X + a42 Y + a43 Z + a44) = a11 X + a12 Y + a13 Z + a14,   v (...) = a21 X + ... + a24       (thesis eq. 3.36-3.46)
    D F = R,   F = (D^T D)^-1 D^T R   with a44 = 1                                                      (eq. 3.49-3.51)
    A ~ K [R_co | t_co],   camera location p_o = -R_co^T t_co                                           (eq. 3.74-3.77)

(Abdel-Aziz and Karara 1971)
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import rq

from calib.errors import CalibrationError
from models.messages import Array

_FEWEST: Final = 6
_FLAT: Final = 1e-3  # thickness of the points' cloud over its length: flatter is a plane


@dataclass(frozen=True)
class Decomposition:
    """K (3, 3), K[2, 2] = 1, x_c = R_co @ (x_o - p_o); pan, tilt [rad] of the axis (thesis eq. 3.79, 3.80)."""

    K: Array
    R_co: Array
    p_o: Array
    pan: float
    tilt: float


def camera_matrix(x_o: Array, px: Array) -> Array:
    """A (3, 4) with A[2, 3] = 1 from x_o (N, 3) [m] at px (N, 2), N >= 6, not coplanar.

    Raises CalibrationError, also for a44 = 0.
    """
    if len(x_o) != len(px) or len(x_o) < _FEWEST:
        raise CalibrationError(f"{len(x_o)} points in space and {len(px)} in the image; {_FEWEST} or more of each are needed")
    spread = np.linalg.svd(x_o - x_o.mean(axis=0), compute_uv=False)
    if spread[2] < _FLAT * spread[0]:
        raise CalibrationError("the points lie in one plane: points on two or three planes are needed, or the chessboard method")
    to_o, to_px = _normalising(x_o), _normalising(px)
    X = np.column_stack((x_o, np.ones(len(x_o)))) @ to_o.T
    u, v = (np.column_stack((px, np.ones(len(px)))) @ to_px.T)[:, :2].T
    zero = np.zeros_like(X)
    D = np.vstack((np.hstack((X, zero, -u[:, None] * X[:, :3])), np.hstack((zero, X, -v[:, None] * X[:, :3]))))
    F = np.linalg.lstsq(D, np.concatenate((u, v)), rcond=None)[0]
    A = np.linalg.inv(to_px) @ np.append(F, 1.0).reshape(3, 4) @ to_o
    if abs(A[2, 3]) < 1e-9 * np.linalg.norm(A[2]):
        raise CalibrationError("the origin of the points is in the plane of the camera: move the origin")
    return np.asarray(A / A[2, 3])


def project(A: Array, x_o: Array) -> Array:
    """Pixels (N, 2) of points (N, 3)   (thesis eq. 3.39, 3.40)."""
    ch = np.column_stack((x_o, np.ones(len(x_o)))) @ A.T
    return np.asarray(ch[:, :2] / ch[:, 2:])


def decompose(A: Array) -> Decomposition:
    """Intrinsics, location, orientation; points are in front of the camera."""
    K, R = rq(A[:, :3])
    signs = np.diag(np.sign(np.diagonal(K)))
    K, R = K @ signs, signs @ R
    p_o = -np.linalg.solve(A[:, :3], A[:, 3])
    if np.linalg.det(R) < 0.0:  # A is known up to its sign
        R = -R
    third = A[2] * np.sign(A[2, :3] @ R[2])
    pan = float(np.arctan2(third[1], -third[2]))
    tilt = float(np.arcsin(np.clip(-third[0] / np.linalg.norm(third[:3]), -1.0, 1.0)))
    return Decomposition(np.asarray(K / K[2, 2]), np.asarray(R), np.asarray(p_o), pan, tilt)


def _normalising(x: Array) -> Array:
    d = x.shape[1]
    scale = np.sqrt(d) / np.mean(np.linalg.norm(x - x.mean(axis=0), axis=1))
    T: Array = np.eye(d + 1) * scale
    T[:d, d], T[d, d] = -scale * x.mean(axis=0), 1.0
    return T
