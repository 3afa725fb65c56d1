"""Landmarks for viewers: a MarkerArray in map."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from logs.wire import schemas
from logs.wire.axes import world
from logs.wire.encoding import Encoded, header_of, packed
from logs.wire.schemas import STORE
from models.maps.landmarks import Landmark
from models.messages import Vec3

TOPIC: Final = "/landfix/landmarks"
MARKERS: Final = "visualization_msgs/msg/MarkerArray"

_LINE_LIST, _TEXT = 5, 9
_ADD, _DELETE_ALL = 0, 3
_USED: Final = (0.2, 0.9, 0.3, 1.0)
_MAPPED: Final = (1.0, 0.75, 0.25, 0.9)
_LINE_M: Final = 0.15
_LETTER_M: Final = 2.5
_NO_POINT: Final = (0.0, 0.0, 0.0)


def encode_landmarks(t_ns: int, landmarks: Sequence[Landmark], used: Collection[str]) -> Encoded:
    """Landmarks as line prisms with names; used: ids of the newest fix."""
    inside = [mark for mark in landmarks if mark.id in used]
    others = [mark for mark in landmarks if mark.id not in used]
    markers = [
        _marker(t_ns, "", 0, _LINE_LIST, _DELETE_ALL),
        _lines(t_ns, "used", inside, 2.0 * _LINE_M, _USED),
        _lines(t_ns, "mapped", others, _LINE_M, _MAPPED),
        *(_name(t_ns, k, mark, _USED if mark.id in used else _MAPPED) for k, mark in enumerate(landmarks)),
    ]
    return packed(TOPIC, MARKERS, markers=markers)


def edges(mark: Landmark) -> Iterator[tuple[Vec3, Vec3]]:
    """NED ends of roof edges, base edges, uprights; flat ones: outline only."""
    corners = [(float(north), float(east)) for north, east in mark.outline_n]
    for (n_a, e_a), (n_b, e_b) in zip(corners, [*corners[1:], corners[0]], strict=True):
        yield (n_a, e_a, mark.roof_d), (n_b, e_b, mark.roof_d)
        if mark.height_m > 0.0:
            yield (n_a, e_a, mark.base_d), (n_b, e_b, mark.base_d)
            yield (n_a, e_a, mark.base_d), (n_a, e_a, mark.roof_d)


def _lines(t_ns: int, namespace: str, marks: Iterable[Landmark], width_m: float, colour: tuple[float, ...]) -> Any:
    ends = [point for mark in marks for edge in edges(mark) for point in edge]
    return _marker(t_ns, namespace, 0, _LINE_LIST, _ADD, scale=(width_m, 0.0, 0.0), colour=colour, points=ends)


def _name(t_ns: int, number: int, mark: Landmark, colour: tuple[float, ...]) -> Any:
    above = (*mark.centre_n, mark.roof_d - _LETTER_M)
    return _marker(t_ns, "names", number, _TEXT, _ADD, above, (0.0, 0.0, _LETTER_M), colour, text=mark.label)


def _marker(
    t_ns: int,
    namespace: str,
    number: int,
    kind: int,
    action: int,
    place_n: Vec3 = _NO_POINT,
    scale: Vec3 = _NO_POINT,
    colour: tuple[float, ...] = _MAPPED,
    points: Sequence[Vec3] = (),
    text: str = "",
) -> Any:
    pose = _new("geometry_msgs/msg/Pose", position=_point(place_n), orientation=_new(
        "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0
    ))  # fmt: skip
    nothing = np.zeros(0, np.uint8)
    return _new(
        "visualization_msgs/msg/Marker",
        header=header_of(t_ns, "map"),
        ns=namespace,
        id=number,
        type=kind,
        action=action,
        pose=pose,
        scale=_new("geometry_msgs/msg/Vector3", x=scale[0], y=scale[1], z=scale[2]),
        color=_new("std_msgs/msg/ColorRGBA", **dict(zip("rgba", colour, strict=True))),
        lifetime=_new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[_point(point) for point in points],
        colors=[],
        texture_resource="",
        texture=_new(schemas.COMPRESSED_IMAGE, header=header_of(0, ""), format="", data=nothing),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=_new("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )


def _point(place_n: Vec3) -> Any:
    x, y, z = world(place_n)
    return _new("geometry_msgs/msg/Point", x=x, y=y, z=z)


def _new(name: str, /, **fields: Any) -> Any:
    make: Any = STORE.types[name]
    return make(**fields)
