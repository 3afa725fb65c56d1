"""The map in memory: descriptions, and which landmarks are near, against looking at every one of them."""

import math

import numpy as np
import pytest

from models.maps.landmarks import WEIGHTS, Landmark, LandmarkMap
from models.maps.table import Defaults
from models.messages import Array

ORIGIN = (45.0, 7.0, 200.0)


def box(id: str, north: float, east: float, length: float = 10.0, width: float = 4.0, **more: float) -> Landmark:  # noqa: A002
    half = np.array([[length, width], [length, -width], [-length, -width], [-length, width]]) / 2
    return Landmark.of(id, half + np.array([north, east]), **more)  # type: ignore[arg-type]


def scattered(count: int, seed: int) -> LandmarkMap:
    """Boxes of many sizes over 2 x 3 km, a few of them hundreds of metres long."""
    rng = np.random.default_rng(seed)
    lengths = np.exp(rng.uniform(0.0, math.log(30.0), count))
    lengths[:5] = 600.0
    places = rng.uniform([-1000.0, 500.0], [1000.0, 3500.0], (count, 2))
    return LandmarkMap.from_landmarks(
        ORIGIN,
        [
            box(str(i), place[0], place[1], length, 0.6 * length)
            for i, (place, length) in enumerate(zip(places, lengths, strict=True))
        ],
    )


def test_description_and_roof() -> None:
    landmark = box("hangar", 100.0, -50.0, base_d=3.0, height_m=5.0)
    assert (landmark.size_m2, landmark.width_m, landmark.length_m) == pytest.approx((40.0, 4.0, 10.0))
    assert landmark.fill_ratio == pytest.approx(1.0)
    assert math.sin(landmark.orientation_rad) == pytest.approx(0.0, abs=1e-12)
    assert landmark.centre_n == pytest.approx((100.0, -50.0))
    assert landmark.roof_d == -2.0
    assert landmark.weights == WEIGHTS
    assert landmark.label == "hangar"


def test_outline_runs_anticlockwise_however_it_was_given() -> None:
    one_way = [(0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0)]
    for points in (one_way, one_way[::-1]):
        n, e = Landmark.of("a", points).outline_n.T
        assert np.sum(e * np.roll(n, -1) - np.roll(e, -1) * n) > 0


@pytest.mark.parametrize(
    "points", [[(0.0, 0.0), (1.0, 0.0)], [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], [(0.0, 0.0), (1.0, 0.0), (1.0, math.nan)]]
)
def test_what_has_no_area_is_refused(points: list[tuple[float, float]]) -> None:
    with pytest.raises(ValueError, match="landmark a: outline"):
        Landmark.of("a", points)


def test_map_gives_back_what_it_was_made_of() -> None:
    given = [
        Landmark.of(
            "a", [(0, 0), (10, 0), (10, 4)], -1.0, 6.0, (10, 20, 255), 0.5, 1.0, 0.3, (0.1, 0.2, 0.3, 0.4), name="red shed"
        ),
        box("b", 50.0, 60.0),
    ]
    the_map = LandmarkMap.from_landmarks(ORIGIN, given)
    assert len(the_map) == 2
    assert "a" in the_map
    assert "c" not in the_map
    for landmark in given:
        for found in (the_map[landmark.id], next(x for x in the_map if x.id == landmark.id)):
            for field in Landmark.__struct_fields__:
                np.testing.assert_array_equal(getattr(found, field), getattr(landmark, field), err_msg=field)
    with pytest.raises(KeyError):
        the_map["c"]
    with pytest.raises(ValueError, match="same id"):
        LandmarkMap.from_landmarks(ORIGIN, [given[0], given[0]])


