"""The Kalman update: filterpy's behind one wrapper.

    S = H P H^T + R,  K = P H^T S^-1,  dx = K nu,  P <- (I - K H) P (I - K H)^T + K R K^T       (Joseph form)

State = error, zero before every update. Only this file imports filterpy, whose `update` broadcasts silently, has no gate, and
keeps P only nearly symmetric.
"""

import numpy as np
from filterpy.kalman import KalmanFilter

from models import cholesky
from models.messages import Array


class ErrorStateKalman:
    """One update of an n-dimensional error state; holds no state between calls."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._zero = np.zeros(size)
        self._filter = KalmanFilter(dim_x=size, dim_z=1)
        self._filter.inv = cholesky.inverse  # of S, symmetric and small

    def update(self, cov: Array, nu: Array, h: Array, noise: Array) -> tuple[Array, Array, Array]:
        """Error dx (n,), posterior covariance (n, n), gain K (n, m).

        cov: (n, n); nu: (m,); h: (m, n); noise: (m, m). Raises ValueError for a shape; numpy.linalg.LinAlgError: S not positive
        definite.
        """
        m, n = len(nu), self._size
        if nu.shape != (m,) or h.shape != (m, n) or noise.shape != (m, m) or cov.shape != (n, n):
            raise ValueError(f"shapes do not fit: nu {nu.shape}, H {h.shape}, R {noise.shape}, P {cov.shape}, n = {n}")
        kalman = self._filter
        kalman.x, kalman.P, kalman.R = self._zero, cov, noise
        kalman.update(nu, H=h)
        cholesky.symmetrise(kalman.P)
        return kalman.x, kalman.P, kalman.K
