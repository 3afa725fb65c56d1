"""Covariance of shared unknowns s with common corner errors (Bell & McCaffrey 2002).

    C = sigma^2 H^-1,   sigma^2 = r^T r / redundancy,   H = sum H_i over the views,   s = W z,   W^T H W = I
    y_i = (I - M_i)^-1/2 W^T g_i,   M_i = W^T H_i W,   E[y_i y_i^T] = sigma^2 M_i for independent errors
    f = sum |y_i|^2 / (m sigma^2),   sum y_i y_i^T = f sigma^2 V diag(lambda) V^T

C is widened by f, and by lambda > 1. A bow z_o = b_1 x^2 + b_2 x y + b_3 y^2 adds d d^T, d = H^-1 H_sb b, where significant.
"""

from typing import Final, NamedTuple

import numpy as np

from models.messages import Array

_CHANCE: Final = 2.0  # sigma of f up to which errors count as independent from corner to corner: var f = 2 sum tr M_i^2 / m^2
_ALONE: Final = 0.999  # of what is known along a direction: a view that determines so much has no other to compare with
_BOW_SEEN: Final = 21.1  # chi-square of 3, 1e-4


class Spread(NamedTuple):
    """covariance (m, m) of s, f, and the mean variance factor over sigma^2 H^-1."""

    covariance: Array
    f: float
    widened: float


def marginal(H_i: Array, g_i: Array, sigma2: float) -> Spread:
    """C from views' normal equations (n, m, m), (n, m); sigma2: of a coordinate [px^2]."""
    W = _whitening(H_i.sum(axis=0))
    y, part = _in_common(W.T @ H_i @ W, g_i @ W)
    square, expected = float(np.sum(y * y)), sigma2 * float(part.sum())
    if square <= expected + _CHANCE * sigma2 * np.sqrt(2.0 * np.sum(part**2)):
        return Spread(sigma2 * W @ W.T, 1.0, 1.0)
    f = square / expected
    _, root, axes = np.linalg.svd(y / np.sqrt(f * sigma2), full_matrices=False)
    beyond = np.maximum(root**2 - 1.0, 0.0)
    more = W @ axes.T * np.sqrt(beyond)
    return Spread(f * sigma2 * (W @ W.T + more @ more.T), f, f * (1.0 + float(beyond.sum()) / W.shape[1]))


def _in_common(M_i: Array, g_i: Array) -> tuple[Array, Array]:
    part, axes = np.linalg.eigh(M_i)
    part = np.where(part < _ALONE, np.maximum(part, 0.0), 0.0)
    weight = np.where(part > 0.0, 1.0 / np.sqrt(1.0 - part), 0.0)
    y = axes @ (weight * (g_i[:, None] @ axes)[:, 0])[..., None]
    return y[..., 0], part


def bowed(H: Array, g: Array, sigma2: float, length_m: float) -> tuple[float, Array]:
    """The board's bow over its length, and its effect on s; 0 unless significant.

    H (m + 3, m + 3), g (m + 3,): of (s, b); sigma2: widened.
    """
    m = len(g) - 3
    W = _whitening(H[:m, :m])
    K = W @ (W.T @ H[:m, m:])
    information = H[m:, m:] - H[m:, :m] @ K
    b = np.linalg.lstsq(information, g[m:] - K.T @ g[:m], rcond=None)[0]
    if b @ information @ b < _BOW_SEEN * sigma2:
        return 0.0, np.zeros(m)
    return 0.25 * length_m * float(np.abs(b).max()), -K @ b  # a parabola over its chord: b (L / 2)^2


def _whitening(H: Array) -> Array:
    scale = np.sqrt(np.clip(np.diagonal(H), 1e-300, None))
    values, axes = np.linalg.eigh(H / np.outer(scale, scale))
    known = values > 1e-14 * values[-1]
    return np.asarray(axes[:, known] / np.sqrt(values[known]) / scale[:, None])
