"""OpenStreetMap tags of what lies on the ground.

Width: `width`, else 3.25 m a lane, else the kind's usual +-1 m a side.
"""

from collections.abc import Mapping
from typing import Final

SIGMA_M: Final = 0.5  # of its height: the ground is not level
EDGE_SIGMA_M: Final = 0.3  # of an outline that was drawn
_USUAL_SIGMA_M: Final = 1.0
_LANE_M: Final = 3.25
_KINDS: Final[Mapping[str, frozenset[str]]] = {
    "leisure": frozenset({"swimming_pool", "pitch", "track"}),
    "amenity": frozenset({"parking", "parking_space"}),
    "natural": frozenset({"water"}),
    "aeroway": frozenset({"helipad", "runway", "taxiway", "apron"}),
}
_BUILT: Final = ("multi-storey", "underground", "rooftop")  # car parks
_USUAL_M: Final[Mapping[str, Mapping[str, float]]] = {
    "highway": {
        "motorway": 11.0, "trunk": 9.0, "primary": 8.0, "secondary": 7.0, "tertiary": 6.5, "residential": 5.5,
        "unclassified": 5.5, "living_street": 5.0, "service": 4.0, "track": 3.0,
    },
    "aeroway": {"runway": 30.0, "taxiway": 15.0},
    "railway": {"rail": 4.0},
}  # fmt: skip


def lies_on_ground(tags: Mapping[str, str]) -> bool:
    """Whether an area with such tags has no height."""
    if tags.get("building", "no") != "no" or tags.get("parking") in _BUILT:
        return False
    return "highway" in tags or any(tags.get(key) in kinds for key, kinds in _KINDS.items())


def width_m(tags: Mapping[str, str], given_m: float | None, lanes: float | None) -> tuple[float, float] | None:
    """Width of a line and sigma of each side; None if unknown."""
    if given_m is not None:
        return given_m, EDGE_SIGMA_M
    if lanes is not None:
        return _LANE_M * lanes, _USUAL_SIGMA_M
    usual = next((kinds[tags[key]] for key, kinds in _USUAL_M.items() if tags.get(key) in kinds), None)
    return None if usual is None else (usual, _USUAL_SIGMA_M)
