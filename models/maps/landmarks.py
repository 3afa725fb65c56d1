"""The map: landmarks by description and position.

A landmark is an upright prism over flat ground; height 0: painted. Stored as columns, objects are made on demand.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain
from typing import Self

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.frames import Origin
from models.maps import geojson
from models.maps import outline as polygon
from models.maps.colours import Colour
from models.maps.table import WEIGHTS, Alike, Columns, Defaults, MapReport, Weights
from models.messages import Array, Vec3
from models.order import ranked

__all__ = ["WEIGHTS", "Columns", "Landmark", "LandmarkMap"]


class Landmark(msgspec.Struct, frozen=True, eq=False):
    """One landmark; metres, n at the map's origin.

    outline_n: (K, 2) north, east of the roof's edge, anticlockwise from above, open; base_d: down of the ground; height_m: roof
    above it. sigma_m: horizontal, per axis; outline_sigma_m: growth of the outline; corner_sigma_m: of each corner, per axis.
    weights: of size, width, length, fill ratio. orientation_rad: long side, north to east, 0..pi.
    """

    id: str
    outline_n: Array
    base_d: float
    height_m: float
    colour_bgr: Colour | None
    sigma_m: float
    height_sigma_m: float
    outline_sigma_m: float
    weights: Weights
    size_m2: float
    width_m: float
    length_m: float
    fill_ratio: float
    orientation_rad: float
    centre_n: tuple[float, float]
    name: str = ""
    corner_sigma_m: float = 0.0

    @classmethod
    def of(
        cls,
        id: str,  # noqa: A002  (the field's name)
        outline_n: Array | Sequence[tuple[float, float]],
        base_d: float = 0.0,
        height_m: float = 0.0,
        colour_bgr: Colour | None = None,
        sigma_m: float = 0.0,
        height_sigma_m: float = 0.0,
        outline_sigma_m: float = 0.0,
        weights: Weights = WEIGHTS,
        name: str = "",
        corner_sigma_m: float = 0.0,
    ) -> Self:
        """A landmark with computed description; either orientation. Raises ValueError without area."""
        outline = np.array(outline_n, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 or not np.isfinite(outline).all():
            raise ValueError(f"landmark {id}: outline must be (K, 2) with K >= 3 and finite")
        if polygon.area(outline) < 0.0:
            outline = np.ascontiguousarray(outline[::-1])
        d = polygon.describe(outline, np.array([0, len(outline)]))[0].tolist()
        if d[polygon.SIZE] <= 0.0:
            raise ValueError(f"landmark {id}: outline has no area")
        size, width, length, fill, orientation, north, east, _ = d
        return cls(
            id, outline, base_d, height_m, colour_bgr, sigma_m, height_sigma_m, outline_sigma_m, weights,
            size, width, length, fill, orientation, (north, east), name, corner_sigma_m,
        )  # fmt: skip

    @property
    def roof_d(self) -> float:
        """Down of the roof."""
        return self.base_d - self.height_m

    @property
    def label(self) -> str:
        """Name for people."""
        return self.name or self.id


class LandmarkMap:
    """Landmarks around an origin (lat_deg, lon_deg, alt_m above the ellipsoid), with a spatial index.

    report: of the file; common_sigma_m: shift of all, horizontal and vertical; automatic: unchecked, so one landmark alone gives
    no fix.
    """

    def __init__(
        self,
        origin: Vec3,
        columns: Columns,
        report: MapReport | None = None,
        common_sigma_m: tuple[float, float] = (0.0, 0.0),
        automatic: bool = False,
    ) -> None:
        self.origin = origin
        self.columns = columns
        self.report = report or MapReport(len(columns.ids))
        self.common_sigma_m = common_sigma_m
        self.automatic = automatic
        self.description = polygon.describe(columns.vertices, columns.offsets)  # (N, 8), columns: models/maps/outline.py
        self._index = _Grid(self.description)

    @classmethod
    def from_landmarks(
        cls, origin: Vec3, landmarks: Iterable[Landmark], common_sigma_m: tuple[float, float] = (0.0, 0.0)
    ) -> Self:
        """A map of these landmarks; equal ids raise ValueError."""
        several = list(landmarks)
        if len({landmark.id for landmark in several}) < len(several):
            raise ValueError("map: two landmarks have the same id")
        sizes = [len(landmark.outline_n) for landmark in several]
        columns = Columns(
            ids=[landmark.id for landmark in several],
            vertices=np.concatenate([np.empty((0, 2)), *(landmark.outline_n for landmark in several)]),
            offsets=np.concatenate(([0], np.cumsum(sizes, dtype=np.int64))),
            base_d=np.array([landmark.base_d for landmark in several]),
            height_m=np.array([landmark.height_m for landmark in several]),
            colour_bgr=np.array([landmark.colour_bgr or (-1, -1, -1) for landmark in several], dtype=np.int16).reshape(-1, 3),
            sigma_m=np.array([landmark.sigma_m for landmark in several]),
            height_sigma_m=np.array([landmark.height_sigma_m for landmark in several]),
            outline_sigma_m=np.array([landmark.outline_sigma_m for landmark in several]),
            corner_sigma_m=np.array([landmark.corner_sigma_m for landmark in several]),
            weights={i: landmark.weights for i, landmark in enumerate(several) if landmark.weights != WEIGHTS},
            names={i: landmark.name for i, landmark in enumerate(several) if landmark.name},
        )
        return cls(origin, columns, common_sigma_m=common_sigma_m)

    @classmethod
    def from_geojson(cls, data: bytes, defaults: Defaults | None = None) -> Self:
        """The map of any GeoJSON (docs/map.md); bad features go into `report`. Raises MapError."""
        return cls(*geojson.read(data, defaults or Defaults()))

    def to_geojson(self, alike: Alike | None = None) -> bytes:
        """The file, with descriptions, and ambiguity where given."""
        return geojson.write(self.origin, self.columns, self.description, self.common_sigma_m, self.automatic, alike)

    def __len__(self) -> int:
        return len(self.columns.ids)

    def __getitem__(self, id: str) -> Landmark:  # noqa: A002
        return self._landmarks(np.array([self._row[id]]))[0]

    def __contains__(self, id: str) -> bool:  # noqa: A002
        return id in self._row

    def __iter__(self) -> Iterator[Landmark]:
        blocks = np.array_split(np.arange(len(self)), len(self) // 1000 + 1)
        return chain.from_iterable(map(self._landmarks, blocks))

    @cached_property
    def frame(self) -> Origin:
        """n on the Earth."""
        return Origin(*self.origin)

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.columns.ids)}

    def near(self, north_m: float, east_m: float, radius_m: float) -> list[Landmark]:
        """Landmarks whose bounding circle meets the circle, nearest first."""
        return self._landmarks(self.rows_near(north_m, east_m, radius_m))

    def rows_near(self, north_m: float, east_m: float, radius_m: float) -> NDArray[np.int64]:
        """As near, but row numbers of `columns` and `description`."""
        return self._index.near(north_m, east_m, radius_m)

    def nested(self) -> NDArray[np.int64]:
        """Pairs (P, 2), larger and smaller: centroid of the second inside the first."""
        return self._index.nested(self.columns.vertices, self.columns.offsets)

    def _landmarks(self, rows: NDArray[np.int64]) -> list[Landmark]:
        c = self.columns
        numbers = np.column_stack(
            (
                c.base_d[rows],
                c.height_m[rows],
                c.sigma_m[rows],
                c.height_sigma_m[rows],
                c.outline_sigma_m[rows],
                c.corner_sigma_m[rows],
            )
        )
        table = zip(
            rows.tolist(), c.offsets[rows].tolist(), c.offsets[rows + 1].tolist(), numbers.tolist(), c.colour_bgr[rows].tolist(),
            self.description[rows].tolist(), strict=True,
        )  # fmt: skip
        made = []
        for i, begin, end, (base_d, height, sigma, height_sigma, outline_sigma, corner_sigma), colour, described in table:
            size, width, length, fill, orientation, north, east, _ = described
            bgr = None if colour[0] < 0 else (colour[0], colour[1], colour[2])
            weights, name = c.weights.get(i, WEIGHTS), c.names.get(i, "")
            made.append(Landmark(
                c.ids[i], c.vertices[begin:end], base_d, height, bgr, sigma, height_sigma, outline_sigma, weights,
                size, width, length, fill, orientation, (north, east), name, corner_sigma,
            ))  # fmt: skip
        return made


class _Grid:
    """Centroids sorted by square cell; landmarks larger than a cell apart."""

    def __init__(self, description: Array) -> None:
        circles = np.ascontiguousarray(description[:, [polygon.NORTH, polygon.EAST, polygon.RADIUS]])
        centre, radius = circles[:, :2], circles[:, 2]
        low = centre.min(axis=0, initial=math.inf) if len(centre) else np.zeros(2)
        extent = centre.max(axis=0) - low if len(centre) else np.zeros(2)
        cell = max(50.0, 2.0 * math.sqrt(float(extent[0] * extent[1]) / max(len(centre), 1)), float(extent.max()) / 4000.0)
        shape = (extent // cell).astype(np.int64) + 1
        small, large = np.flatnonzero(radius <= cell), np.flatnonzero(radius > cell)
        cells = ((centre[small] - low) // cell).astype(np.int64)
        keys = cells[:, 0] * shape[1] + cells[:, 1]
        order = small[np.argsort(keys, kind="stable")]
        counts = np.bincount(keys, minlength=int(shape[0] * shape[1]))
        starts = np.concatenate(([0], np.cumsum(counts)))
        self._grid = (circles, low, cell, shape, starts, order, large)

    def near(self, north: float, east: float, radius: float) -> NDArray[np.int64]:
        return _near(north, east, radius, *self._grid)

    def nested(self, vertices: Array, offsets: NDArray[np.int64]) -> NDArray[np.int64]:
        return _nested(vertices, offsets, *self._grid)


@njit(cache=True)
def _near(
    north: float, east: float, radius: float, circles: Array, low: Array, cell: float, shape: NDArray[np.int64],
    starts: NDArray[np.int64], order: NDArray[np.int64], large: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    """Rows of circles (north, east, radius) that meet the circle, by distance."""
    found, distance, count = np.empty(16, np.int64), np.empty(16), int(np.int64(0))
    if not (math.isfinite(north) and math.isfinite(east) and radius >= 0.0):
        return found[:0]
    reach = radius + cell
    first = max(0.0, math.floor((north - reach - low[0]) / cell))
    last = min(shape[0] - 1.0, math.floor((north + reach - low[0]) / cell))
    left = max(0.0, math.floor((east - reach - low[1]) / cell))
    right = min(shape[1] - 1.0, math.floor((east + reach - low[1]) / cell))
    if left <= right:
        for row in range(int(first), int(last) + 1):
            for k in range(starts[row * shape[1] + int(left)], starts[row * shape[1] + int(right) + 1]):
                found, distance, count = _met(order[k], north, east, radius, circles, found, distance, count)
    for k in range(len(large)):
        found, distance, count = _met(large[k], north, east, radius, circles, found, distance, count)
    by_distance, rows = ranked(distance[:count]), np.empty(count, np.int64)
    for k in range(count):
        rows[k] = found[by_distance[k]]
    return rows


@njit(cache=True)
def _met(
    i: int, north: float, east: float, radius: float, circles: Array, found: NDArray[np.int64], distance: Array, count: int
) -> tuple[NDArray[np.int64], Array, int]:
    d = math.hypot(circles[i, 0] - north, circles[i, 1] - east)
    if not d <= radius + circles[i, 2]:
        return found, distance, count
    if count == len(found):
        more, farther = np.empty(2 * count, np.int64), np.empty(2 * count)
        for k in range(count):
            more[k], farther[k] = found[k], distance[k]
        found, distance = more, farther
    found[count], distance[count] = i, d
    return found, distance, count + 1


@njit(cache=True)
def _nested(
    vertices: Array, offsets: NDArray[np.int64], circles: Array, low: Array, cell: float, shape: NDArray[np.int64],
    starts: NDArray[np.int64], order: NDArray[np.int64], large: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    pairs = [(0, 0) for _ in range(0)]
    for inner in range(len(circles)):
        north, east, radius = circles[inner]
        for outer in _near(north, east, 0.0, circles, low, cell, shape, starts, order, large):
            larger = circles[outer, 2] > radius or (circles[outer, 2] == radius and outer < inner)
            if larger and polygon.contains(vertices[offsets[outer] : offsets[outer + 1]], north, east):
                pairs.append((outer, inner))
    result = np.empty((len(pairs), 2), np.int64)
    for k in range(len(pairs)):
        result[k, 0], result[k, 1] = pairs[k]
    return result
