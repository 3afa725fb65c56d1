"""Map files on disk."""

from pathlib import Path

from models.landmarks import LandmarkMap
from models.map_table import Defaults, MapError


def load(path: Path, defaults: Defaults | None = None) -> LandmarkMap:
    """The map of a file. Raises MapError, one line that names the file; OSError where it cannot be read."""
    data = path.read_bytes()
    try:
        return LandmarkMap.from_geojson(data, defaults)
    except MapError as error:
        raise MapError(f"{path}: {error}") from None
