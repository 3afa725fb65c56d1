"""Map files on disk."""

from pathlib import Path

from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError
from models.untrusted.boundary import refusing
from models.untrusted.file import content


def load(path: Path, defaults: Defaults | None = None) -> LandmarkMap:
    """The map of a file. Raises MapError, OSError."""
    data = content(path)
    try:
        with refusing(MapError, "the map"):
            return LandmarkMap.from_geojson(data, defaults)
    except MapError as error:
        raise MapError(f"{path}: {error}") from None
