"""A map from a georeferenced image, by the segmentation of the flight."""

import cv2
import msgspec
import numpy as np
import pymap3d

from estimator.map_files.orthophoto import Orthophoto
from models.maps import projection
from models.maps.colours import Colour, to_hex
from models.maps.outline import crosses_itself
from models.messages import Array
from vision.describe.regions import Limits, Region
from vision.describe.survey import Settings, segment_regions

_LEAST_PX = 4
_WOBBLES_PX = (1.5, 3.0)  # of an outline that is no polygon: what is no corner; the second where the first crosses itself
_PLACE_PX = 1.0  # standard deviation of the image's own place: what a good orthophoto is worth, and no better
_EDGE_PX = 0.5  # by which a whole outline may be larger: blur, mixed pixels, shadow along one side
_MOST_REGIONS = 100_000


def landmarks(ortho: Orthophoto, colours_bgr: tuple[Colour, ...], least_m2: float, sigma_m: float | None = None) -> bytes:
    """GeoJSON of regions of these colours (none: any), marked automatic.

    sigma_m: of the image on Earth, None: a pixel. Without regions at the border.
    """
    pixel_m = resolution_m(ortho)
    limits = Limits(least_px=max(_LEAST_PX, round(least_m2 / pixel_m**2)), least_side_px=3, most=_MOST_REGIONS)
    seeds_of_grey = ortho.is_grey and not colours_bgr
    image = np.ascontiguousarray(ortho.image[:, :, 0]) if seeds_of_grey else ortho.image
    regions = segment_regions(image, None, Settings(colours_bgr, limits=limits))
    regions = [region for region in regions if not region.touches_border]
    sigmas = {"sigma_m": _PLACE_PX * pixel_m if sigma_m is None else sigma_m, "outline_sigma_m": _EDGE_PX * pixel_m}
    features = []
    for k, region in enumerate(regions, 1):
        lonlat = projection.to_lonlat(ortho.epsg, _corners(region) @ ortho.affine[:, :2].T + ortho.affine[:, 2])
        assert lonlat is not None
        blue, green, red = (round(value) for value in region.colour_bgr)
        colour = {} if ortho.is_grey else {"colour": to_hex((blue, green, red))}
        geometry = {"type": "Polygon", "coordinates": [lonlat.tolist()]}
        features.append({"type": "Feature", "id": f"{k}", "properties": {**sigmas, **colour}, "geometry": geometry})
    return msgspec.json.encode({"type": "FeatureCollection", "landfix": {"automatic": True}, "features": features})


def resolution_m(ortho: Orthophoto) -> float:
    """Side of a pixel's square in the image's middle."""
    middle = ortho.affine[:, :2] @ (0.5 * np.array(ortho.image.shape[1::-1])) + ortho.affine[:, 2]
    square = projection.to_lonlat(ortho.epsg, middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) @ ortho.affine[:, :2].T)
    assert square is not None
    north, east, _ = pymap3d.geodetic2ned(square[:, 1], square[:, 0], 0.0, square[0, 1], square[0, 0], 0.0)
    return float(np.sqrt(abs(north[1] * east[2] - north[2] * east[1])))


def _corners(region: Region) -> Array:
    if region.corners is not None:
        return region.corners
    contour, corners = region.contour.astype(np.float32)[:, None], region.contour
    for wobble in _WOBBLES_PX:
        corners = cv2.approxPolyDP(contour, wobble, True)[:, 0].astype(np.float64)
        if not crosses_itself(corners):
            break
    return corners
