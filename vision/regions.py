"""From a mask to regions: connected components, small ones removed, their outlines to a fraction of a pixel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.messages import Array


@dataclass(frozen=True, slots=True)
class Region:
    """One connected region of the left picture (rectified, if the pictures are); pixel centres at integer (u, v).

    contour         (N, 2) closed outline, sub-pixel, anticlockwise as seen in the picture, first point not repeated
    corners         (K, 2) corners of the polygon whose sides were fitted to the contour, same sense; None: not a polygon
    area_px         area inside the contour, px^2
    bbox            (u0, v0, width, height) of the mask, px
    mask            (height, width) bool, the region's pixels inside bbox
    touches_border  whether the picture cuts it off: its sizes are lower bounds
    colour_bgr      mean colour of the inside, 0..255 (three equal numbers for a grey picture)
    edge_sigma_px   standard deviation of the contour's points across the edge, px
    label           which colour class of the segmentation it belongs to
    """

    contour: Array
    corners: Array | None
    area_px: float
    bbox: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    touches_border: bool
    colour_bgr: tuple[float, float, float]
    edge_sigma_px: float
    label: int

    @property
    def outline(self) -> Array:
        """The corners where there are some, else the contour, (K, 2)."""
        return self.contour if self.corners is None else self.corners
