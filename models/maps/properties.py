r"""GeoJSON properties to a landmark's attributes.

Our names (`height_m`) win over OpenStreetMap's and others'.
"""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec

from models.maps import colours, on_ground
from models.maps.table import WEIGHTS, Defaults, Weights
from models.untrusted.toml_text import one_line

LEVEL_M = 3.0  # height of one storey
EAVE_SIGMA_M = 0.3  # of the roof's edge about the walls' outline
UNKNOWN = (-1, -1, -1)  # colour
_LENGTH = re.compile(r"([-+]?\d+(?:[.,]\d+)?)\s*(m|metres?|meters?|ft|feet|foot|')?\s*(?:(\d+(?:\.\d+)?)\s*\")?", re.IGNORECASE)
_FOOT = 0.3048  # m


class Properties(
    msgspec.Struct,
    rename={
        "osm_id_at": "@id", "building_height": "building:height", "roof_levels": "roof:levels",
        "roof_colour": "roof:colour", "roof_color": "roof:color", "building_colour": "building:colour",
        "building_color": "building:color", "levels": "building:levels", "roof_color_plain": "roof_color",
    },
):  # fmt: skip
    """Properties that are read."""

    id: Any = None
    osm_id_at: Any = None
    osm_id: Any = None
    osm_way_id: Any = None
    osm_type: Any = None
    name: Any = None
    height_m: Any = None
    height_sigma_m: Any = None
    sigma_m: Any = None
    outline_sigma_m: Any = None
    corner_sigma_m: Any = None
    ground_alt_m: Any = None
    colour: Any = None
    weights: Any = None
    height: Any = None
    building_height: Any = None
    levels: Any = None
    roof_levels: Any = None
    num_floors: Any = None
    color: Any = None
    roof_colour: Any = None
    roof_color: Any = None
    roof_color_plain: Any = None
    building_colour: Any = None
    building_color: Any = None
    building: Any = None
    leisure: Any = None
    amenity: Any = None
    parking: Any = None
    natural: Any = None
    aeroway: Any = None
    highway: Any = None
    railway: Any = None
    tunnel: Any = None
    width: Any = None
    lanes: Any = None

    @property
    def tags(self) -> dict[str, str]:
        """Tags of a feature on the ground."""
        kinds = ("building", "leisure", "amenity", "parking", "natural", "aeroway", "highway", "railway")
        return {name: value for name in kinds if isinstance(value := getattr(self, name), str)}


class Attributes(NamedTuple):
    """A landmark without outline. missing: defaulted properties.

    numbers: height_m, height_sigma_m, sigma_m, outline_sigma_m, ground_alt_m, corner_sigma_m.
    """

    numbers: tuple[float, float, float, float, float, float]
    colour_bgr: tuple[int, int, int]
    name: str = ""
    weights: Weights | None = None
    missing: Sequence[str] = ()
    remarks: Sequence[str] = ()


def line_width_m(p: Properties) -> tuple[float, float] | str:
    """Width of a line and sigma of each side [m], or why no landmark."""
    if p.tunnel not in (None, "no"):
        return "it is a tunnel"
    given, lanes = _number("width", p.width, 0.5, 200.0, []), _number("lanes", p.lanes, 0.5, 20.0, [])
    return on_ground.width_m(p.tags, given, lanes) or "a LineString, not a Polygon: give it a width in m"


def read(p: Properties, defaults: Defaults, side_sigma_m: float | None = None) -> Attributes:
    """The attributes. side_sigma_m: of a line."""
    missing: list[str] = []
    remarks: list[str] = []
    flat = side_sigma_m is not None or on_ground.lies_on_ground(p.tags)
    if flat and p.height_m is None:
        height, height_sigma = 0.0, on_ground.SIGMA_M
    else:
        height, height_sigma = _height(p, defaults, missing, remarks)
    own_height_sigma = _number("height_sigma_m", p.height_sigma_m, 0.0, 1e4, remarks)
    sigma = _number("sigma_m", p.sigma_m, 0.0, 1e4, remarks)
    outline_sigma = _number("outline_sigma_m", p.outline_sigma_m, 0.0, 1e3, remarks)
    corner_sigma = _number("corner_sigma_m", p.corner_sigma_m, 0.0, 1e3, remarks)
    ground = _number("ground_alt_m", p.ground_alt_m, -1e3, 1e4, remarks)
    colour = _colour(p, remarks)
    missing += [name for name, value in (("sigma_m", sigma), ("ground_alt_m", ground), ("colour", colour)) if value is None]
    if outline_sigma is None:
        drawn = on_ground.EDGE_SIGMA_M if flat else 0.0 if height == 0.0 else EAVE_SIGMA_M
        outline_sigma = drawn if side_sigma_m is None else side_sigma_m
    numbers = (
        height,
        height_sigma if own_height_sigma is None else own_height_sigma,
        defaults.sigma_m if sigma is None else sigma,
        outline_sigma,
        math.nan if ground is None else ground,
        outline_sigma if corner_sigma is None else corner_sigma,
    )
    name = one_line(p.name) if isinstance(p.name, str) else ""
    weights = None if p.weights is None else _weights(p.weights, remarks)
    return Attributes(numbers, UNKNOWN if colour is None else colour, name, weights, missing, remarks)


