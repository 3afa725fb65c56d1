"""Landmarks for viewers: what a viewer reads back is where the map has it, in ENU."""

from typing import Any

import numpy as np
import pytest

from logs.wire.markers import MARKERS, TOPIC, encode_landmarks
from logs.wire.schemas import STORE
from models.maps.landmarks import Landmark

HOUSE = Landmark.of("7", [(10.0, 20.0), (18.0, 20.0), (18.0, 32.0), (10.0, 32.0)], base_d=-2.0, height_m=5.0, name="Mühle")
PAD = Landmark.of("8", [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)], base_d=1.0)


def _read(used: set[str]) -> list[Any]:
    topic, schema, data = encode_landmarks(1_500_000_000, [HOUSE, PAD], used)
    assert (topic, schema) == (TOPIC, MARKERS) == ("/landfix/landmarks", "visualization_msgs/msg/MarkerArray")
    return list(STORE.deserialize_cdr(data, schema).markers)  # type: ignore[attr-defined]


@pytest.mark.parametrize("used", [set(), {"7"}, {"7", "8"}])
def test_prisms_stand_where_the_map_has_them(used: set[str]) -> None:
    markers = _read(used)
    lines = {m.ns: {(p.x, p.y, p.z) for p in m.points} for m in markers if m.type == 5 and m.action == 0}
    house = {(e, n, up) for e in (20.0, 32.0) for n in (10.0, 18.0) for up in (2.0, 7.0)}
    pad = {(0.0, 0.0, -1.0), (0.0, 4.0, -1.0), (4.0, 4.0, -1.0)}
    assert lines["used"] == (house if "7" in used else set()) | (pad if "8" in used else set())
    assert lines["mapped"] == (house | pad) - lines["used"]
    counts = {m.ns: len(m.points) for m in markers if m.type == 5 and m.action == 0}
    assert sum(counts.values()) == 2 * (12 + 3), "four roof edges, base edges and uprights; three edges of what is flat"


def test_each_has_its_name_above_it() -> None:
    names = [m for m in _read(set()) if m.type == 9]
    assert [m.text for m in names] == ["Mühle", "8"]
    assert len({m.id for m in names}) == 2
    house = names[0].pose.position
    assert (house.x, house.y) == (26.0, 14.0)
    assert 7.0 < house.z < 12.0


def test_the_message_replaces_what_was_drawn_before_and_stays() -> None:
    first, *others = _read({"7"})
    assert (first.action, first.ns) == (3, "")
    assert all(m.action == 0 for m in others)
    for marker in others:
        assert (marker.header.frame_id, marker.header.stamp.sec, marker.header.stamp.nanosec) == ("map", 1, 500_000_000)
        assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, 0)
        assert np.isclose(marker.pose.orientation.w, 1.0)
        assert marker.color.a > 0.5
    used, mapped = (next(m for m in others if m.ns == name) for name in ("used", "mapped"))
    assert used.scale.x > mapped.scale.x > 0.0
    assert used.color.g > used.color.r
    assert mapped.color.r > mapped.color.g
