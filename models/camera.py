"""Pinhole camera with Brown distortion, and a stereo rig on the body.

    a = x / z,  b = y / z,  s = a^2 + b^2                                              (thesis eq. 3.21-3.23)
    g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)                                  (radial)
    a' = a g + 2 p1 a b + p2 (s + 2 a^2),   b' = b g + p1 (s + 2 b^2) + 2 p2 a b     (Brown 1966; eq. 3.29-3.31)
    u = fx a' + cx,   v = fy b' + cy                                                        (thesis eq. 3.26)

OpenCV's order k1 k2 p1 p2 [k3 [k4 k5 k6]]; pixel centres at integers, (u, v) = (column, row); c is right, down, forward.
"""

import math
from functools import cached_property

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

_COUNTS = (0, 4, 5, 8)  # coefficients a distortion may have
_NEWTON_STEPS = 30
_CONVERGED = 1e-13  # normalised plane: far below 1e-9 px


class CameraModel(msgspec.Struct, frozen=True, eq=False, dict=True):
    """Image size, focal lengths, principal point [px], distortion.

    covariance: (4 + n, 4 + n) of (fx, fy, cx, cy, *distortion), None = exact. Raises ValueError.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    covariance: Array | None = None

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not (all(map(math.isfinite, numbers)) and self.fx > 0 and self.fy > 0 and self.width > 0 and self.height > 0):
            raise ValueError("camera: image size and focal lengths must be positive, all parameters finite")
        if len(self.distortion) not in _COUNTS:
            raise ValueError(f"camera: {len(self.distortion)} distortion coefficients, expected one of {_COUNTS}")
        if self.covariance is not None and self.covariance.shape != (len(numbers), len(numbers)):
            raise ValueError(f"camera: covariance is {self.covariance.shape}, parameters are {len(numbers)}")

    @cached_property
    def matrix(self) -> Array:
        """K (3, 3): u = K @ (a', b', 1)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def parameters(self) -> Array:
        """fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 and the largest projected s, for kernels."""
        distortion = self.distortion + (0.0,) * (8 - len(self.distortion))
        return np.array([self.fx, self.fy, self.cx, self.cy, *distortion, _fold(distortion)])

    def project(self, x_c: Array) -> Array:
        """Pixels (N, 2) of x_c (N, 3) [m]; NaN behind the camera and beyond the lens model's fold."""
        return project(_points(x_c, 3), self.parameters)

    def project_jacobian(self, x_c: Array) -> Array:
        """d(u, v) / d(x_c): (N, 2, 3) [px/m]; NaN where project is."""
        return projected(_points(x_c, 3), self.parameters)[1]

    def parameter_jacobian(self, x_c: Array) -> Array:
        """d(u, v) / d(fx, fy, cx, cy, *distortion): (N, 2, 4 + n); NaN as project."""
        return parameter_jacobian(_points(x_c, 3), self.parameters)[:, :, : 4 + len(self.distortion)]

    def undistort(self, px: Array) -> Array:
        """(x/z, y/z) (N, 2) of pixels (N, 2), inverse of project; NaN where there is none."""
        return _undistort(_points(px, 2), self.parameters)

    def ray(self, px: Array) -> Array:
        """Unit direction (N, 3) in c of the points that pixels (N, 2) show."""
        ab = self.undistort(px)
        ray: Array = np.column_stack((ab, np.ones(len(ab))))
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        return ray

    def contains(self, px: Array, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Pixels (N, 2) at least margin_px inside the image; NaN is not."""
        low, high = margin_px - 0.5, np.array([self.width, self.height]) - 0.5 - margin_px
        inside: NDArray[np.bool_] = np.all((px >= low) & (px <= high), axis=1)
        return inside


class Mount(msgspec.Struct, frozen=True, eq=False):
    """Two cameras on a body, unchecked: x_r = R_rc @ x_c + t_rc (c left, r right), x_b = R_bc @ x_c + p_bc."""

    left: CameraModel
    right: CameraModel
    R_rc: Array
    t_rc: Array
    R_bc: Array
    p_bc: Array


class StereoRig(Mount, frozen=True, eq=False, dict=True):
    """A checked, calibrated mount.

    Covariances (6, 6), x y z rx ry rz, m^2 and rad^2, about the axes of the name's left frame (r, b): t_true = t + dt, R_true =
    exp(dtheta) @ R; None = exact. time_offset_s: shutter minus stamp. one_camera: the right camera is unused.
    """

    covariance_rc: Array | None = None
    covariance_bc: Array | None = None
    time_offset_s: float = 0.0
    one_camera: bool = False

    @classmethod
    def of_one(cls, camera: CameraModel, R_bc: Array, p_bc: Array, covariance_bc: Array | None) -> "StereoRig":
        """One camera on the body: x_b = R_bc @ x_c + p_bc."""
        return cls(camera, camera, np.eye(3), np.array([-1.0, 0.0, 0.0]), R_bc, p_bc, None, covariance_bc, 0.0, True)

    def __post_init__(self) -> None:
        for name, R, t in (("rc", self.R_rc, self.t_rc), ("bc", self.R_bc, self.p_bc)):
            if R.shape != (3, 3) or t.shape != (3,) or not (np.isfinite(R).all() and np.isfinite(t).all()):
                raise ValueError(f"stereo rig: pose {name} must be finite, rotation (3, 3) and translation (3,)")
            if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
                raise ValueError(f"stereo rig: R_{name} is not a rotation")
        for name, covariance in (("rc", self.covariance_rc), ("bc", self.covariance_bc)):
            if covariance is not None and covariance.shape != (6, 6):
                raise ValueError(f"stereo rig: covariance_{name} is {covariance.shape}, expected (6, 6)")

    @property
    def baseline_m(self) -> float:
        """Distance of the centres, L of Z = f L / disparity (thesis eq. 3.128)."""
        return float(np.linalg.norm(self.t_rc))

    def to_right(self, x_c: Array) -> Array:
        """x_r (N, 3) of x_c (N, 3)."""
        return x_c @ self.R_rc.T + self.t_rc

    def camera_pose(self, p_n: Array, R_nb: Array) -> tuple[Array, Array]:
        """Left camera: p_nc = p_n + R_nb p_bc, R_nc = R_nb R_bc."""
        return p_n + R_nb @ self.p_bc, R_nb @ self.R_bc

    def right_camera_pose(self, p_n: Array, R_nb: Array) -> tuple[Array, Array]:
        """Right camera: R_nr = R_nc R_rc^T, p_nr = p_nc - R_nr t_rc."""
        p_nc, R_nc = self.camera_pose(p_n, R_nb)
        R_nr = R_nc @ self.R_rc.T
        return p_nc - R_nr @ self.t_rc, R_nr


def _points(x: Array, columns: int) -> Array:
    points = np.ascontiguousarray(x, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != columns:
        raise ValueError(f"points have shape {points.shape}, expected (N, {columns})")
    return points


def _fold(distortion: tuple[float, ...]) -> float:
    """s = tan^2(angle) up to which r g(r^2) grows, inf if always.

    d(r g) / dr = ((P + 2 s P') Q - 2 s P Q') / Q^2, g = P / Q. Points beyond would be imaged twice.
    """
    k1, k2, _, _, k3, k4, k5, k6 = distortion
    if not any(distortion):
        return math.inf
    p, q = np.polynomial.Polynomial([1.0, k1, k2, k3]), np.polynomial.Polynomial([1.0, k4, k5, k6])
    two_s = np.polynomial.Polynomial([0.0, 2.0])
    slope = (p + two_s * p.deriv()) * q - two_s * p * q.deriv()
    zeros = np.concatenate((slope.trim().roots(), q.trim().roots()))
    folds = zeros.real[(np.abs(zeros.imag) < 1e-9 * np.abs(zeros)) & (zeros.real > 0)]
    return float(folds.min(initial=math.inf))


@njit(cache=True)
def _distort(a: float, b: float, k: Array) -> tuple[float, float, float, float, float]:
    """Distorted a', b' and the derivatives da'/da, da'/db = db'/da, db'/db."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11]
    s = a * a + b * b
    p = 1.0 + s * (k1 + s * (k2 + s * k3))
    q = 1.0 + s * (k4 + s * (k5 + s * k6))
    g = p / q
    slope = 2.0 * ((k1 + s * (2.0 * k2 + 3.0 * s * k3)) - g * (k4 + s * (2.0 * k5 + 3.0 * s * k6))) / q  # 2 dg/ds
    aa = g + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
    ab = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
    bb = g + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
    return a * g + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a), b * g + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b, aa, ab, bb


@njit(cache=True)
def project(x_c: Array, k: Array) -> Array:
    """CameraModel.project of x_c (N, 3), k: parameters; for kernels, as the next two."""
    px = np.full((x_c.shape[0], 2), np.nan)
    for i in range(x_c.shape[0]):
        if x_c[i, 2] > 0.0:
            a, b = x_c[i, 0] / x_c[i, 2], x_c[i, 1] / x_c[i, 2]
            if a * a + b * b < k[12]:
                da, db, _, _, _ = _distort(a, b, k)
                px[i, 0], px[i, 1] = k[0] * da + k[2], k[1] * db + k[3]
    return px


@njit(cache=True)
def projected(x_c: Array, k: Array) -> tuple[Array, Array]:
    """CameraModel.project (N, 2) and project_jacobian (N, 2, 3)."""
    px, jacobian = np.full((x_c.shape[0], 2), np.nan), np.full((x_c.shape[0], 2, 3), np.nan)
    for i in range(x_c.shape[0]):
        z = x_c[i, 2]
        if z > 0.0:
            a, b = x_c[i, 0] / z, x_c[i, 1] / z
            if a * a + b * b < k[12]:
                da, db, aa, ab, bb = _distort(a, b, k)
                px[i, 0], px[i, 1] = k[0] * da + k[2], k[1] * db + k[3]
                jacobian[i, 0, 0], jacobian[i, 0, 1], jacobian[i, 0, 2] = aa, ab, -(aa * a + ab * b)
                jacobian[i, 1, 0], jacobian[i, 1, 1], jacobian[i, 1, 2] = ab, bb, -(ab * a + bb * b)
                for row in range(2):  # an expression of arrays would compile for three seconds
                    for j in range(3):
                        jacobian[i, row, j] *= k[row] / z
    return px, jacobian


@njit(cache=True)
def parameter_jacobian(x_c: Array, k: Array) -> Array:
    """CameraModel.parameter_jacobian with all eight coefficients (N, 2, 12)."""
    jacobian = np.full((x_c.shape[0], 2, 12), np.nan)
    for i in range(x_c.shape[0]):
        if x_c[i, 2] > 0.0:
            a, b = x_c[i, 0] / x_c[i, 2], x_c[i, 1] / x_c[i, 2]
            s = a * a + b * b
            if s < k[12]:
                q = 1.0 + s * (k[9] + s * (k[10] + s * k[11]))
                g = (1.0 + s * (k[4] + s * (k[5] + s * k[8]))) / q
                da, db, _, _, _ = _distort(a, b, k)
                for row, f, x, square in ((0, k[0], a, s + 2.0 * a * a), (1, k[1], b, s + 2.0 * b * b)):
                    j = jacobian[i, row]
                    j[0], j[1], j[2], j[3] = 0.0, 0.0, 0.0, 0.0
                    j[row], j[2 + row] = (da, db)[row], 1.0
                    j[4], j[5], j[8] = f * x * s / q, f * x * s * s / q, f * x * s * s * s / q
                    j[6 + row], j[7 - row] = f * 2.0 * a * b, f * square
                    j[9], j[10], j[11] = -j[4] * g, -j[5] * g, -j[8] * g
    return jacobian


@njit(cache=True)
def _undistort(px: Array, k: Array) -> Array:
    """Newton from the distorted point, one-sided convergence up to the fold."""
    plane = np.full((px.shape[0], 2), np.nan)
    for i in range(px.shape[0]):
        u, v = (px[i, 0] - k[2]) / k[0], (px[i, 1] - k[3]) / k[1]
        a, b = u, v
        for _ in range(_NEWTON_STEPS):
            if not a * a + b * b < k[12]:
                break
            da, db, aa, ab, bb = _distort(a, b, k)
            du, dv = u - da, v - db
            if abs(du) + abs(dv) <= _CONVERGED * (1.0 + abs(u) + abs(v)):
                plane[i, 0], plane[i, 1] = a, b
                break
            det = aa * bb - ab * ab
            if det == 0.0:
                break
            a += (bb * du - ab * dv) / det
            b += (aa * dv - ab * du) / det
    return plane
