"""Connected components of equal labels by runs, in two passes (thesis section 4.4.2)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vision.describe.segment import Labels

Table = NDArray[np.int64]  # one row per component: label, u0, v0, width, height, pixels
Runs = NDArray[np.int32]  # one row per run of equal labels in an image row: row, first column, one past the last column


def components(labels: Labels, least_px: int = 1, largest_px: int = 2**31 - 1) -> tuple[Table, Runs, NDArray[np.int32]]:
    """8-connected components of equal labels (0: none), of least_px..largest_px pixels.

    Their table, all runs sorted by row, and the component's row for each run, -1 without.
    """
    runs, run_labels = _runs(labels)
    return _join(runs, run_labels, least_px, largest_px)


@njit(cache=True)
def _runs(labels: Labels) -> tuple[Runs, Labels]:
    height, width = labels.shape
    count = 0
    for v in range(height):
        previous = np.uint8(0)
        for u in range(width):
            here = labels[v, u]
            if here != previous:
                if here != 0:
                    count += 1
                previous = here
    runs, run_labels = np.empty((count, 3), np.int32), np.empty(count, np.uint8)
    k = -1
    for v in range(height):
        previous = np.uint8(0)
        for u in range(width):
            here = labels[v, u]
            if here != previous:
                if previous != 0:
                    runs[k, 2] = u
                if here != 0:
                    k += 1
                    runs[k, 0], runs[k, 1], run_labels[k] = v, u, here
                previous = here
        if previous != 0:
            runs[k, 2] = width
    return runs, run_labels


@njit(cache=True)
def _root(parent: NDArray[np.int32], k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@njit(cache=True)
def _join(runs: Runs, run_labels: Labels, least_px: int, largest_px: int) -> tuple[Table, Runs, NDArray[np.int32]]:
    count = runs.shape[0]
    parent = np.arange(count).astype(np.int32)
    above = 0  # first run of the row above that may touch
    for k in range(count):
        row, first, last = runs[k]
        while above < k and (runs[above, 0] < row - 1 or (runs[above, 0] == row - 1 and runs[above, 2] < first)):
            above += 1
        j = above
        while j < k and runs[j, 0] == row - 1 and runs[j, 1] <= last:
            if run_labels[j] == run_labels[k]:
                a, b = _root(parent, j), _root(parent, k)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
            j += 1
    box = np.zeros((count, 5), np.int64)  # u0, v0, u1, v1, pixels of each root
    for k in range(count):
        r = _root(parent, k)
        if box[r, 4] == 0:
            box[r, 0], box[r, 1], box[r, 2], box[r, 3] = runs[k, 1], runs[k, 0], runs[k, 2], runs[k, 0] + 1
        box[r, 0], box[r, 2], box[r, 3] = min(box[r, 0], runs[k, 1]), max(box[r, 2], runs[k, 2]), runs[k, 0] + 1
        box[r, 4] += runs[k, 2] - runs[k, 1]
    kept = np.full(count, -1, np.int32)
    table = np.empty((count, 6), np.int64)
    number = 0
    for k in range(count):
        if parent[k] == k and least_px <= box[k, 4] <= largest_px:
            kept[k] = number
            table[number, 0], table[number, 1], table[number, 2] = run_labels[k], box[k, 0], box[k, 1]
            table[number, 3], table[number, 4], table[number, 5] = box[k, 2] - box[k, 0], box[k, 3] - box[k, 1], box[k, 4]
            number += 1
    component = np.empty(count, np.int32)
    for k in range(count):
        component[k] = kept[_root(parent, k)]
    return table[:number].copy(), runs, component
