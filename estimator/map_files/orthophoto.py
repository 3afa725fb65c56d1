"""Georeferenced images.

GeoTIFF, or a world file (.pgw, .jgw, .tfw, .wld) and a .prj:

(x, y) = A (u, v, 1): plane coordinates of the pixel whose centre is at (u, v)
"""

import mmap
import re
import struct
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
import pymap3d
from numpy.typing import NDArray

from models.maps import projection
from models.maps.landmarks import LandmarkMap
from models.maps.table import MapError
from models.messages import Array
from models.untrusted.boundary import refusing
from models.untrusted.file import content, opened
from models.untrusted.image_header import image_header_of_file, too_large
from models.untrusted.limits import PIPE_BYTES

_SCALE, _TIEPOINT, _TRANSFORM, _KEYS = 33550, 33922, 34264, 34735  # GeoTIFF tags
_RASTER, _GEOGRAPHIC, _PROJECTED, _POINT = 1025, 2048, 3072, 2  # GeoTIFF keys; a pixel's place is its centre
_FORMATS = {2: "s", 3: "H", 4: "I", 12: "d"}  # TIFF's types that these tags have
_LEAST_PX = 4  # that make a colour
_MARGIN = 0.15  # of the width, along the edge: eaves, shadow, mixed pixels
_STRIP = 256  # rows that are stretched at a time
_MOST_PIXELS = 2**30  # as OpenCV
_NO_IMAGE = "not an image that can be read (PNG, JPEG, TIFF of less than 2^30 pixels)"
_STRETCH = (1.0, 99.0)  # percentiles of a 16-bit image that become 0 and 255


class Orthophoto(NamedTuple):
    """Image (H, W[, 3]), affine A (2, 3), EPSG code of x and y."""

    image: NDArray[np.uint8]
    affine: Array
    epsg: int

    @property
    def is_grey(self) -> bool:
        """Whether it has no colours to give."""
        sample = self.image[::7, ::7]
        return bool(np.all(sample == sample[:, :, :1]))


def load(path: Path, epsg: int = 0, *, grey: bool = False) -> Orthophoto:
    """The image of a file; epsg: if not in the file; grey: a third of the memory. Raises MapError."""
    with refusing(MapError, path, OSError):
        image = _decode(path, cv2.IMREAD_ANYDEPTH | (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR))
        return Orthophoto(_to_8_bit(image), *georeference(path, epsg))


def load_raster(path: Path, epsg: int = 0) -> tuple[Array, Array, int]:
    """Values (H, W) of a one-band raster, affine and EPSG code. Raises MapError."""
    with refusing(MapError, path, OSError):
        values = _decode(path, cv2.IMREAD_UNCHANGED)
        if values.ndim != 2:
            raise MapError(f"{path}: has {values.shape[2]} bands, not one of heights")
        return values.astype(np.float64), *georeference(path, epsg)


def georeference(path: Path, epsg: int = 0) -> tuple[Array, int]:
    """Affine (2, 3) and EPSG code of a file; epsg: if not in it. Raises MapError."""
    tags = _tags(path)
    affine = _tiff_affine(tags) if _TIEPOINT in tags or _TRANSFORM in tags else _world_file(path)
    if affine is None:
        raise MapError(
            f"{path}: is not georeferenced: neither a GeoTIFF nor with a world file ({_world_name(path).name}) in the same folder"
        )
    epsg = epsg or _key(tags, _PROJECTED) or _key(tags, _GEOGRAPHIC) or _prj(path)
    if projection.to_lonlat(epsg, np.zeros((1, 2))) is None:
        code = f"EPSG:{epsg} is not known here" if epsg else "is not in its tags"
        option = "--picture-epsg, or picture_epsg of the configuration"
        if 25828 <= epsg <= 25838:  # ETRS89 / UTM drifts off WGS 84 by 2.5 cm a year
            remedy = f"it is WGS 84's of zone {epsg - 25800} within a metre: give {epsg - 25800 + 32600} ({option})"
        else:
            remedy = f"give 4326, 326xx, 327xx or 3857 ({option}), or convert it: gdalwarp -t_srs EPSG:4326 {path.name} OUT.tif"
        raise MapError(f"{path}: coordinate system {code}: {remedy}")
    return affine, epsg


def _decode(path: Path, flags: int) -> cv2.typing.MatLike:
    header = image_header_of_file(path)
    reason = too_large(header, path.stat().st_size, _MOST_PIXELS) if header else _NO_IMAGE
    if reason:
        raise MapError(f"{path}: {reason}")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong stands in our own line
    try:
        image = cv2.imread(str(path), flags)
    except cv2.error:
        image = None
    if image is None:
        raise MapError(f"{path}: {_NO_IMAGE}")
    return image


def coloured(the_map: LandmarkMap, ortho: Orthophoto) -> LandmarkMap:
    """The map, uncoloured landmarks with the image's median colour."""
    columns = the_map.columns
    colours = columns.colour_bgr.copy()
    missing = np.flatnonzero(colours[:, 0] < 0)
    counts = np.diff(columns.offsets)
    lat, lon, _ = pymap3d.ned2geodetic(*columns.vertices.T, np.repeat(columns.base_d, counts), *the_map.origin)
    xy = projection.from_lonlat(ortho.epsg, np.column_stack((lon, lat)))
    assert xy is not None
    px = (xy - ortho.affine[:, 2]) @ np.linalg.inv(ortho.affine[:, :2]).T
    for i in missing.tolist():
        found = _median(ortho.image, px[columns.offsets[i] : columns.offsets[i + 1]])
        if found is not None:
            colours[i] = found
    report = the_map.report
    lacking = {**report.missing, "colour": int(np.sum(colours[:, 0] < 0))}
    return LandmarkMap(
        the_map.origin,
        msgspec.structs.replace(columns, colour_bgr=colours),
        msgspec.structs.replace(report, missing=lacking),
        the_map.common_sigma_m,
        the_map.automatic,
    )


