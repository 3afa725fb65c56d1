"""Map files: what anybody writes is read or gets its reason, what we write comes back, and places are where they are."""

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pymap3d
import pytest

from models.maps.landmarks import WEIGHTS, LandmarkMap
from models.maps.table import Defaults, MapError, reasons
from models.messages import Array

ORIGIN = (47.0, 8.0, 400.0)


def ring(north: float = 0.0, east: float = 0.0, length: float = 12.0, width: float = 8.0) -> list[list[float]]:
    """A closed rectangle, long side north, as longitude and latitude, its corners at 406 m."""
    corners = [(-length, -width), (-length, width), (length, width), (length, -width), (-length, -width)]
    places = [pymap3d.ned2geodetic(north + n / 2, east + e / 2, -6.0, *ORIGIN) for n, e in corners]
    return [[lon, lat] for lat, lon, _ in places]


def feature(coordinates: Any = None, kind: str = "Polygon", id: Any = None, **properties: Any) -> dict[str, Any]:  # noqa: A002
    geometry = {"type": kind, "coordinates": [ring()] if coordinates is None else coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties} | ({} if id is None else {"id": id})


def collection(*features: Any, **more: Any) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": list(features)} | more).encode()


def read(*features: Any, **more: Any) -> LandmarkMap:
    return LandmarkMap.from_geojson(collection(*features, **more), Defaults(origin=ORIGIN))


def test_a_plain_polygon_becomes_a_landmark_with_defaults() -> None:
    the_map = LandmarkMap.from_geojson(collection(feature()), Defaults(height_m=6.0, sigma_m=0.7, origin=ORIGIN))
    (landmark,) = the_map
    assert (landmark.length_m, landmark.width_m, landmark.size_m2) == pytest.approx((12.0, 8.0, 96.0), abs=1e-4)
    assert landmark.fill_ratio == pytest.approx(1.0, abs=1e-6)
    assert landmark.centre_n == pytest.approx((0.0, 0.0), abs=1e-4)
    assert (landmark.height_m, landmark.height_sigma_m, landmark.sigma_m, landmark.outline_sigma_m) == (6.0, 3.0, 0.7, 0.3)
    assert landmark.corner_sigma_m == 0.3, "a person's outline errs at each corner as much as all around"
    assert (landmark.id, landmark.colour_bgr, landmark.weights) == ("#1", None, WEIGHTS)
    assert landmark.base_d == pytest.approx(0.0, abs=1e-4)
    assert the_map.report.missing == {"height_m": 1, "sigma_m": 1, "ground_alt_m": 1, "colour": 1}
    assert the_map.report.rejected == ()


@pytest.mark.parametrize(
    ("properties", "height", "sigma"),
    [
        ({"height_m": 4.5}, 4.5, 0.5),
        ({"height_m": 0}, 0.0, 0.0),
        ({"height_m": 4.5, "height": "9", "height_sigma_m": 0.1}, 4.5, 0.1),
        ({"height": 9}, 9.0, 1.0),
        ({"height": "7,5 m"}, 7.5, 1.0),
        ({"height": "25 ft"}, 7.62, 1.0),
        ({"height": "25'6\""}, 25.5 * 0.3048, 1.0),
        ({"building:levels": "2"}, 6.0, 2.0),
        ({"building:levels": 2, "roof:levels": "1"}, 9.0, 2.5),
        ({"building:height": "12 m", "building:levels": 9}, 12.0, 1.0),
        ({"height": "40 ft"}, 12.192, 1.0),
        ({"num_floors": 4, "height": -1}, 12.0, 3.0),
        ({"height": None, "building:levels": 1}, 3.0, 1.5),
        ({}, 6.0, 3.0),
    ],
)
def test_heights_of_public_data(properties: dict[str, Any], height: float, sigma: float) -> None:
    the_map = read(feature(**properties))
    (landmark,) = the_map
    assert (landmark.height_m, landmark.height_sigma_m) == pytest.approx((height, sigma))
    assert the_map.report.remarks == ()


