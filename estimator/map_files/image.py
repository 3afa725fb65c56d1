"""The map's image from disk."""

from pathlib import Path

import cv2
import numpy as np
import pymap3d

from estimator.map_files import orthophoto
from estimator.map_files.image_file import ImageFile, LearnedFiles
from estimator.map_files.keypoints import keypoints
from models.maps import projection
from models.maps.table import MapError
from models.messages import Array, Vec3
from models.untrusted.file import content
from vision.ground.features import FeatureMap
from vision.ground.image import GroundImage, Heights
from vision.ground.learned import Learned, Model, ModelError
from vision.recognisers import MapImage

_SPACING_PX = 400  # of the nodes that carry the georeference over to n
_WORST_PX = 0.3  # of that
_DEEPEST_M, _HIGHEST_M = -1000.0, 10_000.0  # of ground: beyond lies "no data"
_RASTER_UNEVEN_M = 1.0  # of what a raster of heights leaves out


def origin(file: ImageFile) -> Vec3:
    """Latitude, longitude [deg], height [m] of the first pixel. Raises MapError, OSError."""
    affine, epsg = orthophoto.georeference(file.path, file.epsg)
    lonlat = projection.to_lonlat(epsg, affine[None, :, 2])
    assert lonlat is not None
    return float(lonlat[0, 1]), float(lonlat[0, 0]), file.height_m or 0.0


def load(file: ImageFile, at: Vec3) -> MapImage:
    """The image in n at an origin, with keypoints. Raises MapError, OSError."""
    photo = orthophoto.load(file.path, file.epsg, grey=True)
    height_m = at[2] if file.height_m is None else file.height_m
    nodes = _nodes(photo.image.shape[1], photo.image.shape[0])
    points = _to_n(_on_earth(photo.affine, photo.epsg, nodes.reshape(-1, 2)), height_m, at)
    affine = _affine(nodes.reshape(-1, 2), points[:, :2], file.path)
    if file.heights:
        heights = _raster(file.heights, file.epsg or photo.epsg, at)
    else:
        of_nodes = affine.copy()  # of numbers of nodes instead of pixels
        step = nodes[1, 1] - nodes[0, 0]
        of_nodes[:, :2] *= step
        level = Heights.level(0.0)
        heights = Heights(points[:, 2].reshape(nodes.shape[:2]), of_nodes, level.unevenness_m, level.slope)
    image = GroundImage(file.path.name, photo.image, affine, heights, file.sigma_m, file.height_sigma_m)
    return MapImage(image, FeatureMap.placed(image, *keypoints(file.path, image)), _learned(file.learned))


def _learned(files: LearnedFiles | None) -> Learned | None:
    if files is None:
        return None
    extractor = Model(str(files.extractor), content(files.extractor), files.extractor_sha256)
    matcher = Model(str(files.matcher), content(files.matcher), files.matcher_sha256)
    try:
        return Learned(extractor, matcher)
    except ModelError as error:
        raise MapError(str(error)) from None


def _nodes(width: int, height: int) -> Array:
    counts = [max(2, -(-(n - 1) // _SPACING_PX) + 1) for n in (width, height)]
    u, v = (np.linspace(0.0, n - 1.0, count) for n, count in zip((width, height), counts, strict=True))
    return np.stack(np.meshgrid(u, v), axis=-1)


def _on_earth(affine: Array, epsg: int, px: Array) -> Array:
    lonlat = projection.to_lonlat(epsg, px @ affine[:, :2].T + affine[:, 2])
    assert lonlat is not None
    return lonlat


def _to_n(lonlat: Array, height_m: float | Array, at: Vec3) -> Array:
    return np.column_stack(pymap3d.geodetic2ned(lonlat[:, 1], lonlat[:, 0], height_m, *at))


def _affine(px: Array, place_n: Array, path: Path) -> Array:
    """place = A (u, v, 1), least squares. Raises MapError: too curved."""
    terms = np.column_stack((px, np.ones(len(px))))
    solution = np.linalg.lstsq(terms, place_n, rcond=None)[0]
    pixel_m = float(np.sqrt(abs(np.linalg.det(solution[:2]))))
    worst = float(np.abs(terms @ solution - place_n).max())
    if not worst < _WORST_PX * pixel_m:
        raise MapError(f"{path}: is too large for one plane ({worst:.1f} m off): cut it into images of a few kilometres")
    return np.ascontiguousarray(solution.T)


def _raster(path: Path, epsg: int, at: Vec3) -> Heights:
    values, affine, code = orthophoto.load_raster(path, epsg)
    empty = ~((values > _DEEPEST_M) & (values < _HIGHEST_M))
    if empty.all():
        raise MapError(f"{path}: holds no heights in metres")
    _, nearest = cv2.distanceTransformWithLabels(empty.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(int(nearest.max()) + 1)
    of_label[nearest[~empty]] = values[~empty]
    values = of_label[nearest]
    height, width = values.shape
    px = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1).reshape(-1, 2)
    points = _to_n(_on_earth(affine, code, px), values.ravel(), at)
    return Heights(points[:, 2].reshape(height, width), _affine(px, points[:, :2], path), _RASTER_UNEVEN_M)
