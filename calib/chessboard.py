"""Corners of a chessboard or ChArUco board in a picture, to a part of a pixel (thesis 5.1.1, steps 2-6).

grey -> median 5 -> contrast stretch -> find the board -> corners refined on the lightly smoothed grey picture.
The window of the refinement follows the local size of the squares and ends at the picture's border. A corner that left its
neighbours' pattern is put back and refined again: the median moves the first guess by pixels where squares are small. It stays
there if the picture is more of a saddle there: of a wide lens the pattern itself may be wrong.

The refinement takes edges for straight. An edge of curvature kappa, y = kappa x^2 / 2 along and across it, pulls the corner:

    y_refined = -kappa <x^2> / 2,   <x^2> = w^2 (1/2 - L exp(-L^2) / (sqrt(pi) erf(L))),   weights exp(-x^2 / w^2), |x| < L w

which is taken back: 0.02 px at the border of a usual lens, of one sign all round, and so a wrong focal length.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from calib.errors import CalibrationError
from models.messages import Array
from vision.enhance import median, stretch
from vision.rectify import Image

Grey = NDArray[np.uint8]

_FIRST_WINDOW, _WINDOW = 0.4, 0.3  # of the local square
_WINDOW_PX = (4, 15)  # fewer pixels give a noisy corner, more nothing
_LEAST_PX = 2  # at the border
_SMOOTHING_PX = 0.8
_SEARCH_PX = 1500  # larger pictures are searched at reduced size
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
_BLURRED_PX: Final = 6.0  # an edge that takes more pixels from 10 to 90 % is blurred ...
_BLURRED_SQUARE: Final = 0.25  # ... and so is one that takes this part of a square
_UNKNOWN_PX: Final = 9999.0  # OpenCV's word for it
_LARGEST_M: Final = 2.0  # of a square
_OTHER_SIZES: Final = (
    (9, 6), (8, 6), (7, 6), (7, 5), (6, 5), (6, 4), (8, 5), (10, 7), (11, 8), (5, 4), (8, 7), (9, 7), (11, 7), (13, 9),
)  # fmt: skip


class Why(StrEnum):
    """Why a picture gives no view."""

    NOT_FOUND = "no board found"
    BLURRED = "blurred"


@dataclass(frozen=True)
class Board:
    """columns x rows inner corners of squares of square_m; marker_m > 0: a ChArUco board with markers of that size."""

    columns: int = 9
    rows: int = 6
    square_m: float = 0.025
    marker_m: float = 0.0
    dictionary: str = "DICT_5X5_1000"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise CalibrationError("a board has at least 3 x 3 inner corners; --board counts where four squares meet, as in 9x6")
        if not 0.0 < self.square_m <= _LARGEST_M:
            raise CalibrationError(f"squares of {self.square_m:g} m: --square-mm is the side of one square in millimetres")
        if not 0.0 <= self.marker_m < self.square_m:
            raise CalibrationError("the markers of a ChArUco board are smaller than its squares: --marker-mm, --square-mm")

    @cached_property
    def points(self) -> Array:
        """Corners (N, 3) in the board's frame o [m]: x along the columns, y along the rows, z = 0."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2)
        return np.column_stack((self.square_m * grid, np.zeros(len(grid))))

    @property
    def ends_alike(self) -> bool:
        """Whether the board looks the same upside down, so that nobody can tell which end corner 0 is at."""
        return self.marker_m == 0.0 and (self.columns + self.rows) % 2 == 0

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board; it counts squares, one more than inner corners each way."""
        kinds = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, kinds)


@dataclass(frozen=True, eq=False)
class View:
    """A board as one camera sees it: corner `ids` of Board.points at px (N, 2); edge_px: width of its edges (sharpness)."""

    name: str
    width: int
    height: int
    ids: NDArray[np.int64]
    px: Array
    edge_px: float


def grey(image: Image) -> Grey:
    """One channel of 8 bits; 16 bits are stretched."""
    one = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return np.asarray(one if one.dtype == np.uint8 else stretch(one), dtype=np.uint8)


def find(image: Image, board: Board, name: str = "") -> View | Why:
    """The view of a board in a picture, or why there is none."""
    picture = grey(image)
    height, width = picture.shape
    if board.marker_m > 0.0:
        found = _find_charuco(picture, board)
        return Why.NOT_FOUND if found is None else View(name, width, height, *found, 0.0)
    corners = _find_chessboard(picture, (board.columns, board.rows))
    if corners is None:
        return Why.NOT_FOUND
    px = _refined(picture, corners, board)
    if _turned(picture, px, board):
        px = px[::-1].copy()
    edge = _edge_width(picture, px, board)
    if _is_blurred(edge, px, board):
        return Why.BLURRED
    return View(name, width, height, np.arange(len(px)), px, edge)


def size_seen(image: Image, board: Board) -> tuple[int, int] | Why | None:
    """Another number of inner corners that a picture shows a board of, the largest; BLURRED where its edges are; None: none."""
    picture = grey(image)
    near = [(board.columns + i, board.rows + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    sizes = sorted({*near, *_OTHER_SIZES} - {(board.columns, board.rows)}, key=lambda s: -s[0] * s[1])
    for size in sizes:
        if min(size) >= 3 and (px := _find_chessboard(picture, size)) is not None:
            other = Board(*size, board.square_m)
            return Why.BLURRED if _is_blurred(_edge_width(picture, px, other), px, other) else size
    return None


def size_around(image: Image, board: Board) -> tuple[int, int] | None:
    """The inner corners of the larger chessboard that a board found in a picture is a part of; None where there is none."""
    picture, size = grey(image), (board.columns, board.rows)
    larger: tuple[int, int] | None = size
    while larger is not None and board.marker_m == 0.0:
        size = larger
        tries = [(size[0] + i, size[1] + j) for i, j in ((1, 1), (1, 0), (0, 1))]
        larger = next((s for s in tries if _find_chessboard(picture, s) is not None), None)
    return size if size != (board.columns, board.rows) else None


def _is_blurred(edge_px: float, px: Array, board: Board) -> bool:
    return edge_px > max(_BLURRED_PX, _BLURRED_SQUARE * float(np.median(_spacing(px, board))))


def _find_chessboard(picture: Grey, size: tuple[int, int]) -> Array | None:
    """Corners (N, 2) roughly, row by row."""
    enhanced = stretch(median(picture))
    shrink = max(1.0, max(picture.shape) / _SEARCH_PX)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    for candidate in (enhanced, picture):  # where squares are small the median takes too much
        small = (
            candidate
            if shrink == 1.0
            else cv2.resize(candidate, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA)
        )
        ok, corners = cv2.findChessboardCorners(small, size, flags=flags)
        if ok:
            # Pixel centres are at integers: the corner of a shrunk picture's pixel (0, 0) stays at -0.5.
            return np.asarray((np.array(corners, dtype=np.float64).reshape(-1, 2) + 0.5) * shrink - 0.5)
    return None


def _find_charuco(picture: Grey, board: Board) -> tuple[NDArray[np.int64], Array] | None:
    found: Any = cv2.aruco.CharucoDetector(board.charuco).detectBoard(picture)
    corners, ids = found[:2]
    if ids is None or len(ids) < 6:
        return None
    order = np.asarray(ids, dtype=np.int64).ravel()
    if len(set(order // board.columns)) < 2 or len(set(order % board.columns)) < 2:
        return None  # corners in one line do not tell the camera
    return order, np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _refined(picture: Grey, corners: Array, board: Board) -> Array:
    """Corners to a part of a pixel; one off the pattern begins again from there, and stays if it is more of a corner there."""
    smooth = np.asarray(cv2.GaussianBlur(picture, (0, 0), _SMOOTHING_PX), dtype=np.uint8)
    windows = _windows(picture, corners, _FIRST_WINDOW * _spacing(corners, board))
    px = _sub_pixel(smooth, corners, windows)
    predicted, off = _pattern(px, board)
    again = _sub_pixel(smooth, np.where(off[:, None], predicted, px), windows)
    better = off & (_saddle(smooth, again) > _saddle(smooth, px))
    px[better] = again[better]
    windows = _windows(picture, px, _WINDOW * _spacing(px, board))
    return _straightened(_sub_pixel(smooth, px, windows), windows, board)


def _saddle(picture: Grey, px: Array) -> Array:
    """How much of a chessboard's corner is at px (N, 2): I_xy^2 - I_xx I_yy, near 0 on edges and where nothing is."""
    xx, yy, xy = (cv2.Sobel(picture, cv2.CV_64F, i, j, ksize=5) for i, j in ((2, 0), (0, 2), (1, 1)))
    u, v = np.clip(np.rint(px), 0, np.array(picture.shape[::-1]) - 1).astype(np.int64).T
    return np.asarray((xy * xy - xx * yy)[v, u])


