"""Height of the geoid above WGS-84: EGM96 on a grid of one degree (Lemoine et al. 1998).

    N(lat, lon): bilinear,   height above the ellipsoid = height above the sea + N

egm96.png: 10 (N + 200) at each degree, 90 N to 90 S, 0 to 359 E; 0.5 m RMS.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from models.messages import Array

SIGMA_M = 0.5
_FILE = Path(__file__).with_name("egm96.png")
_STEPS, _OFFSET_M = 10.0, 200.0  # a metre; so that no number is below 0


def geoid_m(lat_deg: float, lon_deg: float) -> float:
    """N [m] at a place."""
    grid = _grid()
    row, column = 90.0 - float(np.clip(lat_deg, -90.0, 90.0)), lon_deg % 360.0
    i, j = min(int(row), grid.shape[0] - 2), int(column) % grid.shape[1]
    s, t, k = row - i, column - int(column), (j + 1) % grid.shape[1]
    return float((1.0 - s) * ((1.0 - t) * grid[i, j] + t * grid[i, k]) + s * ((1.0 - t) * grid[i + 1, j] + t * grid[i + 1, k]))


@cache
def _grid() -> Array:
    image = cv2.imread(str(_FILE), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image.astype(np.float64) / _STEPS - _OFFSET_M
