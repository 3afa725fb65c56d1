"""The drawn ground of tests/vision/ground/scene.py as an orthophoto on disk, at a place on Earth."""

from pathlib import Path

import cv2
import numpy as np
import pymap3d

from models.maps.projection import from_lonlat
from models.messages import Array, Vec3
from vision.ground.image import GroundImage

ORIGIN: Vec3 = (47.3977, 8.5456, 488.0)
UTM = 32632


def utm_affine(affine: Array, width: int, height: int) -> Array:
    """Pixel -> UTM of pixel -> (north, east): a grid turned against north, as at any place off the zone's middle."""
    px = np.array([[0.0, 0.0, 1.0], [width, 0.0, 1.0], [0.0, height, 1.0], [width, height, 1.0]])
    lat, lon, _ = pymap3d.ned2geodetic(*(px @ affine.T).T, 0.0, *ORIGIN)
    xy = from_lonlat(UTM, np.column_stack((lon, lat)))
    assert xy is not None
    solution: Array = np.linalg.lstsq(px, xy, rcond=None)[0].T
    return solution


def write(image: GroundImage, path: Path) -> Path:
    """The image, and its world file beside it."""
    cv2.imwrite(str(path), image.image)
    height, width = image.image.shape[:2]
    numbers = utm_affine(image.affine, width, height).T.ravel()
    path.with_suffix(".pgw").write_text("\n".join(f"{x:.9f}" for x in numbers))
    return path