def _windows(picture: Grey, px: Array, half_px: Array) -> NDArray[np.int64]:
    """Half windows (N,) [px] as near to half_px as serves a corner and as the picture holds."""
    height, width = picture.shape
    to_border = np.minimum(px, np.array([width - 1.0, height - 1.0]) - px).min(axis=1)
    return np.asarray(np.maximum(np.minimum(np.clip(half_px, *_WINDOW_PX), to_border - 2.0), _LEAST_PX), dtype=np.int64)


def _sub_pixel(picture: Grey, px: Array, windows: NDArray[np.int64]) -> Array:
    """cornerSubPix with a window of its own for each corner."""
    refined = px.copy()
    for w in np.unique(windows):
        some = windows == w
        start = px[some].astype(np.float32).reshape(-1, 1, 2)
        refined[some] = cv2.cornerSubPix(picture, start, (int(w), int(w)), (-1, -1), _STOP).reshape(-1, 2)
    return refined


def _straightened(px: Array, windows: NDArray[np.int64], board: Board) -> Array:
    """Corners (N, 2) without the pull of their curved edges; curvature from the neighbours along both edges."""
    grid = px.reshape(board.rows, board.columns, 2)
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


def _spacing(px: Array, board: Board) -> Array:
    """Distance (N,) from each corner to its nearest neighbour on the board [px]."""
    grid = px.reshape(board.rows, board.columns, 2)
    nearest = np.full((4, board.rows, board.columns), np.inf)
    along, across = np.linalg.norm(np.diff(grid, axis=1), axis=2), np.linalg.norm(np.diff(grid, axis=0), axis=2)
    nearest[0, :, 1:] = nearest[1, :, :-1] = along
    nearest[2, 1:] = nearest[3, :-1] = across
    return np.asarray(nearest.min(axis=0).ravel())


