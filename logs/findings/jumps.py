"""Positions that jump further than any vehicle moves."""

from typing import Final

import numpy as np

from logs.findings.position import positions
from logs.findings.streams import FIX, Cause, Stream
from models.messages import Array

_WINDOW: Final = 3  # steps on each side
_FIX_M, _FIX_M_S2 = 10.0, 20.0
_POSE_M, _POSE_M_S2 = 3.0, 8.0
_SIGMAS: Final = 8.0
_USUAL: Final = 10.0  # times the median: units are no jumps
_OFTEN: Final = 0.05  # of all positions
_AFTER: Final = 5  # positions that stay


def jump(stream: Stream) -> Cause | None:
    """|p_k+1 - p_k - v h| > max(d, 8 sigma, a h T): once for good, or often.

    v: median velocity of T = 3 steps on each side; h: the step; d, a: 10 m and 20 m/s^2 of a receiver, 3 m and 8 m/s^2 of poses.
    """
    t, p = positions(stream)
    if len(t) < 4 * _WINDOW:
        return None
    least_m, most_m_s2 = (_FIX_M, _FIX_M_S2) if stream.kind == FIX else (_POSE_M, _POSE_M_S2)
    sigma = float(np.median(stream.values[:, 3])) if stream.kind == FIX else 0.0
    h, move = np.diff(t), np.diff(p[:, :2], axis=0)
    off = move - _usual(move / h[:, None]) * h[:, None]
    bound = np.maximum(max(least_m, _SIGMAS * sigma), most_m_s2 * h * _WINDOW * np.median(h))
    far = np.linalg.norm(off, axis=1)
    bound = np.maximum(bound, _USUAL * np.median(far))
    regular = h < 3.0 * np.median(h)
    found = np.flatnonzero((far > bound) & regular)
    if not len(found):
        return None
    since_s, size = stream.arrival_at(float(t[found[0] + 1])), float(far[found].max())
    left = np.linalg.norm(off[found].sum(axis=0))
    around = regular[max(0, found[0] - _AFTER) : found[-1] + _AFTER + 1]
    if left > bound.min() and len(found) <= 2 and _AFTER <= found[-1] < len(h) - _AFTER and around.all():
        what = f"its positions jump by {left:.0f} m and stay there"
        return Cause(
            what, since_s, "another place or frame since then: a spoofed receiver, a map that was set anew, a wrong landmark"
        )
    if len(found) < max(6.0, _OFTEN * len(t)):
        return None
    what = f"its positions jump to and fro, {len(found)} times, by up to {size:.0f} m"
    return Cause(
        what, since_s, "false fixes among true ones: reflections, or false matches; report them with a larger covariance"
    )


def _usual(velocity: Array) -> Array:
    """Median of the steps around each, without itself."""
    padded = np.pad(velocity, ((_WINDOW, _WINDOW), (0, 0)), constant_values=np.nan)
    shifts = [k for k in range(2 * _WINDOW + 1) if k != _WINDOW]
    around = np.stack([padded[k : k + len(velocity)] for k in shifts])
    return np.asarray(np.nanmedian(around, axis=0))
