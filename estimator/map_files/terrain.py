"""Ground height from SRTM tiles (.hgt) or GeoTIFF, a file or a folder.

    h_ellipsoid(lat, lon) = bilinear(tile) + N(lat, lon)          N: geoid, where the model's heights are above the sea

SRTM: big-endian int16, from the north-west corner, named after the south-west one (USGS).
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from estimator.map_files.geoid import geoid_m
from estimator.map_files.orthophoto import load_raster
from models.maps import projection
from models.maps.table import MapError
from models.messages import Array

_HGT: Final = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_SUFFIXES: Final = (".hgt", ".tif", ".tiff")
_VOID_M: Final = -1000.0  # no land is lower
_GEOID_STEP_DEG: Final = 0.05  # over which the geoid changes by less than its own error
_MOST_TILES: Final = 64


class _Tile(NamedTuple):
    """inverse (2, 2), start (2,): x, y -> column, row."""

    heights_m: Array
    inverse: Array
    start: Array
    epsg: int

    def at(self, lonlat: Array) -> Array:
        """Bilinear, NaN outside; the outer points cover half a cell more."""
        xy = projection.from_lonlat(self.epsg, lonlat)
        assert xy is not None
        column, row = ((xy - self.start) @ self.inverse.T).T
        height, width = self.heights_m.shape
        inside = (column >= -0.5) & (column <= width - 0.5) & (row >= -0.5) & (row <= height - 0.5)
        column, row = np.clip(np.nan_to_num(column), 0, width - 1), np.clip(np.nan_to_num(row), 0, height - 1)
        i, j = np.minimum(row.astype(int), height - 2), np.minimum(column.astype(int), width - 2)
        s, t, h = row - i, column - j, self.heights_m
        value = (1 - s) * ((1 - t) * h[i, j] + t * h[i, j + 1]) + s * ((1 - t) * h[i + 1, j] + t * h[i + 1, j + 1])
        return np.where(inside, value, np.nan)


class Terrain:
    """A file or folder of tiles. Raises MapError."""

    def __init__(self, source: Path, *, above_ellipsoid: bool = False, progress: Callable[[float], None] | None = None) -> None:
        self._above_ellipsoid = above_ellipsoid
        self._geoid: dict[tuple[int, int], float] = {}
        files = [source]
        if source.is_dir():
            files = sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES)
        if not files or len(files) > _MOST_TILES:
            raise MapError(f"{source}: holds {len(files)} tiles (.hgt, .tif); 1 to {_MOST_TILES} are read")
        self._tiles = []
        for k, path in enumerate(files):
            self._tiles.append(_hgt(path) if path.suffix.lower() == ".hgt" else _geotiff(path))
            if progress:
                progress((k + 1) / len(files))

    def at(self, lonlat: Array) -> Array:
        """Height above the ellipsoid [m] (n,) of longitudes, latitudes (n, 2), NaN outside."""
        heights = np.full(len(lonlat), np.nan)
        for tile in self._tiles:
            unknown = np.isnan(heights)
            if not unknown.any():
                break
            heights[unknown] = tile.at(lonlat[unknown])
        return heights if self._above_ellipsoid else heights + self._undulation(lonlat)

    def _undulation(self, lonlat: Array) -> Array:
        values = []
        for lon, lat in np.rint(lonlat / _GEOID_STEP_DEG).astype(int).tolist():
            if (lon, lat) not in self._geoid:
                self._geoid[lon, lat] = geoid_m(lat * _GEOID_STEP_DEG, lon * _GEOID_STEP_DEG)
            values.append(self._geoid[lon, lat])
        return np.array(values)


def _hgt(path: Path) -> _Tile:
    named = _HGT.match(path.name)
    if named is None:
        raise MapError(f"{path}: an SRTM tile is named after its south-west corner, as in N47E008.hgt")
    try:
        data = np.fromfile(path, dtype=">i2")
    except OSError as error:
        raise MapError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    n = math.isqrt(len(data))
    if n * n != len(data) or n < 2:
        raise MapError(f"{path}: {2 * len(data)} bytes are no square of heights (1201 x 1201 or 3601 x 3601 of 2 bytes)")
    south = int(named[2]) * (1 if named[1] in "Nn" else -1)
    west = int(named[4]) * (1 if named[3] in "Ee" else -1)
    step = 1.0 / (n - 1)
    return _tile(path, data.reshape(n, n).astype(np.float64), np.array([[step, 0.0, west], [0.0, -step, south + 1.0]]), 4326)


def _geotiff(path: Path) -> _Tile:
    try:
        heights, affine, epsg = load_raster(path)
    except OSError as error:
        raise MapError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    return _tile(path, heights, affine, epsg)


def _tile(path: Path, heights_m: Array, affine: Array, epsg: int) -> _Tile:
    if min(heights_m.shape) < 2:
        raise MapError(f"{path}: has only {heights_m.shape[1]} x {heights_m.shape[0]} heights")
    heights_m = np.where(heights_m < _VOID_M, np.nan, heights_m)
    if np.isnan(heights_m).all():
        raise MapError(f"{path}: all of its heights are marked as unknown")
    inverse = np.linalg.inv(affine[:, :2]).astype(np.float64)
    return _Tile(heights_m, inverse, affine[:, 2], epsg)
