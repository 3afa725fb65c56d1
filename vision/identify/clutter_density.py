"""Density of unmapped objects at a region's position, by image turn t and log scale s.

    f_i(h) = sum_ts w_ts f_i(t, s) / sum_ts w_ts,     w_ts = exp(-|(t, s) - (x_t, x_s)|^2_P / 2)
    prod_i f_i  exp(-(1 / M) sum_i ln (f_i / f))                    of a hypothesis without landmarks: f_i is relative

x, P: a hypothesis' common errors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.messages import Array

_TURN, _SCALE = 5, 6  # of x


@dataclass(frozen=True, slots=True)
class ClutterDensity:
    """log_density (M, T, S) at turns (T,) rad and log scales (S,).

    log_above_mean (T, S): mean excess of position over anywhere, >= 0.
    """

    log_density: Array
    log_above_mean: Array
    turns: Array
    log_scales: Array

    @property
    def highest(self) -> Array:
        """(M,) over all turns and scales."""
        return np.asarray(self.log_density.max(axis=(1, 2)))

    def below_highest(self, absent: NDArray[np.bool_], x: Array, covariance: Array) -> Array:
        """Log of f_i over its highest, summed over absent regions (H,).

        absent (H, M); x (H, 7), covariance (H, 7, 7).
        """
        t, s = (axis.ravel() for axis in np.meshgrid(self.turns, self.log_scales, indexing="ij"))
        off = np.stack((t - x[:, _TURN, None], s - x[:, _SCALE, None]), axis=-1)  # (H, TS, 2)
        steps = [self.turns[1] - self.turns[0], self.log_scales[1] - self.log_scales[0]]
        spread = covariance[:, [[_TURN], [_SCALE]], [_TURN, _SCALE]] + np.diag(np.maximum(0.5 * np.array(steps), 1e-6) ** 2)
        squared = np.einsum("hka,hab,hkb->hk", off, np.linalg.inv(spread), off)
        weight = np.exp(-0.5 * (squared - squared.min(axis=1, keepdims=True)))
        share = np.exp(self.log_density - self.highest[:, None, None]).reshape(len(self.log_density), len(t))
        below = np.log(weight @ share.T / weight.sum(axis=1, keepdims=True))
        first = weight @ self.log_above_mean.ravel() / weight.sum(axis=1)
        return np.asarray(np.where(absent, below, 0.0).sum(axis=1) - np.where(absent.all(axis=1), first, 0.0))
