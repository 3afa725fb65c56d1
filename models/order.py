"""Median and quantiles for compiled code; numba's own compile slowly."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array


@njit(cache=True)
def sort(values: Array) -> None:
    """Sort values (N,) in place (Shell 1959; gaps: Gonnet 1984); NaN unsorted."""
    gap = len(values) // 2
    while gap > 0:
        for i in range(gap, len(values)):
            value, j = values[i], i
            while j >= gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value
        gap = 1 if gap == 2 else int(gap / 2.2)


@njit(cache=True)
def ranked(values: Array) -> NDArray[np.int64]:
    """Stable ascending order (N,) of the values."""
    index, gap = np.arange(len(values)), len(values) // 2
    while gap > 0:
        for i in range(gap, len(values)):
            k, j = index[i], i
            while j >= gap:
                before = index[j - gap]
                if values[before] < values[k] or (values[before] == values[k] and before < k):
                    break
                index[j] = before
                j -= gap
            index[j] = k
        gap = 1 if gap == 2 else int(gap / 2.2)
    return index


@njit(cache=True)
def quantile(values: Array, share: float) -> float:
    """Linear quantile of values (N,) as numpy.quantile; NaN of none, or of NaN."""
    n, total = len(values), 0.0
    for i in range(n):
        total += values[i]
    if n == 0 or np.isnan(total):
        return np.nan
    few = values.copy()
    sort(few)
    place = 1.0 + (n - 1) * share
    k = min(int(place), n)
    part = place - k
    return float(few[k - 1] if part == 0.0 or k == n else few[k - 1] * (1.0 - part) + few[k] * part)


@njit(cache=True)
def median(values: Array) -> float:
    """Median of values (N,); NaN of none, or of NaN."""
    return quantile(values, 0.5)
