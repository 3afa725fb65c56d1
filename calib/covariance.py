"""Covariance of a bundle adjustment's shared unknowns s where corners err together: within a view, or alike in all views.

    C = sigma^2 H^-1,   sigma^2 = r^T r / redundancy,   H = sum H_i over the views, their poses eliminated (bundle.py)

is honest while errors of corners are independent. A board that bends or moves makes those of a view agree. Then leaving views
out, one Newton step each, d_i = (H - H_i)^-1 g_i (jackknife, Efron 1982), moves s further than C says:

    f = sum_i d_i^T H d_i / (sigma^2 sum_i tr((H - H_i)^-1 H_i)),   J = (n - 1) / n sum_i (d_i - mean) (d_i - mean)^T

f is known well, direction by direction J is not: n views tell n - 1. So C is widened by f, and along the directions in which J is
larger still, the eigenvectors of J in units of f C with eigenvalues lambda > 1, by lambda: what errors have in common, they do to
some parameters more than to others.

A board bowed alike in all views, z_o = b_1 x^2 + b_2 x y + b_3 y^2, is not seen by leaving views out. So b is estimated in one
more Newton step, and where it is seen, what it does to the solution, d = H^-1 H_sb b, is added: C + d d^T.
"""

from typing import Final, NamedTuple

import numpy as np

from models.messages import Array

_INDEPENDENT: Final = 1.2  # f up to which errors count as independent from corner to corner
_UNSOLVABLE: Final = 1e13  # condition of H - H_i
_BOW_SEEN: Final = 21.1  # chi-square of 3, 1e-4


class Spread(NamedTuple):
    """How well s (m,) is known: covariance (m, m), f, and the variance's mean factor over sigma^2 H^-1."""

    covariance: Array
    f: float
    widened: float


def marginal(H_i: Array, g_i: Array, sigma2: float) -> Spread:
    """C from the views' parts of the normal equations (n, m, m), (n, m); sigma2: variance of a corner's coordinate [px^2]."""
    H = H_i.sum(axis=0)
    scale, inverse = _scale(H), _inverse(H)
    over = np.outer(scale, scale)
    d, expected = _left_out(H_i / over, g_i / scale)
    f = float(np.einsum("ij,jk,ik", d, H / over, d)) / (sigma2 * expected)
    if not f > _INDEPENDENT:
        return Spread(sigma2 * inverse, 1.0, 1.0)
    n, R = len(d), np.linalg.cholesky(H / over).T  # H = R^T R: R d has the covariance sigma^2 f I, if all directions are alike
    whitened = (d - d.mean(axis=0)) @ R.T * np.sqrt((n - 1) / (n * f * sigma2))
    _, root, axes = np.linalg.svd(whitened, full_matrices=False)
    beyond = np.maximum(root**2 - 1.0, 0.0)
    more = np.linalg.solve(R, axes.T * np.sqrt(beyond)) / scale[:, None]
    return Spread(f * sigma2 * (inverse + more @ more.T), f, f * (1.0 + float(beyond.sum()) / len(scale)))


def _left_out(H_i: Array, g_i: Array) -> tuple[Array, float]:
    """d_i (n, m) and sum_i tr((H - H_i)^-1 H_i); none where without a view there is no solution: nothing to compare."""
    d, expected = np.zeros_like(g_i), 0.0
    for k, (part, g) in enumerate(zip(H_i, g_i, strict=True)):
        rest = H_i.sum(axis=0) - part
        if np.linalg.cond(rest) > _UNSOLVABLE:
            return np.zeros_like(g_i), 1.0
        d[k] = np.linalg.solve(rest, g)
        expected += float(np.trace(np.linalg.solve(rest, part)))
    return d, expected


def bowed(H: Array, g: Array, sigma2: float, length_m: float) -> tuple[float, Array]:
    """The board's bow, as a part of its length, and what it does to s; nothing where it is not seen.

    H (m + 3, m + 3), g (m + 3,): normal equations of (s, b); sigma2: variance of a coordinate, widened.
    """
    m = len(g) - 3
    K = _inverse(H[:m, :m]) @ H[:m, m:]
    information = H[m:, m:] - H[m:, :m] @ K
    b = np.linalg.lstsq(information, g[m:] - K.T @ g[:m], rcond=None)[0]
    if b @ information @ b < _BOW_SEEN * sigma2:
        return 0.0, np.zeros(m)
    return 0.25 * length_m * float(np.abs(b).max()), -K @ b  # a parabola over its chord: b (L / 2)^2


def _inverse(H: Array) -> Array:
    """Inverse of a normal matrix whose unknowns have different units."""
    scale = _scale(H)
    inverse: Array = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-14, hermitian=True) / np.outer(scale, scale)
    return inverse


def _scale(H: Array) -> Array:
    return np.asarray(np.sqrt(np.clip(np.diagonal(H), 1e-300, None)))
