"""The Kalman update of the error, which is zero before it, so that nu is the whole residual:

    S = H P H^T + R,  K = P H^T S^-1,  dx = K nu,  P <- (I - K H) P (I - K H)^T + K R K^T       (Joseph form)

Rows of K are zero where an error is only considered, for which Joseph's form holds as well (Schmidt 1966): it is not corrected.
"""

import numpy as np
from numba import njit

from models import cholesky
from models.messages import Array


def update(cov: Array, nu: Array, h: Array, hp: Array, noise: Array, estimated: Array) -> Array:
    """Error dx (n,); P (n, n) becomes the posterior in place, symmetric.

    nu: (m,); h, hp: H and H P (m, n); noise: (m, m); estimated: (k,) of the last k errors, 0 if considered. Raises ValueError for
    shapes, numpy.linalg.LinAlgError unless S is positive definite.
    """
    m, n = len(nu), len(cov)
    if nu.shape != (m,) or h.shape != (m, n) or hp.shape != (m, n) or noise.shape != (m, m) or cov.shape != (n, n):
        raise ValueError(f"shapes do not fit: nu {nu.shape}, H {h.shape}, H P {hp.shape}, R {noise.shape}, P {cov.shape}")
    if estimated.ndim != 1 or len(estimated) > n:
        raise ValueError(f"shapes do not fit: estimated {estimated.shape}, P {cov.shape}")
    return _update(cov, nu, h, hp, noise, estimated)


@njit(cache=True, error_model="numpy")
def _update(cov: Array, nu: Array, h: Array, hp: Array, noise: Array, estimated: Array) -> Array:
    """With M = P - K H P:  P <- M - (M H^T - K R) K^T."""
    gain, dx = _gain(h, hp, noise, estimated), np.zeros(cov.shape[0])
    n, m = gain.shape
    left = np.zeros((m, n))  # (M H^T - K R)^T
    for i in range(n):
        for line in range(m):
            dx[i] += gain[i, line] * nu[line]
            for j in range(n):
                cov[i, j] -= gain[i, line] * hp[line, j]
    for line in range(m):
        for k in range(n):
            if h[line, k] != 0.0:  # most are 0
                for i in range(n):
                    left[line, i] += cov[i, k] * h[line, k]
        for k in range(m):
            for i in range(n):
                left[line, i] -= gain[i, k] * noise[k, line]
    for i in range(n):
        for line in range(m):
            for j in range(n):
                cov[i, j] -= left[line, i] * gain[j, line]
    cholesky.symmetrise(cov)
    return dx


@njit(cache=True, error_model="numpy")
def _gain(h: Array, hp: Array, noise: Array, estimated: Array) -> Array:
    m, n = h.shape
    s, low, solved, gain = np.empty((m, m)), np.empty((m, m)), hp.copy(), np.empty((n, m))
    for i in range(m):
        for j in range(i + 1):
            s[i, j] = 0.5 * (noise[i, j] + noise[j, i])
            for k in range(n):
                s[i, j] += h[i, k] * hp[j, k]
    if not cholesky.factor(s, low):
        raise np.linalg.LinAlgError("not positive definite")
    cholesky.forward(low, solved)
    cholesky.backward(low, solved)
    first = n - estimated.shape[0]
    for i in range(n):
        is_corrected = i < first or estimated[i - first] != 0.0
        for line in range(m):
            gain[i, line] = solved[line, i] if is_corrected else 0.0
    return gain
