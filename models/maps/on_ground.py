"""What public map data call what lies on the ground: pools, courts, parking bays, water, helipads. Tags are OpenStreetMap's."""

from collections.abc import Mapping
from typing import Final

SIGMA_M: Final = 0.5  # of its height: the ground is not level
_KINDS: Final[Mapping[str, frozenset[str]]] = {
    "leisure": frozenset({"swimming_pool", "pitch", "track"}),
    "amenity": frozenset({"parking", "parking_space"}),
    "natural": frozenset({"water"}),
    "aeroway": frozenset({"helipad", "runway", "taxiway", "apron"}),
}
_BUILT: Final = ("multi-storey", "underground", "rooftop")  # car parks


def lies_on_ground(tags: Mapping[str, str]) -> bool:
    """Whether an area with such tags has no height: it is no building, and one of these kinds, or a square or street."""
    if tags.get("building", "no") != "no" or tags.get("parking") in _BUILT:
        return False
    return "highway" in tags or any(tags.get(key) in kinds for key, kinds in _KINDS.items())
