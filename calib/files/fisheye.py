"""Fisheye: the equidistant model as an equal rational one, below 90 degrees.

r_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),  theta = atan r    (Kannala & Brandt 2006)
~ r (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
"""

import numpy as np
from scipy.optimize import least_squares

from calib.errors import CalibrationError
from models.camera import CameraModel
from models.messages import Array

_WIDEST = np.deg2rad(80.0)  # half the field of view
_WORST_PX = 0.2  # by which the rational model may differ


def rational(fx: float, fy: float, cx: float, cy: float, k: Array, size: tuple[int, int]) -> CameraModel:
    """The rational camera equal to an equidistant one. Raises CalibrationError."""
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], [size[0], size[1]]]) - 0.5
    r_corner = float(np.linalg.norm((corners - (cx, cy)) / (fx, fy), axis=1).max())
    theta = np.linspace(0.0, _WIDEST, 2000)[1:]
    r_d = theta * (1.0 + theta**2 * (k[0] + theta**2 * (k[1] + theta**2 * (k[2] + theta**2 * k[3]))))
    beyond = np.flatnonzero((r_d > 1.02 * r_corner) | (np.diff(r_d, prepend=0.0) <= 0.0))
    inside = slice(0, int(beyond[0]) if len(beyond) else len(theta))
    if not len(beyond) or r_d[inside][-1] < 0.98 * r_corner:
        raise CalibrationError("the lens sees more than 80 degrees aside in the image's corners; crop the images")
    r, target = np.tan(theta[inside]), r_d[inside]
    s = r * r

    def ratio(c: Array) -> Array:
        return np.asarray(r * (1.0 + s * (c[0] + s * (c[1] + s * c[2]))) / (1.0 + s * (c[3] + s * (c[4] + s * c[5]))))

    def difference(c: Array) -> Array:
        return np.asarray(ratio(c) - target)

    # Linear in the coefficients once multiplied out; then the difference itself is made small.
    A = np.column_stack((r * s, r * s**2, r * s**3, -target * s, -target * s**2, -target * s**3)) / (1.0 + s[:, None] ** 3)
    first = np.linalg.lstsq(A, (target - r) / (1.0 + s**3), rcond=None)[0]
    c = least_squares(difference, first, x_scale="jac").x
    worst = float(np.abs(ratio(c) - target).max()) * max(fx, fy)
    if not worst < _WORST_PX:
        raise CalibrationError(f"the lens cannot be written as a rational model ({worst:.1f} px off); crop the images")
    return CameraModel(*size, fx, fy, cx, cy, (float(c[0]), float(c[1]), 0.0, 0.0, *(float(x) for x in c[2:])))
