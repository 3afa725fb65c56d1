"""Similarity of a measured region and a landmark's description.

    S' = S_measured / S_map,  W' = W_measured / W_map,  L' = L_measured / L_map,  F' = F_measured / F_map   (thesis, eq. 5.1-5.4)
    similarity = w1 S' + w2 W' + w3 L' + w4 F'                                                             (thesis, eq. 5.5)

Ratios above one count inverse; weights are normalised.
"""

from collections.abc import Sequence

import numpy as np

from models.messages import Array


def normalised(weights: Array | Sequence[float] | Sequence[Sequence[float]]) -> Array:
    """Weights (..., 4) of size, width, length, fill ratio, over their sum. ValueError: negative, not finite, all zero."""
    w = np.asarray(weights, np.float64)
    total = w.sum(axis=-1, keepdims=True)
    if not np.all(np.isfinite(w)) or np.any(w < 0.0) or np.any(total <= 0.0):
        raise ValueError(f"similarity weights must be finite, not negative and not all zero, not {w.tolist()}")
    return np.asarray(w / total)


def similarity(measured: Array, described: Array, weights: Array) -> Array:
    """0 ... 1 of descriptions (..., 4): size m^2, width m, length m, fill ratio; weights (..., 4) sum to 1; shapes broadcast.

    Figures not positive and finite give the ratio 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.asarray(measured, np.float64) / described
        r = np.where((r > 0.0) & np.isfinite(r), np.minimum(r, 1.0 / r), 0.0)
    return np.asarray(np.sum(weights * r, axis=-1))
