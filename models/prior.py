"""The pose as it is known before an image."""

from dataclasses import dataclass

import numpy as np

from models import cholesky, so3
from models.messages import Array


@dataclass(frozen=True, slots=True)
class Prior:
    """Pose before the images: p_n [m], q_nb_wxyz, covariance (6, 6), x y z rx ry rz about n."""

    p_n: Array
    q_nb_wxyz: Array
    covariance: Array

    @property
    def R_nb(self) -> Array:
        """Rotation matrix body -> n, (3, 3)."""
        return so3.matrix(self.q_nb_wxyz)

    @property
    def information(self) -> Array:
        """P^-1 (6, 6), worked out at each call."""
        return cholesky.inverse(np.ascontiguousarray(self.covariance, dtype=np.float64))

    def moved(self, x: Array) -> tuple[Array, Array]:
        """(p_n, q_nb_wxyz) after x = (dp, dtheta, ...): p + dp, exp(dtheta) q."""
        return self.p_n + x[:3], so3.normalise(so3.multiply(so3.quat_exp(np.ascontiguousarray(x[3:6])), self.q_nb_wxyz))