@pytest.mark.parametrize(
    ("properties", "bgr"),
    [
        ({"colour": "#ff8000"}, (0, 128, 255)),
        ({"roof:colour": "Light_Grey", "building:colour": "red"}, (211, 211, 211)),
        ({"building:colour": "#f00"}, (0, 0, 255)),
        ({"roof_color": "white"}, (255, 255, 255)),
        ({"colour": "navy", "roof:colour": "white"}, (128, 0, 0)),
    ],
)
def test_colours(properties: dict[str, str], bgr: tuple[int, int, int]) -> None:
    (landmark,) = read(feature(**properties))
    assert landmark.colour_bgr == bgr


@pytest.mark.parametrize(
    ("properties", "remark"),
    [
        ({"height": "tall"}, "height 'tall' is not a number"),
        ({"height_m": -3}, "height_m -3 is not between 0 and 1000"),
        ({"sigma_m": True}, "sigma_m True is not a number"),
        ({"colour": "greenish"}, "colour 'greenish' is neither a CSS name nor #rrggbb"),
        ({"weights": [1, 2, 3]}, "weights [1, 2, 3] are not four numbers >= 0 (size, width, length, fill ratio)"),
        ({"weights": [0, 0, 0, 0]}, "weights [0, 0, 0, 0] are not four numbers >= 0 (size, width, length, fill ratio)"),
    ],
)
def test_what_cannot_be_understood_is_remarked_and_taken_as_missing(properties: dict[str, Any], remark: str) -> None:
    the_map = read(feature(**properties))
    (landmark,) = the_map
    assert [finding.text for finding in the_map.report.remarks] == [remark]
    assert (landmark.height_m, landmark.sigma_m, landmark.colour_bgr, landmark.weights) == (6.0, 0.5, None, WEIGHTS)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (feature(id="way/7"), "way/7"),
        (feature(id=12), "12"),
        ({**feature(osm_id=102932)}, "102932"),
        (feature(osm_id=None, osm_way_id="77"), "way/77"),
        (feature(osm_type="relation", osm_id=77), "relation/77"),
        (feature(**{"@id": "relation/9"}), "relation/9"),
        ({**feature(id="outer"), "properties": {"id": "pad"}}, "pad"),
        (feature(id=""), "#1"),
        (feature(id="a\x1b]0;b\x07"), "a ]0;b"),
    ],
)
def test_identifiers(given: dict[str, Any], expected: str) -> None:
    (landmark,) = read(given)
    assert landmark.id == expected