@pytest.mark.parametrize("radius", [0.0, 5.0, 80.0, 700.0, 1e6])
@pytest.mark.parametrize("count", [6, 40, 2000])
def test_near_finds_what_looking_at_all_of_them_finds(count: int, radius: float) -> None:
    the_map = scattered(count, seed=count)
    circles = [(x.centre_n, float(np.max(np.linalg.norm(x.outline_n - x.centre_n, axis=1))), x.id) for x in the_map]
    rng = np.random.default_rng(9)
    for north, east in rng.uniform([-1500.0, 0.0], [1500.0, 4000.0], (40, 2)):
        distances: list[tuple[float, str]] = []
        for centre, reach, name in circles:
            d = math.hypot(centre[0] - north, centre[1] - east)
            if d <= radius + reach:
                distances.append((d, name))
        assert [x.id for x in the_map.near(north, east, radius)] == [name for _, name in sorted(distances)]


@pytest.mark.parametrize(
    "where", [(1e7, 0.0, 10.0), (math.nan, 0.0, 10.0), (0.0, math.inf, 10.0), (0.0, 0.0, math.nan), (0.0, 2000.0, -1.0)]
)
def test_nowhere_there_is_nothing(where: tuple[float, float, float]) -> None:
    assert scattered(40, 0).near(*where) == []


def test_an_empty_map_is_a_map() -> None:
    empty = LandmarkMap.from_landmarks(ORIGIN, [])
    assert len(empty) == 0
    assert empty.near(0.0, 0.0, 1e9) == []
    assert list(empty) == []


def test_all_in_one_place() -> None:
    the_map = LandmarkMap.from_landmarks(ORIGIN, [box(str(i), 5.0, 6.0) for i in range(30)])
    assert len(the_map.near(5.0, 6.0, 1.0)) == 30
    assert the_map.near(50.0, 6.0, 1.0) == []


def test_rows_are_those_of_the_columns() -> None:
    the_map = scattered(50, 1)
    rows = the_map.rows_near(0.0, 2000.0, 300.0)
    names = [the_map.columns.ids[i] for i in rows]
    assert names == [x.id for x in the_map.near(0.0, 2000.0, 300.0)]
    sizes: Array = the_map.description[rows, 0]
    assert sizes.tolist() == [the_map[name].size_m2 for name in names]


def test_one_in_another() -> None:
    the_map = LandmarkMap.from_landmarks(
        ORIGIN, [box("hall", 0.0, 0.0, 40.0, 20.0), box("beside", 0.0, 20.0), box("tower", 5.0, 3.0), box("far", 500.0, 0.0)]
    )
    assert the_map.nested().tolist() == [[0, 2]]
    ring = Landmark.of("l", [(0, 0), (0, 30), (10, 30), (10, 10), (30, 10), (30, 0)])
    assert len(LandmarkMap.from_landmarks(ORIGIN, [ring, box("in its corner", 20.0, 20.0, 6.0, 6.0)]).nested()) == 0
    assert len(LandmarkMap.from_landmarks(ORIGIN, []).nested()) == 0


def test_a_map_that_a_program_picked_reports_so_in_its_file() -> None:
    pad = Landmark.of("pad", [(0, 0), (0, 4), (4, 4), (4, 0)])
    picked = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [pad])
    assert b"automatic" not in picked.to_geojson()
    assert not LandmarkMap.from_geojson(picked.to_geojson()).automatic
    picked.automatic = True
    assert LandmarkMap.from_geojson(picked.to_geojson()).automatic


def test_by_how_much_the_whole_map_may_be_shifted_is_kept_in_its_file() -> None:
    pad = Landmark.of("pad", [(0, 0), (0, 4), (4, 4), (4, 0)])
    the_map = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [pad], (0.4, 0.8))
    assert LandmarkMap.from_geojson(the_map.to_geojson()).common_sigma_m == (0.4, 0.8)
    assert LandmarkMap.from_geojson(the_map.to_geojson(), Defaults(common_sigma_m=(2.0, 3.0))).common_sigma_m == (2.0, 3.0)
    without = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [pad])
    assert b"common_sigma_m" not in without.to_geojson()
    assert LandmarkMap.from_geojson(without.to_geojson()).common_sigma_m == (0.0, 0.0)
