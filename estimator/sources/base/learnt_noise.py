"""Noise of an odometry, learnt from its innovations nu, N(0, S), by variational Bayes (Sarkka and Nummenmaa 2009).

    R = D R_0 D,   D = diag(sqrt f),   f = b / (a - 1) of translation and of rotation,   f ~ inverse gamma(a, b)
    e = R S^-1 nu nu^T S^-1 R + R - R S^-1 R,   r_i = f e_ii / R_ii
    a <- a_0 + rho (a - a_0) + m / 2,   b <- b_0 + rho (b - b_0) + sum_m r_i / 2,   rho = exp(-dt / 20 s)

nu counts up to 4 sigma, and f >= 1/2: short increments do not show all errors of long ones. Where S is far larger than R, r is f:
what cannot be seen is not learnt.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from models.state import XYZ

_A0, _B0 = 3.0, 2.0  # f = 1, as of six readings
_TAU_S, _HIDES_S = 20.0, 2.0
_HIDDEN = 0.65  # c: with it a drift of 0.2 m/s stays inside the covariance (benchmarks/results/odometry.json)
BEGINS_M_S = 0.1  # sigma of a drift that begins
_FARTHEST = 4.0  # sigma
_LEAST, _MOST = 0.5, (25.0, 100.0)


class LearntNoise(NamedTuple):
    """a and b of translation and rotation; changed: C (3, 3), by how much late increments have changed the velocity.

    C <- exp(-2 dt / 2 s) C + K S K^T;   is_renewed: learnt anew since the scale was opened.
    """

    a: tuple[float, float] = (_A0, _A0)
    b: tuple[float, float] = (_B0, _B0)
    changed: Array = np.zeros((XYZ, XYZ))
    is_renewed: bool = False

    @property
    def factors(self) -> tuple[float, float]:
        """f of translation and rotation."""
        return max(self.b[0] / (self.a[0] - 1.0), _LEAST), max(self.b[1] / (self.a[1] - 1.0), _LEAST)

    @property
    def is_noise(self) -> bool:
        """Beyond, increments are wrong and not noisy."""
        return all(f < most for f, most in zip(self.factors, _MOST, strict=True))

    @property
    def may_be_scale(self) -> bool:
        """Rotations are noise, and the scale was not opened before."""
        return not self.is_renewed and self.factors[1] < _MOST[0]

    @property
    def roots(self) -> Array:
        """sqrt(f) of the six components, (6,)."""
        roots: Array = np.sqrt(np.repeat(np.minimum(self.factors, _MOST), XYZ))
        return roots

    @property
    def hidden_m_s(self) -> float:
        """1-sigma of the drift that hides in C, in each axis: 0.65 sqrt(tr C / 3), 0.1 m/s at most."""
        return min(_HIDDEN * math.sqrt(float(np.trace(self.changed)) / XYZ), BEGINS_M_S)

    def also(self, nu: Array, s: Array, noise: Array, rows: NDArray[np.intp], seconds: float) -> "LearntNoise":
        """With one more innovation nu (m,), S and R (m, m) of these rows of an increment over so many seconds."""
        gain = np.linalg.solve(s, noise)  # S^-1 R
        far = math.sqrt(float(nu @ np.linalg.solve(s, nu)) / len(nu))
        e = (gain.T @ nu * min(1.0, _FARTHEST / max(far, 1.0))) ** 2 + (noise - noise @ gain).diagonal()
        r = self.roots[rows] ** 2 * e / noise.diagonal()
        a, b, rho = list(self.a), list(self.b), math.exp(-seconds / _TAU_S)
        for g, of in enumerate((rows < XYZ, rows >= XYZ)):
            a[g] = _A0 + rho * (a[g] - _A0) + 0.5 * int(of.sum())
            b[g] = _B0 + rho * (b[g] - _B0) + 0.5 * float(r[of].sum())
        return self._replace(a=(a[0], a[1]), b=(b[0], b[1]))

    def fused(self, hp: Array, s: Array, seconds: float) -> "LearntNoise":
        """An increment has changed the velocity; hp: H P_v (m, 3)."""
        return self._replace(changed=math.exp(-2.0 * seconds / _HIDES_S) * self.changed + hp.T @ np.linalg.solve(s, hp))