BOW_TIE = [[8.0, 47.0], [8.0001, 47.0001], [8.0001, 47.0], [8.0, 47.0001], [8.0, 47.0]]
A_LINE = [[8.0, 47.0], [8.0001, 47.0], [8.0002, 47.0], [8.0, 47.0]]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (feature([BOW_TIE]), "crosses itself"),
        (feature([ring()[:2]]), "fewer than 3 corners"),
        (feature([A_LINE]), "fewer than 3 corners|smaller than"),
        (feature([[]]), "fewer than 3 corners"),
        (feature([]), "fewer than 3 corners"),
        (feature([ring(length=0.02, width=0.02)]), "smaller than 0.01 m2"),
        (feature([[*ring()[:2], [None, 47.0]]]), "Expected 'float', got 'null'"),
        (feature([[*ring()[:2], [8.0]]]), "fewer than two coordinates"),
        (feature([[*ring()[:2], ["8", "47"]]]), "Expected 'float', got 'str'"),
        (feature([[*ring()[:2], [math.nan, 47.0]]]), "got 'null'"),
        (feature([[*ring()[:2], [1e300, 1e300]]]), "not longitude and latitude"),
        (feature([[[lat, lon] for lon, lat in ring()]]), "exchanged"),
        (feature([[[47.0, 122.0], [47.0, 122.1], [47.1, 122.0]]]), "exchanged"),
        (feature([[[lon + 90.0, lat] for lon, lat in ring()]]), "km or more from the map's origin"),
        (feature([ring(length=2500.0)]), "longer than 2000 m"),
        (feature([8.0, 47.0], kind="Point"), "a Point, not a Polygon"),
        (feature(ring()[:2], kind="LineString", highway="footway"), "a LineString, not a Polygon: give it a width"),
        (feature(ring()[:2], kind="LineString", highway="track", tunnel="yes"), "it is a tunnel"),
        (feature([[8.0]], kind="LineString", highway="track"), "a line of longitude and latitude in degrees"),
        (feature([[4e5, 5e6], [4e5, 6e6]], kind="LineString", highway="track"), "a line of longitude and latitude in degrees"),
        (feature([[8.0, 47.0]], kind="LineString", highway="track"), "no length"),
        ({"type": "Feature", "geometry": None, "properties": None}, "no geometry"),
        ({"type": "Feature", "geometry": 7}, "got 'int'"),
        (17, "got 'int'"),
        (feature(id="good"), "its id is that of feature 1"),
    ],
)
def test_a_bad_feature_gets_its_reason_and_the_others_go_on(bad: Any, reason: str) -> None:
    the_map = read(feature(id="good"), bad, feature([ring(50.0)], id="other"))
    assert [landmark.id for landmark in the_map] == ["good", "other"]
    (finding,) = the_map.report.rejected
    assert finding.feature == 2
    assert any(part in finding.text for part in reason.split("|")), finding.text


@pytest.mark.parametrize(
    ("properties", "height", "outline_sigma"),
    [
        ({"leisure": "swimming_pool"}, 0.0, 0.3),
        ({"leisure": "pitch", "sport": "tennis"}, 0.0, 0.3),
        ({"amenity": "parking_space"}, 0.0, 0.3),
        ({"leisure": "swimming_pool", "building": "yes"}, 6.0, 0.3),
        ({"leisure": "swimming_pool", "height_m": 1.0, "outline_sigma_m": 0.1}, 1.0, 0.1),
        ({"highway": "pedestrian"}, 0.0, 0.3),
        ({"amenity": "parking", "parking": "multi-storey"}, 6.0, 0.3),
        ({"leisure": ["pitch"]}, 6.0, 0.3),
        ({}, 6.0, 0.3),
    ],
)
def test_pools_courts_and_bays_lie_on_the_ground(properties: dict[str, Any], height: float, outline_sigma: float) -> None:
    (found,) = read(feature(**properties))
    assert (found.height_m, found.outline_sigma_m) == (height, outline_sigma)
    assert found.height_sigma_m > 0.0


@pytest.mark.parametrize(
    ("tags", "width", "side_sigma"),
    [
        ({"width": "7 m"}, 7.0, 0.3),
        ({"highway": "residential", "lanes": "2"}, 6.5, 1.0),
        ({"highway": "residential"}, 5.5, 1.0),
        ({"railway": "rail"}, 4.0, 1.0),
    ],
)
def test_a_line_with_a_width_is_a_strip_on_the_ground(tags: dict[str, Any], width: float, side_sigma: float) -> None:
    corners = [list(pymap3d.ned2geodetic(0.0, east, 0.0, *ORIGIN)[1::-1]) for east in (0.0, 100.0)]
    (found,) = read(feature(corners, kind="LineString", **tags))
    assert (found.height_m, found.height_sigma_m, found.outline_sigma_m) == (0.0, 0.5, side_sigma)
    assert (found.width_m, found.length_m) == pytest.approx((width, 100.0), rel=0.01)
    both = read(feature([corners, corners[::-1]], kind="MultiLineString", id="way/7", **tags))
    assert [landmark.id for landmark in both] == ["way/7/1", "way/7/2"]


