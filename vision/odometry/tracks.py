"""Corner tracks through two stereo pairs, pyramidal Lucas-Kanade (Bouguet 2001), raw images.

y = (u_l, v_l, u_r): rectified; NaN: not measured. Matches must return to their start and keep their row.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Image
from vision.odometry.views import Lens, View, scaled_px

_WINDOW: Final = (17, 17)  # px
_STOP: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)
_LEVELS: Final = 3
_BACK_PX: Final = 1.0  # forward and back again end so near to the beginning
_ROW_PX: Final = 1.5  # of rectified images; calibration leaves some tenths
_MARGIN_PX: Final = 8.0  # half a window
_HALF: Final = 5  # of a window of the coarse search, px of the small image
_ALIKE: Final = 0.7  # least correlation there
_PEAK, _DISTINCT = 3, 0.04  # no position further off than this many px correlates nearly as well: fences, windows


def stereo(left: View, right: View, raw_px: Array, row: Array, guess: Array, lens: Lens) -> Array:
    """u_r (N,) of raw left pixels (N, 2) of rectified rows row (N,); NaN: not found.

    guess (N,): expected rectified column; lens: the right camera's.
    """
    there, found = _flow(left.raw, right.raw, raw_px, lens.raw(np.column_stack((guess, row))), left.scale.bit_length() - 1)
    px = lens.rectified(there)
    found &= np.abs(px[:, 1] - row) <= _ROW_PX
    return np.where(found, px[:, 0], np.nan)


def coarse_columns(left: View, right: View, px: Array, low: Array, high: Array) -> Array:
    """u_r (N,) of px (N, 2) to 1 px, between low and high (N,), by row correlation; NaN: none or two."""
    a, b, k_small = left.small, right.small, 1.0 / left.scale
    height, width = a.shape
    exact = scaled_px(px, k_small)
    nearest = np.rint(exact).astype(int)
    first = np.clip(np.floor(scaled_px(low, k_small)).astype(int), _HALF, width - 1 - _HALF)
    last = np.clip(np.ceil(scaled_px(high, k_small)).astype(int), _HALF, width - 1 - _HALF)
    columns = np.full(len(px), np.nan)
    for k, ((u, v), begin, end) in enumerate(zip(nearest.tolist(), first.tolist(), last.tolist(), strict=True)):
        if not (_HALF <= u < width - _HALF and _HALF <= v < height - _HALF and begin <= end):
            continue
        rows = slice(v - _HALF, v + _HALF + 1)
        score = cv2.matchTemplate(
            b[rows, begin - _HALF : end + _HALF + 1], a[rows, u - _HALF : u + _HALF + 1], cv2.TM_CCOEFF_NORMED
        )[0]
        best = int(score.argmax())
        peak = float(score[best])
        score[max(best - _PEAK, 0) : best + _PEAK + 1] = -1.0
        if peak >= _ALIKE and float(score.max()) <= peak - _DISTINCT:
            columns[k] = begin + best - u
    return scaled_px(columns + exact[:, 0], left.scale)


def temporal(first: Image, second: Image, px: Array, guess: Array, H: Array) -> Array:
    """(N, 2) raw pixels in the second image of px (N, 2); guess (N, 2).

    H (3, 3) ~ K R_01 K^-1 turns the second image to the first's attitude.
    """
    turned = cv2.warpPerspective(second, H, (second.shape[1], second.shape[0]), flags=cv2.INTER_LINEAR)
    there, found = _flow(first, turned, px, _mapped(H, guess), _LEVELS)
    there = _mapped(np.asarray(np.linalg.inv(H), np.float64), there)
    height, width = second.shape[:2]
    low, high = _MARGIN_PX, np.array([width, height]) - 1.0 - _MARGIN_PX
    found &= ((there >= low) & (there <= high)).all(axis=1)
    return np.where(found[:, None], there, np.nan)


def _flow(a: Image, b: Image, px: Array, guess: Array, levels: int) -> tuple[Array, NDArray[np.bool_]]:
    known: NDArray[np.bool_] = np.asarray(np.isfinite(guess).all(axis=1), np.bool_)
    if not known.any():
        return np.full((len(px), 2), np.nan), known
    px, guess = px[known], guess[known]
    start, ahead = np.ascontiguousarray(px, np.float32), np.ascontiguousarray(guess, np.float32).copy()
    there, forward, _ = cv2.calcOpticalFlowPyrLK(
        a, b, start, ahead, winSize=_WINDOW, maxLevel=levels, criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    back, backward, _ = cv2.calcOpticalFlowPyrLK(
        b, a, there, start.copy(), winSize=_WINDOW, maxLevel=0, criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    gap = np.abs(back - start).max(axis=1)
    found = (forward.ravel() > 0) & (backward.ravel() > 0) & (gap <= _BACK_PX)
    everywhere, all_found = np.full((len(known), 2), np.nan), known.copy()
    everywhere[known], all_found[known] = there, found
    return everywhere, all_found


def _mapped(H: Array, px: Array) -> Array:
    x = px @ H[:, :2].T + H[:, 2]
    mapped: Array = x[:, :2] / x[:, 2:]
    return mapped
