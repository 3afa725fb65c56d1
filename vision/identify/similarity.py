"""How well a measured region agrees with the description of a landmark, as the thesis reports it.

    S' = S_measured / S_map,  W' = W_measured / W_map,  L' = L_measured / L_map,  F' = F_measured / F_map   (thesis, eq. 5.1-5.4)
    similarity = w1 S' + w2 W' + w3 L' + w4 F'                                                             (thesis, eq. 5.5)

Two repairs: a ratio r above one counts as 1/r (else a region twice too large is 200 % similar), and the weights, which sum to
1.0257 in the thesis, are divided by their sum. Similarity makes a region a candidate; it does not decide: ambiguous landmarks
have it too.
"""

from collections.abc import Sequence

import numpy as np

from models.messages import Array


def normalised(weights: Array | Sequence[float] | Sequence[Sequence[float]]) -> Array:
    """Weights (..., 4) of size, width, length, fill ratio, divided by their sum. ValueError: negative, not finite, all zero."""
    w = np.asarray(weights, np.float64)
    total = w.sum(axis=-1, keepdims=True)
    if not np.all(np.isfinite(w)) or np.any(w < 0.0) or np.any(total <= 0.0):
        raise ValueError(f"similarity weights must be finite, not negative and not all zero, not {w.tolist()}")
    return np.asarray(w / total)


def similarity(measured: Array, described: Array, weights: Array) -> Array:
    """Similarity 0 ... 1 of descriptions (..., 4): size m^2, width m, length m, fill ratio; weights (..., 4) sum to 1.

    Shapes broadcast: measured (M, 1, 4) against described (1, J, 4) gives (M, J). A figure that is not positive or not finite
    agrees with nothing: its ratio is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.asarray(measured, np.float64) / described
        r = np.where((r > 0.0) & np.isfinite(r), np.minimum(r, 1.0 / r), 0.0)
    return np.asarray(np.sum(weights * r, axis=-1))
