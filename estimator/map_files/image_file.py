"""Description of a map's image; loads no image library."""

from pathlib import Path
from typing import NamedTuple


class LearnedFiles(NamedTuple):
    """ONNX models of learned matching, with SHA-256 (empty: unchecked)."""

    extractor: Path
    matcher: Path
    extractor_sha256: str = ""
    matcher_sha256: str = ""


class ImageFile(NamedTuple):
    """Georeferenced image with its sigma; ground height above the ellipsoid, or a raster of it."""

    path: Path
    sigma_m: float
    height_m: float | None
    height_sigma_m: float
    heights: Path | None = None
    epsg: int = 0
    learned: LearnedFiles | None = None