def test_too_many_corners() -> None:
    t = np.linspace(0.0, 2 * math.pi, 1500, endpoint=False)
    ruff = 100.0 + 20.0 * (np.arange(1500) % 2)
    lat, lon, _ = pymap3d.ned2geodetic(ruff * np.cos(t), ruff * np.sin(t), 0.0, *ORIGIN)
    the_map = read(feature([np.column_stack((lon, lat)).tolist()]))
    assert [finding.text for finding in the_map.report.rejected] == ["more than 1000 corners: simplify the outline"]


def test_an_outline_of_very_many_points_is_refused_before_it_costs_time() -> None:
    """A path there and back, which loses two corners a round; and more points than any roof has."""
    zigzag = [[8.5 + 1e-4 * (k % 2), 47.4 + 1e-7 * k] for k in range(20_000)]
    (back,) = read(feature([zigzag + zigzag[::-1]])).report.rejected
    (many,) = read(feature([zigzag * 6])).report.rejected
    assert (back.text, many.text[:23]) == ("more than 1000 corners: simplify the outline", "more than 100000 points")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"SQLite format 3\0\x10", "GeoPackage: convert it with ogr2ogr"),
        (b"\x00\x00\x27\x0a" + bytes(96), "Shapefile: convert it with ogr2ogr"),
        (b'<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"/>', "KML: convert it with ogr2ogr"),
        (b'<?xml version="1.0"?><osm version="0.6"/>', "OpenStreetMap XML: convert it with ogr2ogr"),
        (b'<a xmlns:gml="http://www.opengis.net/gml"/>', "GML: convert it with ogr2ogr"),
        (b"PK\x03\x04" + bytes(96), "ZIP file, to be unpacked first"),
        (b'{"version": 0.6, "elements": []}', "Overpass JSON: export as GeoJSON"),
        (b'{"version": 0.6, "osm3s": {"copyright": "ODbL"}, "elements": []}', "landfix map get"),
    ],
)
def test_other_forms_of_maps_are_named_with_their_converter(data: bytes, said: str) -> None:
    with pytest.raises(MapError, match=said):
        LandmarkMap.from_geojson(data)


def test_holes_are_left_out_and_said() -> None:
    the_map = read(feature([ring(), ring(length=3.0, width=3.0)]))
    assert [landmark.size_m2 for landmark in the_map] == pytest.approx([96.0], abs=1e-3)
    assert "holes are left out" in the_map.report.remarks[0].text


@pytest.mark.parametrize(("height", "remarks"), [(530.0, 1), (0.0, 0)])
def test_a_third_coordinate_is_said_to_be_unused(height: float, remarks: int) -> None:
    the_map = read(feature([[[*position, height] for position in ring()]]))
    assert len(the_map) == 1
    texts = [finding.text for finding in the_map.report.remarks]
    assert sum("third coordinate (530) is not used: give ground_alt_m" in text for text in texts) == remarks


def test_the_parts_of_a_multipolygon_are_landmarks_of_their_own() -> None:
    the_map = read(feature([[ring()], [ring(40.0)], [BOW_TIE]], kind="MultiPolygon", id="school"))
    assert [landmark.id for landmark in the_map] == ["school/1", "school/2"]
    assert [finding.id for finding in the_map.report.rejected] == ["school/3"]
    assert [landmark.id for landmark in read(feature([[ring()]], kind="MultiPolygon", id="shed"))] == ["shed"]


def test_tenth_of_a_millimetre_edges_are_no_corners() -> None:
    lon, lat = ring()[0]
    the_map = read(feature([[[lon, lat + 1e-9], [lon, lat + 2e-9], *ring()]]))
    assert [len(landmark.outline_n) for landmark in the_map] == [4]


