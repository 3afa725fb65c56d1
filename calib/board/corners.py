"""Sub-pixel corners of a chessboard from rough ones; size: inner corners, columns and rows.

Windows follow the squares; uneven light is divided out. Corrected bias by edges of curvature kappa:

    y_refined = -kappa <x^2> / 2,   <x^2> = w^2 (1/2 - L exp(-L^2) / (sqrt(pi) erf(L))),   weights exp(-x^2 / w^2), |x| < L w
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from models.messages import Array

Grey = NDArray[np.uint8]
Level = NDArray[np.float32]
Size = tuple[int, int]

_FIRST_WINDOW, _WINDOW = 0.4, 0.3  # of the local square
_WINDOW_PX = (4, 15)  # fewer pixels give a noisy corner, more nothing
_LEAST_PX = 2  # at the border
_SMOOTHING_PX = 0.8
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
_LIGHT: Final = (0.2, 5.0)  # of its mean on the board: beyond, away from the board, the quadratic means nothing


def refined(image: Grey, corners: Array, size: Size) -> Array:
    """Sub-pixel corners."""
    even = (image / _light(image, corners, size)).astype(np.float32)
    smooth = np.asarray(cv2.GaussianBlur(even, (0, 0), _SMOOTHING_PX), dtype=np.float32)
    windows = _windows(image, corners, _FIRST_WINDOW * spacing(corners, size))
    px = _sub_pixel(smooth, corners, windows)
    predicted, off = _pattern(px, size)
    again = _sub_pixel(smooth, np.where(off[:, None], predicted, px), windows)
    better = off & (_saddle(smooth, again) > _saddle(smooth, px))
    px[better] = again[better]
    windows = _windows(image, px, _WINDOW * spacing(px, size))
    return _straightened(_sub_pixel(smooth, px, windows), windows, size)


def _light(image: Grey, px: Array, size: Size) -> Level:
    middles = middles_of(px, size)
    levels, first = levels_at(image, middles), is_first_kind(size)
    bright = first if levels[first].mean() > levels[~first].mean() else ~first
    u, v = middles[bright].T
    terms = next(n for n, fewest in ((6, 10), (3, 5), (1, 1)) if len(u) >= fewest)
    centre, scale = middles[bright].mean(axis=0), float(np.ptp(px, axis=0).max())
    x, y = ((u - centre[0]) / scale, (v - centre[1]) / scale)
    c = np.zeros(6)
    c[:terms] = np.linalg.lstsq(_quadratic(x, y)[:, :terms], levels[bright] / levels[bright].mean(), rcond=None)[0]
    rows, columns = (np.arange(n, dtype=np.float32) for n in image.shape)
    x, y = ((columns - centre[0]) / scale)[None], ((rows - centre[1]) / scale)[:, None]
    light = (c[0] + c[1] * x + c[3] * x * x) + (c[2] * y + c[5] * y * y) + c[4] * x * y
    return np.asarray(np.clip(light, *_LIGHT), dtype=np.float32)


def _quadratic(x: Array, y: Array) -> Array:
    return np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))


def middles_of(px: Array, size: Size) -> Array:
    """Middles (M, 2) [px] of squares between corners (N, 2), row by row."""
    grid = px.reshape(size[1], size[0], 2)
    return np.asarray(0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]).reshape(-1, 2))


def is_first_kind(size: Size) -> NDArray[np.bool_]:
    """Which squares have the colour of the one inside corner 0."""
    return np.asarray((np.add.outer(np.arange(size[1] - 1), np.arange(size[0] - 1)) % 2 == 0).ravel())


def levels_at(image: Grey, px: Array) -> Array:
    """Grey levels (M,) at px (M, 2), between the pixels."""
    at = px.astype(np.float32).reshape(-1, 1, 2)
    return np.asarray(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR), dtype=np.float64).ravel()


def _saddle(image: Level, px: Array) -> Array:
    """I_xy^2 - I_xx I_yy at px (N, 2): large at corners, near 0 on edges."""
    xx, yy, xy = (cv2.Sobel(image, cv2.CV_64F, i, j, ksize=5) for i, j in ((2, 0), (0, 2), (1, 1)))
    u, v = np.clip(np.rint(px), 0, np.array(image.shape[::-1]) - 1).astype(np.int64).T
    return np.asarray((xy * xy - xx * yy)[v, u])


def _windows(image: Grey, px: Array, half_px: Array) -> NDArray[np.int64]:
    height, width = image.shape
    to_border = np.minimum(px, np.array([width - 1.0, height - 1.0]) - px).min(axis=1)
    return np.asarray(np.maximum(np.minimum(np.clip(half_px, *_WINDOW_PX), to_border - 2.0), _LEAST_PX), dtype=np.int64)


def _sub_pixel(image: Level, px: Array, windows: NDArray[np.int64]) -> Array:
    refined = px.copy()
    for w in np.unique(windows):
        some = windows == w
        start = px[some].astype(np.float32).reshape(-1, 1, 2)
        refined[some] = cv2.cornerSubPix(image, start, (int(w), int(w)), (-1, -1), _STOP).reshape(-1, 2)
    return refined


def _straightened(px: Array, windows: NDArray[np.int64], size: Size) -> Array:
    grid = px.reshape(size[1], size[0], 2)
    normals, pulls = [], []
    for axis in (0, 1):
        step = np.asarray(np.gradient(grid, axis=axis)).reshape(-1, 2)
        second = np.diff(grid, 2, axis=axis)
        bend = np.concatenate((second.take([0], axis), second, second.take([-1], axis)), axis).reshape(-1, 2)
        length = np.linalg.norm(step, axis=1)
        normal = step[:, ::-1] * (-1.0, 1.0) / length[:, None]
        L = (1.0 + 0.5 / windows) / np.abs(normal).max(axis=1)  # the window is a square: an edge across it is longer
        mean_square = windows**2 * (0.5 - L * np.exp(-L * L) / (np.sqrt(np.pi) * erf(L)))
        normals.append(normal)
        pulls.append(0.5 * mean_square * np.sum(bend * normal, axis=1) / length**2)
    shift = np.linalg.solve(np.stack(normals, axis=1), np.stack(pulls, axis=1)[..., None])
    return np.asarray(px + shift[..., 0])


def spacing(px: Array, size: Size) -> Array:
    """Distance (N,) from each corner to its nearest neighbour on the board [px]."""
    grid = px.reshape(size[1], size[0], 2)
    nearest = np.full((4, size[1], size[0]), np.inf)
    along, across = np.linalg.norm(np.diff(grid, axis=1), axis=2), np.linalg.norm(np.diff(grid, axis=0), axis=2)
    nearest[0, :, 1:] = nearest[1, :, :-1] = along
    nearest[2, 1:] = nearest[3, :-1] = across
    return np.asarray(nearest.min(axis=0).ravel())


def _pattern(px: Array, size: Size) -> tuple[Array, NDArray[np.bool_]]:
    xy = np.mgrid[0 : size[0], 0 : size[1]].T.reshape(-1, 2).astype(np.float64)
    H, _ = cv2.findHomography(xy, px, cv2.LMEDS)
    if H is None:
        return px, np.zeros(len(px), dtype=np.bool_)
    flat = cv2.perspectiveTransform(xy.reshape(1, -1, 2), H)[0]
    x, y = (2.0 * xy / xy.max(axis=0) - 1.0).T
    A = np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
    bend, weight = px - flat, np.ones((len(px), 1))
    for _ in range(10):
        coefficients = np.linalg.lstsq(A * weight, bend * weight, rcond=None)[0]
        error = np.linalg.norm(bend - A @ coefficients, axis=1)
        scale = max(1.4826 * float(np.median(error)), 0.05)
        weight = 1.0 / np.sqrt(1.0 + (error / (2.0 * scale)) ** 2)[:, None]
    return flat + A @ coefficients, error > max(5.0 * scale, 0.5)
