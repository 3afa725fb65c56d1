"""Motion between two stereo pairs from points y = (u_l, v_l, u_r), by Gauss-Newton (docs/odometry_frontend.md).

    z_0 = y + i delta + e_0,   z_1 = g(y; T) + i delta + e_1,   g = h o T^-1 o h^-1,   i = (0, 0, 1)   (two views of each point)
    d(y) = f b pi^T m(y) + e_d,   m = ((u_l - c_x) / f, (v_l - c_y) / f, 1)                           (ground plane, optional)

h: camera point to y; T: body pose at t1 in the body at t0; delta: common disparity error; pi = n / height. Points eliminated: C^T
S^-1 C each, S = R_1 + G R_0 G^T, G = dg/dy, C = dg/d(T, delta, pi) (Triggs et al. 2000). Of the normal matrix N, L by the priors
of delta and height: systematic N^-1 L (prior - truth); new in each step N^-1 (N - L) N^-1. p_true = p + dp, R_true = R
exp(theta).
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from models import so3
from models.camera import StereoRig
from models.messages import Array

_ITERATIONS: Final = 25
_CONVERGED: Final = 0.03  # of the step's own standard deviation
_CAUCHY: Final = 2.5  # sigma, of three values
_GUIDED: Final = 4.0  # the same where a guide is given
_ABOVE: Final = 0.5  # the same of the plane, for points above it
_MEDIAN_CHI2: Final = 2.366  # of three values
_NOTHING_PX2: Final = 1e8  # variance of what was not measured
_LEAST_DISPARITY_PX: Final = 0.05  # that a point may have
_COLUMN: Final = np.array([0.0, 0.0, 1.0])  # i: of u_r among (u_l, v_l, u_r)


@dataclass(frozen=True, slots=True)
class Motion:
    """Pose of the body at t1 in the body at t0: x_b0 = R x_b1 + p."""

    p: Array
    R: Array


@dataclass(frozen=True, slots=True)
class Plane:
    """Ground from the first camera: n (3,) down, height, sigma [m], slope [rad], scatter [m]."""

    n: Array
    height_m: float
    height_sigma_m: float
    slope_rad: float
    roughness_m: float

    @property
    def pi(self) -> Array:
        """n / height."""
        pi: Array = self.n / self.height_m
        return pi

    @property
    def information(self) -> Array:
        """Inverse covariance (3, 3) of pi: along n from the height, across it from the slope."""
        along = np.outer(self.n, self.n)
        across = np.eye(3) - along
        information: Array = (
            along * (self.height_m**2 / self.height_sigma_m) ** 2 + across * (self.height_m / self.slope_rad) ** 2
        )
        return information


class Solution(NamedTuple):
    """covariance (6, 6): new in this step; squared distances (N,); residual scale, 1: as expected.

    systematic (6, 2): motion - truth for disparities, height 1 sigma too large; residuals (N, 2): of (u_l, v_l) at t1, in sigma.
    """

    motion: Motion
    covariance: Array
    systematic: Array
    residuals: Array
    distances: Array
    scale: float
    converged: bool


class Geometry:
    """A rectified rig: pixels y of points x_c of the left camera, and back."""

    def __init__(self, rig: StereoRig) -> None:
        camera = rig.left
        self.f, self.cx, self.cy, self.b = camera.fx, camera.cx, camera.cy, rig.baseline_m
        self.shift = camera.cx - rig.right.cx
        self.R_bc, self.p_bc = rig.R_bc, rig.p_bc

    def disparity(self, y: Array) -> Array:
        """d = f b / z, (N,)."""
        d: Array = y[:, 0] - y[:, 2] - self.shift
        return d

    def points(self, y: Array) -> tuple[Array, Array]:
        """x_c (N, 3) and dx_c/dy (N, 3, 3)."""
        d = np.maximum(self.disparity(y), _LEAST_DISPARITY_PX)
        z = self.f * self.b / d
        m = np.column_stack(((y[:, 0] - self.cx) / self.f, (y[:, 1] - self.cy) / self.f, np.ones(len(y))))
        x = m * z[:, None]
        J = np.zeros((len(y), 3, 3))
        J[:, :, 0] = -x / d[:, None]
        J[:, :, 2] = x / d[:, None]
        J[:, 0, 0] += z / self.f
        J[:, 1, 1] = z / self.f
        return x, J

    def project(self, x: Array) -> tuple[Array, Array]:
        """y (N, 3) and dy/dx_c (N, 3, 3)."""
        z = x[:, 2]
        k = self.f / z
        y = np.column_stack((k * x[:, 0] + self.cx, k * x[:, 1] + self.cy, k * (x[:, 0] - self.b) + self.cx - self.shift))
        J = np.zeros((len(x), 3, 3))
        J[:, 0, 0] = J[:, 1, 1] = J[:, 2, 0] = k
        J[:, 0, 2] = -k * x[:, 0] / z
        J[:, 1, 2] = -k * x[:, 1] / z
        J[:, 2, 2] = -k * (x[:, 0] - self.b) / z
        return y, J

    def seen_from(self, motion: Motion, x_c: Array) -> tuple[Array, Array]:
        """Points (N, 3) of the first camera in the second body (N, 3) and camera (N, 3)."""
        x_b1 = (x_c @ self.R_bc.T + self.p_bc - motion.p) @ motion.R
        return x_b1, (x_b1 - self.p_bc) @ self.R_bc

    def plane_disparity(self, y: Array, pi: Array) -> tuple[Array, Array]:
        """f b pi^T m (N,) and its derivative to pi (N, 3)."""
        m = np.column_stack(((y[:, 0] - self.cx) / self.f, (y[:, 1] - self.cy) / self.f, np.ones(len(y))))
        J = self.f * self.b * m
        d: Array = J @ pi
        return d, J


def solve(
    geometry: Geometry,
    y0: Array,
    y1: Array,
    sigma_px: float,
    disparity_sigma_px: float,
    start: Motion,
    plane: Plane | None,
    *,
    guide: Array | None = None,
) -> Solution:
    """Motion from measurements (N, 3) of N points; NaN in u_r: not measured (needs a plane); sigma_px: of each value.

    guide: information (6, 6) about the start: selects one of several motions.
    """
    z0, variance0 = _filled(geometry, y0, sigma_px, plane)
    variance1 = np.where(np.isfinite(y1), sigma_px**2, _NOTHING_PX2)
    prior = _prior(disparity_sigma_px, plane)
    if guide is not None:
        prior[:6, :6] = guide
    unknowns = np.zeros(len(prior))
    y, motion, pi = z0, start, None if plane is None else plane.pi
    for _ in range(_ITERATIONS if len(y0) else 0):
        shifted = z0 - unknowns[6] * _COLUMN
        try:
            system = _linearised(geometry, y, motion, unknowns[6], pi, plane, (shifted, variance0, y1, variance1))
        except np.linalg.LinAlgError:  # points at infinity or behind the camera: it runs away
            break
        both = np.concatenate((system.C, system.e[:, :, None]), axis=2)
        weighted = np.matmul(system.S_inverse, both)
        distances: Array = (system.e * weighted[:, :, -1]).sum(axis=1)
        weights, scale = _weights(distances, guide is not None)
        weighted *= weights[:, None, None]
        rows = both.shape[2]
        sums = both.reshape(-1, rows).T @ weighted.reshape(-1, rows)
        N, right = sums[:-1, :-1] + prior, sums[:-1, -1] - prior @ unknowns
        try:
            L = np.linalg.cholesky(N)
        except np.linalg.LinAlgError:
            break
        step: Array = np.asarray(np.linalg.solve(N, right), np.float64)
        if not np.isfinite(step).all():
            break
        unknowns = unknowns + step  # of p and theta to the first order, which is enough for a guide
        y = _points_after(z0 - unknowns[6] * _COLUMN, variance0, system, step)
        motion = Motion(motion.p + step[:3], motion.R @ so3.matrix(so3.quat_exp(step[3:6])))
        pi = None if plane is None else plane.pi + unknowns[7:]
        if np.linalg.norm(L.T @ step) < _CONVERGED:
            return Solution(
                motion, *_errors(N, disparity_sigma_px, plane), system.e[:, :2] / system.sigma, distances, scale, True
            )
    nothing = np.full((6, 6), np.nan)
    return Solution(motion, nothing, nothing[:, :2], np.zeros((len(y0), 2)), np.full(len(y0), np.inf), np.inf, False)


def _prior(disparity_sigma_px: float, plane: Plane | None) -> Array:
    prior = np.zeros((7, 7) if plane is None else (10, 10))
    prior[6, 6] = disparity_sigma_px**-2
    if plane is not None:
        prior[7:, 7:] = plane.information
    return prior


def _errors(N: Array, disparity_sigma_px: float, plane: Plane | None) -> tuple[Array, Array]:
    """Covariance (6, 6) new in each step, symmetric, and systematic part (6, 2); N is scaled by diag(N)^-1/2."""
    units = np.diag(N) ** -0.5
    P = units[:, np.newaxis] * np.linalg.inv(N * np.outer(units, units)) * units
    P = 0.5 * (P + P.T)
    systematic = np.zeros((6, 2))
    systematic[:, 0] = P[:6, 6] / disparity_sigma_px  # delta is that of u_r: positive makes disparities smaller
    if plane is not None:
        systematic[:, 1] = P[:6, 7:] @ plane.n * (-(plane.height_m**2) / plane.height_sigma_m)
    return P[:6, :6] - systematic @ systematic.T, systematic


class _System(NamedTuple):
    """e (N, r), C (N, r, unknowns), G (N, r, 3), S^-1 (N, r, r), sigmas (N, 2); r = 3, or 4 with a plane."""

    e: Array
    C: Array
    G: Array
    S_inverse: Array
    sigma: Array


def _filled(geometry: Geometry, y0: Array, sigma_px: float, plane: Plane | None) -> tuple[Array, Array]:
    """Measurements of the first pair (N, 3); a missing u_r is taken on the plane, without weight."""
    missing = ~np.isfinite(y0[:, 2])
    z0, variance = y0.copy(), np.full(y0.shape, sigma_px**2)
    if missing.any():
        assert plane is not None
        d, _ = geometry.plane_disparity(y0[missing], plane.pi)
        z0[missing, 2] = y0[missing, 0] - geometry.shift - d
        variance[missing, 2] = _NOTHING_PX2
    return z0, variance


def _linearised(
    geometry: Geometry,
    y: Array,
    motion: Motion,
    delta: float,
    pi: Array | None,
    plane: Plane | None,
    measured: tuple[Array, Array, Array, Array],
) -> _System:
    """e = z_1 - g(y) - i delta - G (z_0 - i delta - y), the point eliminated; z_0 without delta."""
    z0, variance0, y1, noise = measured
    x, X_y = geometry.points(y)
    x_b1, x_c1 = geometry.seen_from(motion, x)
    predicted, P_x = geometry.project(x_c1)
    predicted = predicted + delta * _COLUMN
    R_bc = geometry.R_bc
    G = P_x @ (R_bc.T @ motion.R.T @ R_bc) @ X_y
    C = np.zeros((len(y), 3, 7))
    C[:, :, :3] = P_x @ (-R_bc.T @ motion.R.T)
    C[:, :, 3:6] = P_x @ R_bc.T @ _skews(x_b1)
    C[:, :, 6] = _COLUMN - G[:, :, 2]
    e = np.where(np.isfinite(y1), y1, predicted) - predicted
    if plane is not None and pi is not None:
        e, C, G, noise = _with_plane(geometry, y, pi, plane, (e, C, G, noise))
    e = e - np.einsum("nrk,nk->nr", G, z0 - y)
    S = np.matmul(G * variance0[:, None, :], G.transpose(0, 2, 1))
    index = np.arange(S.shape[1])
    S[:, index, index] += noise
    return _System(e, C, G, np.linalg.inv(S), np.sqrt(S[:, [0, 1], [0, 1]]))


def _with_plane(
    geometry: Geometry, y: Array, pi: Array, plane: Plane, rows: tuple[Array, Array, Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """With the row 0 = d(y) - f b pi^T m(y), asymmetric weights: corners stand above ground."""
    e, C, G, noise = rows
    d, D_pi = geometry.plane_disparity(y, pi)
    off = d - geometry.disparity(y)
    sigma = d * d * plane.roughness_m / (geometry.f * geometry.b)
    variance = sigma**2 + (off / np.where(off < 0.0, _ABOVE, _CAUCHY)) ** 2
    row = np.array([1.0 - geometry.b * pi[0], -geometry.b * pi[1], -1.0])
    C_4 = np.zeros((len(y), 4, 10))
    C_4[:, :3, :7] = C
    C_4[:, 3, 6] = -row[2]
    C_4[:, 3, 7:] = -D_pi
    with_row = np.concatenate((G, np.broadcast_to(row, (len(y), 1, 3))), axis=1)
    return np.column_stack((e, off)), C_4, with_row, np.column_stack((noise, variance))


def _weights(distances: Array, guided: bool) -> tuple[Array, float]:
    """Weights (N,): Cauchy; guided: Geman and McClure; and residual scale."""
    if guided:
        redescending: Array = 1.0 / (1.0 + distances / _GUIDED**2) ** 2
        return redescending, 1.0
    scale = max(float(np.median(distances)) / _MEDIAN_CHI2, 1.0)
    weights: Array = 1.0 / (1.0 + distances / (_CAUCHY**2 * scale))
    return weights, float(np.sqrt(scale))


def _points_after(z0: Array, variance0: Array, system: _System, step: Array) -> Array:
    """y = z_0 - i delta + R_0 G^T S^-1 (e - C step); z_0 without delta."""
    left_over = system.e - system.C @ step
    weighted = np.matmul(system.S_inverse, left_over[:, :, None])
    moved: Array = z0 + variance0 * np.matmul(system.G.transpose(0, 2, 1), weighted)[:, :, 0]
    return moved


def _skews(x: Array) -> Array:
    S = np.zeros((len(x), 3, 3))
    S[:, 0, 1], S[:, 0, 2] = -x[:, 2], x[:, 1]
    S[:, 1, 0], S[:, 1, 2] = x[:, 2], -x[:, 0]
    S[:, 2, 0], S[:, 2, 1] = -x[:, 1], x[:, 0]
    return S