def test_what_is_written_comes_back() -> None:
    first = read(
        feature(id="a", height=7, colour="teal", sigma_m=0.25, ground_alt_m=412.5, name="Müller's shed", weights=[1, 2, 3, 4]),
        feature([ring(5000.0, -8000.0)], id="b", height_m=0, outline_sigma_m=0.05, corner_sigma_m=0.02),
    )
    again = LandmarkMap.from_geojson(first.to_geojson())
    assert again.origin == first.origin
    assert again.report.rejected == again.report.remarks == ()
    for old, new in zip(first, again, strict=True):
        np.testing.assert_allclose(new.outline_n, old.outline_n, atol=2e-4)
        assert new.base_d == pytest.approx(old.base_d, abs=1e-3)
        names = ("id", "name", "height_m", "colour_bgr", "sigma_m", "height_sigma_m", "outline_sigma_m", "corner_sigma_m")
        for name in (*names, "weights"):
            assert getattr(new, name) == getattr(old, name), name
    assert LandmarkMap.from_geojson(again.to_geojson()).to_geojson() == again.to_geojson()


def test_the_file_is_geojson_with_the_description_in_it() -> None:
    written = json.loads(read(feature(id="a", colour="#102030")).to_geojson())
    (it,) = written["features"]
    assert written["landfix"]["origin"] == list(ORIGIN)
    assert it["properties"] == {
        "height_m": 6.0, "height_sigma_m": 3.0, "sigma_m": 0.5, "outline_sigma_m": 0.3, "ground_alt_m": 400.0,
        "corner_sigma_m": 0.3, "size_m2": 96.0, "width_m": 8.0, "length_m": 12.0,
        "fill_ratio": 1.0, "orientation_deg": pytest.approx(0.0, abs=0.01), "colour": "#102030",
    }  # fmt: skip
    outer = it["geometry"]["coordinates"][0]
    assert outer[0] == outer[-1]
    x, y = np.array(outer).T
    assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0, "RFC 7946: anticlockwise"


def test_positions_are_exact_ten_kilometres_away_and_curvature_is_in() -> None:
    """Ground of equal ellipsoid height lies d^2 / 2 R lower in n: 7.8 m at 10 km; a tangent plane would miss it."""
    the_map = read(feature([ring(0.0, 0.0)], id="here"), feature([_square_at(10_000.0, 0.0)], id="there"))
    there = the_map["there"]
    lat, lon, _ = pymap3d.ned2geodetic(10_000.0, 0.0, 0.0, *ORIGIN)
    north, east, _ = pymap3d.geodetic2ned(lat, lon, ORIGIN[2] + 6.0, *ORIGIN)
    assert there.centre_n == pytest.approx((north, east), abs=1e-3)
    assert there.base_d == pytest.approx(10_000.0**2 / (2 * 6_371_000.0), rel=0.01)
    assert the_map["here"].base_d == pytest.approx(0.0, abs=1e-4)
    radius_m = 6_378_137.0 / math.sqrt(1.0 - 6.69438e-3 * math.sin(math.radians(ORIGIN[0])) ** 2)
    flat_east = math.radians(_square_at(0.0, 10_000.0)[0][0] - ORIGIN[1]) * radius_m * math.cos(math.radians(ORIGIN[0]))
    (exact,) = read(feature([_square_at(0.0, 10_000.0)]))
    assert 0.3 < abs(exact.outline_n[:, 1].min() - flat_east) < 5.0, "what longitude times cosine would be off by"


def _square_at(north: float, east: float) -> list[list[float]]:
    lat, lon, _ = pymap3d.ned2geodetic(north, east, 0.0, *ORIGIN)
    return [[lon - 5e-5, lat - 5e-5], [lon + 5e-5, lat - 5e-5], [lon + 5e-5, lat + 5e-5], [lon - 5e-5, lat + 5e-5]]


def test_an_origin_is_found_where_none_is_given() -> None:
    data = collection(*(feature([ring(n)], ground_alt_m=alt) for n, alt in ((0.0, 390.0), (60.0, 400.0), (90.0, 500.0))))
    the_map = LandmarkMap.from_geojson(data)
    assert the_map.origin[2] == 400.0
    assert the_map.origin[:2] == pytest.approx(ORIGIN[:2], abs=2e-3)
    assert [landmark.base_d for landmark in the_map] == pytest.approx([10.0, 0.0, -100.0], abs=0.02)


