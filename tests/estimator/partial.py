"""Fixes in part for the estimator's tests: a landmark seen from afar."""

from collections.abc import Sequence

import numpy as np

from models import so3
from models.measurements import DIRECTION_SCALE
from models.messages import Array, LandmarkFix, PoseFix, vec3


def point_rows(away_n: Array) -> Array:
    """(3, 6): where a point is as the vehicle sees it, dp - [away]x dtheta, of a point `away_n` from it, in axes of n."""
    return np.hstack((np.eye(3), -so3.skew(np.asarray(away_n, dtype=float))))


def orthonormal(rows: Array) -> Array:
    """Directions (r, 6) that span the rows."""
    q, _ = np.linalg.qr((rows / DIRECTION_SCALE).T)
    return np.asarray(q.T * DIRECTION_SCALE)


def not_measured(directions: Array) -> Array:
    """(6 - r, 6): unit errors of the pose that the directions do not show."""
    _, _, v = np.linalg.svd(directions / DIRECTION_SCALE)
    return np.asarray(v[len(directions) :] / DIRECTION_SCALE)


def in_part(fix: PoseFix, directions: Array, off: Array, names: Sequence[str] = ("roof",)) -> LandmarkFix:
    """A fix reported along directions only; off (6 - r,): where it stands in the others, m."""
    away = not_measured(directions).T @ off
    turned = so3.multiply(so3.quat_exp(away[3:]), np.array(fix.q_nb_wxyz))
    w, x, y, z = so3.normalise(turned).tolist()
    wide = not_measured(directions)
    covariance = fix.covariance + 1e4 * wide.T @ wide
    return LandmarkFix(
        fix.t_ns, fix.arrived_ns, vec3(np.add(fix.p_n, away[:3])), (w, x, y, z), covariance, None, tuple(names), 0.9, 0.3,
        directions=directions,
    )  # fmt: skip
