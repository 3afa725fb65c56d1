"""About twenty images that differ most."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.board.chessboard import Board, View
from calib.errors import CalibrationError
from models.messages import Array

ENOUGH: Final = 20  # views, thesis 5.1.1 step 7
FEWEST: Final = 5
_ALIKE: Final = 0.02  # of the image's diagonal: boards that moved less are one view
_GRID = 8  # cells a side of the coverage


def check_sizes(views: Sequence[View], what: str = "images") -> None:
    """Refuse images of different sizes."""
    sizes = {(v.width, v.height): v.name for v in views}
    if len(sizes) > 1:
        (one, name), (other, other_name) = list(sizes.items())[:2]
        raise CalibrationError(
            f"{what} of different sizes: {name} is {one[0]} x {one[1]}, {other_name} {other[0]} x {other[1]}; "
            "calibrate with the size the camera flies with"
        )


def choose(views: Sequence[View], board: Board, count: int = ENOUGH) -> list[int]:
    """At most `count` views, farthest first by mean corner distance [diagonals], from the sharpest.

    Raises CalibrationError where fewer than FEWEST differ.
    """
    if len(views) < FEWEST:
        raise CalibrationError(
            f"{len(views)} usable views of the board, at least {FEWEST} are needed (20 are good): take more images, "
            "the whole board in each, tilted 20-45 degrees each way"
        )
    outlines = _outlines(views, board)
    chosen = [int(np.argmin([v.edge_px for v in views]))]
    nearest = _distance(outlines, chosen[0])
    while len(chosen) < count:
        farthest = int(np.argmax(nearest))
        if nearest[farthest] < _ALIKE:
            break
        chosen.append(farthest)
        nearest = np.minimum(nearest, _distance(outlines, farthest))
    if len(chosen) < FEWEST:
        raise CalibrationError(
            f"the {len(views)} views are all alike (only {len(chosen)} differ): move the board about and tilt it"
        )
    return sorted(chosen)


def coverage(views: Sequence[View]) -> NDArray[np.int64]:
    """Corners in each of 8 x 8 cells of the image."""
    count = np.zeros((_GRID, _GRID), dtype=np.int64)
    for v in views:
        columns = np.clip((v.px[:, 0] + 0.5) / v.width * _GRID, 0, _GRID - 1).astype(int)
        rows = np.clip((v.px[:, 1] + 0.5) / v.height * _GRID, 0, _GRID - 1).astype(int)
        np.add.at(count, (rows, columns), 1)
    return count


def _outlines(views: Sequence[View], board: Board) -> Array:
    ends = board.points[[0, board.columns - 1, -board.columns, -1], :2]
    out = np.empty((len(views), 8))
    for k, v in enumerate(views):
        A = np.column_stack((board.points[v.ids, :2], np.ones(len(v.ids))))
        affine = np.linalg.lstsq(A, v.px, rcond=None)[0]
        whole = dict(zip(v.ids.tolist(), v.px, strict=True))
        corners = [0, board.columns - 1, len(board.points) - board.columns, len(board.points) - 1]
        px = [whole.get(i, np.append(end, 1.0) @ affine) for i, end in zip(corners, ends, strict=True)]
        out[k] = np.ravel(px) / np.hypot(v.width, v.height)
    return out


def _distance(outlines: Array, k: int) -> Array:
    return np.asarray(np.linalg.norm((outlines - outlines[k]).reshape(-1, 4, 2), axis=2).mean(axis=1))
