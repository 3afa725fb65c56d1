"""Sub-pixel corners of a chessboard or ChArUco board (thesis 5.1.1, steps 2-6).

grey -> median 5 -> contrast stretch -> find the board -> corners refined on the grey image (corners.py).
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.board.corners import Grey, is_first_kind, levels_at, middles_of, refined, spacing
from calib.errors import CalibrationError
from models.messages import Array
from vision.image.enhance import median, stretch
from vision.image.rectify import Image

_SEARCH_PX = 1500  # larger images are searched at reduced size
_BLURRED_PX: Final = 6.0  # an edge that takes more pixels from 10 to 90 % is blurred ...
_BLURRED_SQUARE: Final = 0.25  # ... and so is one that takes this part of a square
_UNKNOWN_PX: Final = 9999.0  # OpenCV's word for it
_LARGEST_M: Final = 2.0  # of a square
_OTHER_SIZES: Final = (
    (9, 6), (8, 6), (7, 6), (7, 5), (6, 5), (6, 4), (8, 5), (10, 7), (11, 8), (5, 4), (8, 7), (9, 7), (11, 7), (13, 9),
)  # fmt: skip


class Why(StrEnum):
    """Why an image gives no view."""

    NOT_FOUND = "no board found"
    BLURRED = "blurred"


@dataclass(frozen=True)
class Board:
    """columns x rows inner corners, squares of square_m; marker_m > 0: ChArUco."""

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
        """Corners (N, 3) in o [m]: x along columns, y along rows, z = 0."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2)
        return np.column_stack((self.square_m * grid, np.zeros(len(grid))))

    @property
    def size(self) -> tuple[int, int]:
        """Inner corners, columns and rows."""
        return self.columns, self.rows

    @property
    def ends_alike(self) -> bool:
        """Whether the board looks the same upside down."""
        return self.marker_m == 0.0 and (self.columns + self.rows) % 2 == 0

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board, counted in squares."""
        kinds = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, kinds)


@dataclass(frozen=True, eq=False)
class View:
    """Corners `ids` of Board.points at px (N, 2) in one camera; edge_px: sharpness."""

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
    """The view of a board, or why there is none."""
    grey_image = grey(image)
    height, width = grey_image.shape
    if board.marker_m > 0.0:
        found = _find_charuco(grey_image, board)
        return Why.NOT_FOUND if found is None else View(name, width, height, *found, 0.0)
    corners = _find_chessboard(grey_image, board.size)
    if corners is None:
        return Why.NOT_FOUND
    px = refined(grey_image, corners, board.size)
    if _turned(grey_image, px, board):
        px = px[::-1].copy()
    edge = _edge_width(grey_image, px, board)
    if _is_blurred(edge, px, board):
        return Why.BLURRED
    return View(name, width, height, np.arange(len(px)), px, edge)


def size_seen(image: Image, board: Board) -> tuple[int, int] | Why | None:
    """Another number of inner corners that an image shows; None: none."""
    grey_image = grey(image)
    near = [(board.columns + i, board.rows + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    sizes = sorted({*near, *_OTHER_SIZES} - {board.size}, key=lambda s: -s[0] * s[1])
    for size in sizes:
        if min(size) >= 3 and (px := _find_chessboard(grey_image, size)) is not None:
            other = Board(*size, board.square_m)
            return Why.BLURRED if _is_blurred(_edge_width(grey_image, px, other), px, other) else size
    return None


def size_around(image: Image, board: Board) -> tuple[int, int] | None:
    """Inner corners of a larger chessboard around; None: none."""
    grey_image, size = grey(image), board.size
    larger: tuple[int, int] | None = size
    while larger is not None and board.marker_m == 0.0:
        size = larger
        tries = [(size[0] + i, size[1] + j) for i, j in ((1, 1), (1, 0), (0, 1))]
        larger = next((s for s in tries if _find_chessboard(grey_image, s) is not None), None)
    return size if size != board.size else None


def _is_blurred(edge_px: float, px: Array, board: Board) -> bool:
    return edge_px > max(_BLURRED_PX, _BLURRED_SQUARE * float(np.median(spacing(px, board.size))))


def _find_chessboard(grey_image: Grey, size: tuple[int, int]) -> Array | None:
    enhanced = stretch(median(grey_image))
    shrink = max(1.0, max(grey_image.shape) / _SEARCH_PX)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    for candidate in (enhanced, grey_image):  # where squares are small the median takes too much
        small = (
            candidate
            if shrink == 1.0
            else cv2.resize(candidate, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA)
        )
        ok, corners = cv2.findChessboardCorners(small, size, flags=flags)
        if ok:
            # Pixel centres are at integers: the corner of a shrunk image's pixel (0, 0) stays at -0.5.
            return np.asarray((np.array(corners, dtype=np.float64).reshape(-1, 2) + 0.5) * shrink - 0.5)
    return None


def _find_charuco(grey_image: Grey, board: Board) -> tuple[NDArray[np.int64], Array] | None:
    found: Any = cv2.aruco.CharucoDetector(board.charuco).detectBoard(grey_image)
    corners, ids = found[:2]
    if ids is None or len(ids) < 6:
        return None
    order = np.asarray(ids, dtype=np.int64).ravel()
    if len(set(order // board.columns)) < 2 or len(set(order % board.columns)) < 2:
        return None  # corners in one line do not tell the camera
    return order, np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _turned(grey_image: Grey, px: Array, board: Board) -> bool:
    """Whether corner 0 is at the wrong end: the square inside it must be dark."""
    if board.ends_alike:
        return False
    levels, first = levels_at(grey_image, middles_of(px, board.size)), is_first_kind(board.size)
    return bool(levels[first].mean() > levels[~first].mean())


def _edge_width(grey_image: Grey, px: Array, board: Board) -> float:
    corners = px.astype(np.float32).reshape(-1, 1, 2)
    width = float(np.ravel(cv2.estimateChessboardSharpness(grey_image, board.size, corners)[0])[0])
    return width if width < _UNKNOWN_PX else 0.0