def test_the_date_line_is_no_edge() -> None:
    lon = [179.9999, -179.9999, -179.9999, 179.9999]
    square = [list(place) for place in zip(lon, [0.0, 0.0, 1e-4, 1e-4], strict=True)]
    (landmark,) = LandmarkMap.from_geojson(collection(feature([square])))
    assert landmark.size_m2 == pytest.approx(22.26 * 11.06, rel=0.01)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "Input data was truncated"),
        (b"\x00\x01", "not a GeoJSON map"),
        (b'{"type":"FeatureCollection","features":[{', "truncated"),
        (b'{"a": 1}', "it has no features"),
        (b"[1, 2]", "not a GeoJSON map"),
        (b'{"features": 5}', "not a GeoJSON map"),
        (b"[" * 100_000, "not a GeoJSON map"),
        (b'{"type":"Topology","objects":{}}', "it has no features"),
        (collection(feature(), crs={"properties": {"name": "EPSG:2056"}}), "coordinate system 'EPSG:2056' is not known here"),
        (collection(feature(), landfix={"origin": [95.0, 0.0, 0.0]}), "the origin"),
        (collection(feature(), landfix={"origin": "here"}), "not a GeoJSON map"),
    ],
)
def test_what_is_no_map_reports_it(data: bytes, message: str) -> None:
    with pytest.raises(MapError, match=message):
        LandmarkMap.from_geojson(data)


def test_other_wrappings() -> None:
    one = json.dumps(feature(id="x")).encode()
    assert [x.id for x in LandmarkMap.from_geojson(one)] == ["x"]
    assert [x.id for x in LandmarkMap.from_geojson(b"\xef\xbb\xbf" + collection(feature(id="x")))] == ["x"]
    lines = b"\n".join(json.dumps(feature([ring(n)], id=f"line{n}")).encode() for n in (0, 50))
    assert [x.id for x in LandmarkMap.from_geojson(lines)] == ["line0", "line50"]
    with_nan = collection(feature(id="y", height=math.nan))
    assert b"NaN" in with_nan
    assert [x.id for x in LandmarkMap.from_geojson(with_nan)] == ["y"]
    assert len(LandmarkMap.from_geojson(collection())) == 0


def test_random_damage_is_never_a_traceback() -> None:
    data = bytearray(
        read(feature(id="a", height=7, colour="teal"), feature([ring(90.0)], id="b", weights=[1, 1, 1, 1])).to_geojson()
    )
    rng = np.random.default_rng(0)
    outcomes = {"map": 0, "error": 0, "rejected": 0}
    messages = []
    for _ in range(1500):
        torn = bytearray(data)
        for at in rng.integers(0, len(torn), int(rng.integers(1, 4))):
            torn[at] = int(rng.integers(0, 256)) if rng.random() < 0.5 else int(rng.choice(list(b'0123456789-.e,[]{}":n')))
        if rng.random() < 0.1:
            torn = torn[: int(rng.integers(0, len(torn)))]
        try:
            the_map = LandmarkMap.from_geojson(bytes(torn))
        except MapError as error:
            outcomes["error"] += 1
            messages.append(str(error))
        else:
            outcomes["rejected" if the_map.report.rejected else "map"] += 1
            assert np.isfinite(the_map.columns.vertices).all()
            assert np.isfinite(the_map.description).all()
    assert min(outcomes.values()) > 50, outcomes
    assert not any("\n" in message for message in messages)


def test_building_footprints_in_utm(landfix_data: Path) -> None:
    """43 footprints over Atlanta; the statistics are those measured in their own UTM frame, whose scale there is 1.00027."""
    the_map = LandmarkMap.from_geojson((landfix_data / "images/spacenet_atlanta_footprints/geotiff_labels.geojson").read_bytes())
    assert len(the_map) == 43
    assert the_map.report.rejected == ()
    size, width, length, fill = np.median(the_map.description[:, :4], axis=0)
    assert (size, length, width) == (pytest.approx(232, abs=1), pytest.approx(22.8, abs=0.1), pytest.approx(11.3, abs=0.1))
    assert fill == pytest.approx(0.81, abs=0.01)
    assert the_map.origin[:2] == pytest.approx((33.639, -84.479), abs=2e-3)