def _median(image: NDArray[np.uint8], px: Array) -> Array | None:
    low, high = np.floor(px.min(axis=0)).astype(int), np.ceil(px.max(axis=0)).astype(int)
    if np.any(low < 0) or np.any(high >= (image.shape[1], image.shape[0])):
        return None
    mask = np.zeros((high[1] - low[1] + 1, high[0] - low[0] + 1), np.uint8)
    cv2.fillPoly(mask, [np.rint((px - low) * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    depth = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    inside = depth > max(1.0, 2.0 * _MARGIN * float(depth.max()))
    if np.sum(inside) < _LEAST_PX:
        return None
    middle: Array = np.median(image[low[1] : high[1] + 1, low[0] : high[0] + 1][inside], axis=0)
    return middle


def _to_8_bit(image: cv2.typing.MatLike) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    low, high = np.percentile(image[::4, ::4], _STRETCH)
    stretched = np.empty(image.shape, dtype=np.uint8)
    for k in range(0, len(image), _STRIP):
        values = image[k : k + _STRIP].astype(np.float32)
        stretched[k : k + _STRIP] = np.clip((values - low) * (255.0 / max(high - low, 1e-9)), 0, 255)
    return stretched


def _world_name(path: Path) -> Path:
    ending = path.suffix.lstrip(".")
    return path.with_suffix(f".{ending[:1]}{ending[-1:]}w")


def _world_file(path: Path) -> Array | None:
    for candidate in (_world_name(path), path.with_suffix(".wld"), Path(f"{path}w")):
        if candidate.exists():
            try:
                numbers = np.array([float(word) for word in content(candidate, PIPE_BYTES).decode().split()])
                affine: Array = numbers.reshape(3, 2).T
            except ValueError:
                raise MapError(f"{candidate}: not a world file of six numbers") from None
            return _regular(affine, candidate)
    return None


def _tiff_affine(tags: dict[int, tuple[float, ...]]) -> Array:
    """GeoTIFF 1.1, section 7.3; (0, 0) is a pixel's corner unless it says point."""
    if _TRANSFORM in tags:
        affine: Array = np.array(tags[_TRANSFORM]).reshape(4, 4)[:2, [0, 1, 3]]
    else:
        (sx, sy), (i, j, _, x, y) = tags.get(_SCALE, (0.0, 0.0))[:2], tags[_TIEPOINT][:5]
        affine = np.array([[sx, 0.0, x - sx * i], [0.0, -sy, y + sy * j]])
    if _key(tags, _RASTER) != _POINT:
        affine[:, 2] += 0.5 * affine[:, :2].sum(axis=1)
    return _regular(affine, "GeoTIFF")


def _prj(path: Path) -> int:
    try:
        text = content(path.with_suffix(".prj"), PIPE_BYTES).decode(errors="replace")
    except OSError:
        return 0
    code = re.search(r'(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?(\d{4,6})"?\s*\]\s*\]\s*$', text)
    if code:
        return int(code[1])
    name = re.match(r'\s*\w+\s*\[\s*"([^"]*)"', text)
    system = name[1].replace("_", " ") if name else ""
    zone = re.fullmatch(r"WGS (?:19)?84 (?:/ )?UTM zone (\d{1,2})([NS])", system, re.IGNORECASE)
    if zone:
        return (32600 if zone[2].upper() == "N" else 32700) + int(zone[1])
    return 4326 if system.upper() in {"GCS WGS 1984", "WGS 84"} else 0


def _regular(affine: Array, name: object) -> Array:
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:, :2])) < 1e-20:
        raise MapError(f"{name}: its georeference is not usable")
    return affine


def _key(tags: dict[int, tuple[float, ...]], key: int) -> int:
    directory = [int(v) for v in tags.get(_KEYS, ())]
    entries = zip(directory[4::4], directory[5::4], directory[7::4], strict=False)
    return next((value for name, place, value in entries if name == key and place == 0), 0)


def _tags(path: Path) -> dict[int, tuple[float, ...]]:
    with opened(path) as file:
        order = {b"II*\0": "<", b"MM\0*": ">"}.get(file.read(4))
        if order is None:
            return {}
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _read_tags(data, order)


def _read_tags(data: mmap.mmap, order: str) -> dict[int, tuple[float, ...]]:
    tags: dict[int, tuple[float, ...]] = {}
    try:
        (start,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, start)
        for k in range(count):
            tag, kind, number = struct.unpack_from(order + "HHI", data, start + 2 + 12 * k)
            if tag in (_SCALE, _TIEPOINT, _TRANSFORM, _KEYS) and kind in _FORMATS:
                if number > len(data):
                    return {}
                form = f"{order}{number}{_FORMATS[kind]}"
                (place,) = struct.unpack_from(order + "I", data, start + 10 + 12 * k)
                tags[tag] = struct.unpack_from(form, data, place if struct.calcsize(form) > 4 else start + 10 + 12 * k)
    except (struct.error, MemoryError, OverflowError):
        return {}
    return tags
