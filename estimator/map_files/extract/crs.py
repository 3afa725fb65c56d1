"""Layer coordinates to longitude and latitude: own formulas, else pyproj (landfix[geo])."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from models.maps import projection
from models.maps.table import MapError
from models.messages import Array

ToLonLat = Callable[[Array], Array]  # (n, 2) -> (n, 2) degrees


def to_lonlat(crs: Any, where: str) -> ToLonLat | None:
    """From an EPSG code ("EPSG:25832"), WKT, or PROJJSON; None: degrees already. Raises MapError."""
    epsg = _epsg(crs)
    if crs is None or crs == "" or epsg in {4326, 4979} or "CRS84" in str(crs):
        return None
    if epsg and projection.to_lonlat(epsg, np.zeros((1, 2))) is not None:
        known: int = epsg
        return lambda xy: np.asarray(projection.to_lonlat(known, xy))
    transform = _transformer(crs, where)
    return lambda xy: np.column_stack(transform.transform(xy[:, 0], xy[:, 1]))


def box_of(crs: Any, box: tuple[float, float, float, float], where: str) -> tuple[float, float, float, float]:
    """A box of degrees in the coordinates of a layer. Raises MapError."""
    if to_lonlat(crs, where) is None:
        return box
    west, south, east, north = _transformer(crs, where).transform_bounds(*box, direction="INVERSE")
    return float(west), float(south), float(east), float(north)


def _transformer(crs: Any, where: str) -> Any:
    try:
        import pyproj  # noqa: PLC0415  (an extra)
    except ImportError:
        raise MapError(f"{where}: its coordinate system needs pyproj: pip install 'landfix[geo]'") from None
    try:
        return pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.CRSError:
        raise MapError(f"{where}: coordinate system {str(crs)[:60]!r} is not known") from None


def _epsg(crs: Any) -> int:
    if isinstance(crs, dict):
        code = crs.get("id", {})
        return int(code["code"]) if code.get("authority") == "EPSG" and str(code.get("code")).isdecimal() else 0
    found = re.fullmatch(r"(?:urn:ogc:def:crs:)?EPSG:+(\d+)", str(crs or ""))
    return int(found[1]) if found else 0