def identity(p: Properties, feature_id: str | float | None, number: int) -> str:
    """A feature's `id` property, its id, the source's, else #number."""
    for candidate in (p.id, feature_id, p.osm_id_at):
        if text := _text(candidate):
            return text
    kinds = ((p.osm_type, p.osm_id), ("way", p.osm_way_id))  # ways and relations are numbered each by themselves
    names = (f"{kind}/{text}" if isinstance(kind, str) and kind else text for kind, value in kinds if (text := _text(value)))
    return next(names, f"#{number}")


def _text(identifier: Any) -> str:
    if isinstance(identifier, str):
        return one_line(identifier.strip())
    if isinstance(identifier, (int, float)) and not isinstance(identifier, bool):
        return f"{identifier:.0f}" if float(identifier).is_integer() else str(identifier)
    return ""


def _height(p: Properties, defaults: Defaults, missing: list[str], remarks: list[str]) -> tuple[float, float]:
    height = _number("height_m", p.height_m, 0.0, 1e3, remarks)
    if height is not None:
        return height, 0.0 if height == 0.0 else 0.5
    for name, value in (("height", p.height), ("building:height", p.building_height)):
        if value is not None and value != -1:  # -1: "not known" in machine-made sets
            height = _number(name, value, 0.1, 1e3, remarks)
            if height is not None:
                return height, 1.0
    for name, value in (("building:levels", p.levels), ("num_floors", p.num_floors)):
        levels = _number(name, value, 0.5, 200.0, remarks)
        if levels is not None:
            levels += _number("roof:levels", p.roof_levels, 0.0, 20.0, remarks) or 0.0  # storeys under the roof
            return LEVEL_M * levels, 1.0 + 0.5 * levels
    missing.append("height_m")
    return defaults.height_m, 0.5 * defaults.height_m


def _number(name: str, value: Any, low: float, high: float, remarks: list[str]) -> float | None:
    if value is None:
        return None
    number = value if isinstance(value, (int, float)) and not isinstance(value, bool) else _length(value)
    if number is None:
        remarks.append(f"{name} {value!r} is not a number")
    elif low <= number <= high:
        return float(number)
    else:
        remarks.append(f"{name} {number:g} is not between {low:g} and {high:g}")
    return None


def _length(text: Any) -> float | None:
    r"""Metres of "7", "7,5", "7.5 m", "25 ft", "25'", "25'6\""."""
    found = _LENGTH.fullmatch(text.strip()) if isinstance(text, str) else None
    if found is None:
        return None
    number, unit, inches = float(found[1].replace(",", ".")), (found[2] or "m").lower(), float(found[3] or 0.0)
    return number if unit.startswith("m") else _FOOT * (number + inches / 12.0)


def _colour(p: Properties, remarks: list[str]) -> tuple[int, int, int] | None:
    names = (p.colour, p.color, p.roof_colour, p.roof_color, p.roof_color_plain, p.building_colour, p.building_color)
    for value in names:
        if value is not None:
            colour = colours.parse(value) if isinstance(value, str) else None
            if colour is not None:
                return colour
            remarks.append(f"colour {value!r} is neither a CSS name nor #rrggbb")
    return None


def _weights(value: Any, remarks: list[str]) -> Weights | None:
    try:
        weights = msgspec.convert(value, Weights)
    except msgspec.ValidationError:
        weights = (math.nan,) * 4
    if all(w >= 0.0 for w in weights) and 0.0 < sum(weights) < math.inf:
        return None if weights == WEIGHTS else weights
    remarks.append(f"weights {value!r} are not four numbers >= 0 (size, width, length, fill ratio)")
    return None
