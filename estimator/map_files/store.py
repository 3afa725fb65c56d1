"""Map files on disk."""

from pathlib import Path

from models.maps import geojson
from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError
from models.messages import Vec3
from models.untrusted.boundary import refusing
from models.untrusted.file import content, opened

_HEAD = 4096  # bytes: where a map of ours says its origin


def load(path: Path, defaults: Defaults | None = None) -> LandmarkMap:
    """The map of a file. Raises MapError, OSError."""
    data = content(path)
    try:
        with refusing(MapError, "the map"):
            return LandmarkMap.from_geojson(data, defaults)
    except MapError as error:
        raise MapError(f"{path}: {error}") from None


def origin(path: Path) -> Vec3:
    """Origin of a map file, from its head if possible. Raises as load."""
    with opened(path) as file, refusing(MapError, path):
        own = geojson.origin_of(file.read(_HEAD))
    return own or load(path).origin
