"""Data of identification."""

import math
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.identify.partial import Partial
from vision.identify.similarity import normalised

OBLONG = 1.3  # below this ratio of length to width the axes may be exchanged
_AROUND_M = 40.0  # radius over which the density of objects around an object is taken


class Assumptions(msgspec.Struct, frozen=True):
    """Prior assumptions about world and segmentation."""

    unmapped_fraction: float = 0.3  # of the objects that look like landmarks
    gone_fraction: float = 0.1  # of the map
    found_fraction: float = 0.7  # a landmark wholly in view gives a region
    bad_fraction: float = 0.03  # of the regions: measured badly
    bad_log_size: float = 0.25
    bad_fill_ratio: float = 0.2
    bad_orientation_deg: float = 20.0
    bad_centre: float = 0.3  # of the length
    look_alike_fraction: float = 0.7  # of what is not in the map: resembles what is
    background_per_m2: float = 1e-4  # regions that are no objects at all: shadows, cars, fields
    centre_sigma_m: float = 0.1  # centre of the region against centre of the roof
    size_sigma: float = 0.01  # relative: edges of a region against edges of the roof
    fill_ratio_sigma: float = 0.02
    height_spread_m: float = 1.0  # of what is not in the map, about heights of what is


@dataclass(frozen=True, slots=True)
class Sighting:
    """A region for identification; n at the prior's attitude.

    arm_n (3,): body to region; moved_n (3,): body now to then; depth_sigma: relative; log_size_covariance (2, 2): of (log width,
    log length); orientation_rad: of the length, north to east; partial: cut off, sizes are lower bounds.
    """

    arm_n: Array
    depth_sigma: float
    covariance_n: Array
    size_m2: float
    width_m: float
    length_m: float
    fill_ratio: float
    log_size_covariance: Array
    fill_ratio_sigma: float
    orientation_rad: float
    orientation_sigma_rad: float
    colour_bgr: tuple[float, float, float] | None = None
    moved_n: Array = field(default_factory=lambda: np.zeros(3))
    now: bool = True
    partial: Partial | None = None


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Landmarks near the prior as arrays.

    position_n, variance_n (J, 3): roof centre; features (J, 4): log width, log length, fill ratio, orientation; description,
    weights (J, 4): of the similarity; chroma (J, 2); vertices (V, 2), offsets (J + 1,).
    """

    ids: tuple[str, ...]
    position_n: Array
    variance_n: Array
    features: Array
    outline_sigma_m: Array
    description: Array
    weights: Array
    chroma: Array
    density_per_m2: float
    vertices: Array
    offsets: NDArray[np.int64]

    @property
    def radius_m(self) -> Array:
        """(J,) half the diagonal of the least rectangle."""
        return np.asarray(0.5 * np.hypot(self.description[:, 1], self.description[:, 2]))


def catalogue(landmarks: list[Landmark]) -> Catalogue:
    """The landmarks' numbers side by side."""
    m = landmarks
    position = np.array([(*k.centre_n, k.roof_d) for k in m]).reshape(-1, 3)
    colour = [k.colour_bgr or (math.nan,) * 3 for k in m]
    features = [(math.log(k.width_m), math.log(k.length_m), k.fill_ratio, k.orientation_rad) for k in m]
    return Catalogue(
        ids=tuple(k.id for k in m),
        position_n=position,
        variance_n=np.array([(k.sigma_m, k.sigma_m, k.height_sigma_m) for k in m]).reshape(-1, 3) ** 2,
        features=np.array(features).reshape(-1, 4),
        outline_sigma_m=np.array([k.outline_sigma_m for k in m]),
        description=np.array([(k.size_m2, k.width_m, k.length_m, k.fill_ratio) for k in m]).reshape(-1, 4),
        weights=normalised(np.array([k.weights for k in m]).reshape(-1, 4)),
        chroma=chroma(np.array(colour).reshape(-1, 3)),
        density_per_m2=_density(position),
        vertices=np.concatenate([np.empty((0, 2)), *(k.outline_n for k in m)]),
        offsets=np.cumsum([0, *(len(k.outline_n) for k in m)]),
    )


def chroma(colour_bgr: Array) -> Array:
    """(b, g) / (b + g + r) of colours (..., 3), independent of exposure."""
    total = np.maximum(colour_bgr.sum(axis=-1, keepdims=True), 1.0)
    return np.asarray(colour_bgr[..., :2] / total)


def _density(position: Array) -> float:
    if len(position) < 2:
        return 0.0
    apart = np.hypot(*(position[:, None, :2] - position[None, :, :2]).transpose(2, 0, 1))
    return float(((apart < _AROUND_M).sum() - len(position)) / len(position) / (math.pi * _AROUND_M**2))