def test_coordinates_beyond_all_bounds_in_a_projection_hurt_nobody_else() -> None:
    square = [[465_000.0, 5_250_000.0], [465_020.0, 5_250_000.0], [465_020.0, 5_250_010.0], [465_000.0, 5_250_010.0]]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
    data = collection(feature([square], id="good"), feature([[[1e300, 1e300], [-1e300, 0.0], [0.0, 1e9]]], id="bad"), crs=crs)
    the_map = LandmarkMap.from_geojson(data)
    assert [(x.id, round(x.size_m2)) for x in the_map] == [("good", 200)]
    assert "not longitude and latitude" in the_map.report.rejected[0].text


def test_utm_agrees_with_the_receiver_s_own_conversion(landfix_data: Path) -> None:
    from models.maps.projection import to_lonlat  # noqa: PLC0415

    rows = np.genfromtxt(landfix_data / "images/brighton_beach_uav/photos.csv", delimiter=",", skip_header=1)
    lonlat = to_lonlat(32615, rows[:, 12:14])
    assert lonlat is not None
    error_m: Array = (lonlat - rows[:, [3, 2]]) * [111e3 * math.cos(math.radians(46.8)), 111e3]
    assert np.abs(error_m).max() < 0.002


def test_reading_does_not_depend_on_who_wrote(landfix_data: Path) -> None:
    """The quick path for our own files and the one for anybody's agree."""
    data = LandmarkMap.from_geojson(
        (landfix_data / "images/spacenet_atlanta_footprints/geotiff_labels.geojson").read_bytes()
    ).to_geojson()
    foreign = json.loads(data)
    for it in foreign["features"]:
        it["properties"]["size_m2"] = "nonsense"  # sends it the other way
    ours, theirs = LandmarkMap.from_geojson(data), LandmarkMap.from_geojson(msgspec.json.encode(foreign))
    assert ours.to_geojson() == theirs.to_geojson()


def street(count: int, turn_deg: float, *, swap: bool) -> bytes:
    """Rectangles turned against north, as longitude and latitude or the other way round."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    outlines = []
    for k in range(count):
        corners = [(c * n - s * e + 40.0 * k, s * n + c * e) for n, e in ((-6, -4), (-6, 4), (6, 4), (6, -4))]
        places = [pymap3d.ned2geodetic(n, e, 0.0, *ORIGIN) for n, e in corners]
        outlines.append(feature([[[lat, lon] if swap else [lon, lat] for lat, lon, _ in places]], id=f"h{k}"))
    return collection(*outlines)


@pytest.mark.parametrize(
    ("count", "turn_deg", "swap", "said"),
    [(12, 30.0, True, True), (12, 30.0, False, False), (12, 0.0, True, False), (3, 30.0, True, False), (3000, 45.0, True, True)],
)
def test_right_angles_tell_that_latitude_and_longitude_are_exchanged(count: int, turn_deg: float, swap: bool, said: bool) -> None:
    """A whole file the wrong way round lies somewhere else on Earth, and nothing but its angles is wrong there."""
    the_map = LandmarkMap.from_geojson(street(count, turn_deg, swap=swap))
    assert len(the_map) == count
    assert ("exchanged" in the_map.report.doubt) == said


def test_reasons_are_counted() -> None:
    far, farther = ([[[lon + d, lat] for lon, lat in ring()]] for d in (5.0, 60.0))
    the_map = read(feature(far), feature([BOW_TIE]), feature(farther))
    far_away, crossed = reasons(the_map.report.rejected)
    assert far_away == ("it lies ... km or more from the map's origin", 2)
    assert crossed == ("the outline crosses itself", 1)
