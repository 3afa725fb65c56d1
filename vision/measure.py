"""From a region and its disparities to metres: a plane through the region, distance, width, length, size, fill ratio."""

from dataclasses import dataclass

import numpy as np

from models.messages import Array
from vision.regions import Region

QUANTITIES = ("distance_m", "width_m", "length_m", "size_m2", "fill_ratio")  # the order of Measured.covariance


@dataclass(frozen=True, slots=True)
class Measured:
    """A region in metres, in the frame c of the left (rectified) camera: right, down, forward.

    centre_c          (3,) centroid of the outline on its plane, m;  covariance_c (3, 3) of it
    normal_c          (3,) unit normal of the plane, towards the camera
    axis_c            (3,) unit vector along the length (its sign means nothing)
    outline_c         (K, 3) region.outline on the plane, m
    distance_m        |centre_c|
    width_m, length_m sides of the smallest rectangle around the outline on the plane, width <= length
    size_m2           area inside the outline on the plane
    fill_ratio        size / (width length), thesis section 5.4
    orientation_rad   angle of axis_c from x_c towards y_c, in [0, pi);  orientation_sigma_rad
    covariance        (5, 5) of (distance, width, length, size, fill ratio): all but the last share the error of the depth
    disparity_px      at the centre;  disparity_sigma_px
    """

    region: Region
    centre_c: Array
    covariance_c: Array
    normal_c: Array
    axis_c: Array
    outline_c: Array
    distance_m: float
    width_m: float
    length_m: float
    size_m2: float
    fill_ratio: float
    orientation_rad: float
    orientation_sigma_rad: float
    covariance: Array
    disparity_px: float
    disparity_sigma_px: float

    def sigma(self, quantity: str) -> float:
        """Standard deviation of one of QUANTITIES."""
        i = QUANTITIES.index(quantity)
        return float(np.sqrt(self.covariance[i, i]))


@dataclass(frozen=True, slots=True)
class Unmeasured:
    """A region of which nothing metric is known, and why."""

    region: Region
    reason: str