def _pattern(px: Array, board: Board) -> tuple[Array, NDArray[np.bool_]]:
    """Where a homography and a cubic for the lens put the corners, fitted robustly, and which corners are off it."""
    xy = board.points[:, :2]
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


def _turned(picture: Grey, px: Array, board: Board) -> bool:
    """Whether corner 0 is at the wrong end: the square inside corners 0 and columns + 1 is to be the darker kind.

    With an odd number of squares between the end corners' own squares the two ends differ in colour; else they look alike and
    nothing can be told (stereo then compares the two pictures, camera-imu one with the next).
    """
    if board.ends_alike:
        return False
    grid = px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    levels = cv2.remap(picture, middles[..., 0].astype(np.float32), middles[..., 1].astype(np.float32), cv2.INTER_LINEAR)
    parity = np.add.outer(np.arange(board.rows - 1), np.arange(board.columns - 1)) % 2
    return bool(levels[parity == 0].mean() > levels[parity == 1].mean())


def _edge_width(picture: Grey, px: Array, board: Board) -> float:
    """Pixels that the board's edges take from 10 to 90 % of their height; 0 where squares are too small to tell."""
    corners = px.astype(np.float32).reshape(-1, 1, 2)
    width = float(np.ravel(cv2.estimateChessboardSharpness(picture, (board.columns, board.rows), corners)[0])[0])
    return width if width < _UNKNOWN_PX else 0.0
