"""Three buildings come out of every format and coordinate system where they stand, with their heights and their source."""

import gzip
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.map_files.extract.footprint import Place
from estimator.map_files.extract.get import Got, get
from models.frames import Origin
from models.maps.landmarks import LandmarkMap
from models.maps.table import MapError
from models.messages import Array
from tests.estimator.map_files.extract import extracts
from tests.estimator.map_files.extract.extracts import COURT, HOUSE, LAT, LON, PARTS, Ring, square

PLACE = Place(LAT, LON, 2000.0)
Write = Callable[[Path], Path]

FORMATS: dict[str, Write] = {
    "houses.geojson": extracts.geojson,
    "houses_3d.geojson": lambda p: extracts.geojson(p, heights=True),
    "utm.geojson": lambda p: extracts.geojson(p, 32632),
    "mercator.geojson": lambda p: extracts.geojson(p, 3857),
    "etrs.geojson": lambda p: extracts.geojson(p, 25832),
    "swiss.geojson": lambda p: extracts.geojson(p, 2056),
    "houses.geojsonl": extracts.lines,
    "houses.gpkg": lambda p: extracts.gdal(p, "GPKG", 4326),
    "etrs.gpkg": lambda p: extracts.gdal(p, "GPKG", 25832),
    "swiss.gpkg": lambda p: extracts.gdal(p, "GPKG", 2056),
    "houses.shp": lambda p: extracts.gdal(p, "ESRI Shapefile", 4326),
    "mercator.shp": lambda p: extracts.gdal(p, "ESRI Shapefile", 3857),
    "houses.parquet": extracts.parquet,
    "etrs.parquet": lambda p: extracts.parquet(p, 25832),
}
OSM: dict[str, Write] = {
    "geom.json": lambda p: extracts.overpass(p, geometry=True),
    "nodes.json": lambda p: extracts.overpass(p, geometry=False),
    "houses.osm": extracts.osm_xml,
    "houses.osm.pbf": extracts.osm_pbf,
}


def of(path: Path, place: Place = PLACE) -> tuple[LandmarkMap, Got]:
    return get(path, place)


def ned(ring: Ring) -> Array:
    origin = Origin(LAT, LON, 0.0)
    return np.array([origin.to_ned(lat, lon, 0.0)[:2] for lon, lat in ring[:-1]])


def assert_stands(the_map: LandmarkMap, ring: Ring, tolerance_m: float) -> int:
    """Which landmark has exactly these corners."""
    wanted = ned(ring)
    for row in range(len(the_map)):
        a, b = the_map.columns.offsets[row : row + 2]
        found = the_map.columns.vertices[a:b]
        if len(found) == len(wanted) and all(np.hypot(*(found - p).T).min() < tolerance_m for p in wanted):
            return row
    raise AssertionError(f"no landmark at {ring[0]}")


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_and_system_gives_the_same_buildings(name: str, tmp_path: Path) -> None:
    the_map, got = of(FORMATS[name](tmp_path / name))
    assert len(the_map) == got.landmarks == 4  # the house, the courtyard without its hole, both parts
    rows = [assert_stands(the_map, ring, 0.02) for ring in (HOUSE, COURT, *PARTS)]
    heights = the_map.columns.height_m[rows].tolist()
    assert heights == ([8.5, 12.0, 12.0, 12.0] if "parquet" in name else [8.5, 12.0, 6.0, 6.0])
    assert len(set(the_map.columns.ids)) == 4
    assert the_map.columns.sigma_m.tolist() == [2.0] * 4
    assert the_map.common_sigma_m == (1.5, 2.0)


@pytest.mark.parametrize("name", OSM)
def test_openstreetmap_in_every_format(name: str, tmp_path: Path) -> None:
    the_map, got = of(OSM[name](tmp_path / name))
    assert sorted(the_map.columns.ids) == ["relation/51", "way/11"]
    house, court = assert_stands(the_map, HOUSE, 0.05), assert_stands(the_map, COURT, 0.05)
    assert the_map.columns.height_m[[house, court]].tolist() == [6.0, 12.0]  # two storeys; "12 m"
    assert the_map.columns.height_sigma_m[[house, court]].tolist() == [2.0, 1.0]
    assert got.sources == {"OpenStreetMap": 2}
    assert "OpenStreetMap contributors" in got.attribution


def test_a_folder_is_read_as_a_whole_and_gzip_is_unpacked(tmp_path: Path) -> None:
    (tmp_path / "a.geojson.gz").write_bytes(gzip.compress(extracts.geojson(tmp_path / "x").read_bytes()))
    (tmp_path / "x").unlink()
    extracts.overpass(tmp_path / "b.json", geometry=True)
    (tmp_path / "note.txt").write_text("not read")
    the_map, got = of(tmp_path)
    assert len(the_map) == 6
    assert got.sources["OpenStreetMap"] == 2


def test_the_radius_is_kept(tmp_path: Path) -> None:
    path = extracts.geojson(tmp_path / "a.geojson")
    assert len(of(path, Place(LAT, LON, 40.0))[0]) == 1
    with pytest.raises(MapError, match=r"none of its 5 polygons lies within 2 km of 10, 8\.54"):
        of(path, Place(10.0, LON, 2000.0))


@pytest.mark.parametrize("middle", [180.0, -179.9995])
@pytest.mark.parametrize("file", ["geojson", "gpkg"])
def test_a_position_on_the_180th_meridian(middle: float, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One house on each side, and one that the meridian divides, as longitudes beyond 180."""
    west, east, across = (square(lon, -16.5, 10.0) for lon in (179.999, -179.999, 179.99998))
    monkeypatch.setattr(extracts, "POLYGONS", [(str(k), [[ring]], {}) for k, ring in enumerate((west, east, across))])
    path = extracts.geojson(tmp_path / "a.geojson") if file == "geojson" else extracts.gdal(tmp_path / "a.gpkg", "GPKG", 4326)
    the_map, _ = of(path, Place(-16.5, middle, 1000.0))
    assert len(the_map) == 3
    assert np.allclose(the_map.description[:, 0], 100.0, atol=1.0)  # m2
    assert np.abs(the_map.columns.vertices).max() < 300.0


def test_the_map_keeps_the_attribution_and_is_read_again(tmp_path: Path) -> None:
    out = tmp_path / "map.geojson"
    args = ["map", "get", f"{LAT},{LON}", "--km", "2", "--source", str(extracts.overpass(tmp_path / "a.json", geometry=True))]
    said = CliRunner().invoke(app, [*args, "--ground-alt-m", "410", "--sigma-m", "0.7", "-o", str(out)])
    assert said.exit_code == 0
    assert "2 landmarks (OpenStreetMap 2), 2 with a height" in said.stdout
    assert "OpenStreetMap contributors" in json.loads(out.read_text())["attribution"]
    again = LandmarkMap.from_geojson(out.read_bytes())
    assert again.origin == (LAT, LON, 410.0)
    assert again.columns.sigma_m.tolist() == [0.7, 0.7]
    assert again.common_sigma_m == (0.0, 0.0)
    checked = CliRunner().invoke(app, ["map", "check", str(out), "--json"])
    assert checked.exit_code == 0


def test_what_cannot_be_read_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, content in (
        ("torn.geojson", b'{"type": "FeatureCollection", "features": [{'), ("list.json", b"[1, 2]"), ("a.gpkg", b"no database"),
        ("a.parquet", b"PAR1"), ("a.xlsx", b""), ("odd.geojson", b'{"type":"Topology"}'),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        said = CliRunner().invoke(
            app, ["map", "get", "47,8", "--source", str(tmp_path / name), "-o", str(tmp_path / "m.geojson")]
        )
        assert (said.exit_code, said.stderr.count("\n"), name in said.stderr) == (1, 1, True), said.stderr
        assert "internal error" not in said.stderr
    swiss, gpkg, parquet = (FORMATS[n](tmp_path / n) for n in ("swiss.geojson", "houses.gpkg", "houses.parquet"))
    for module in ("pyproj", "pyogrio", "pyarrow"):
        monkeypatch.setitem(sys.modules, module, None)
    for path in (swiss, gpkg, parquet):
        with pytest.raises(MapError, match=r"pip install 'landfix\[geo\]'"):
            of(path)
    assert len(of(FORMATS["houses.geojson"](tmp_path / "b.geojson"))[0]) == 4  # needs no extra


def test_features_that_make_no_sense_do_not_stop_the_others(tmp_path: Path) -> None:
    document = json.loads(extracts.geojson(tmp_path / "a.geojson").read_text())
    bad = [
        {"type": "Feature", "geometry": g} for g in (None, {"type": "Polygon", "coordinates": [[[1, "x"]]]}, {"type": "Point"})
    ]
    document["features"] = [*bad, 7, *document["features"]]
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    assert len(of(tmp_path / "b.geojson")[0]) == 4


def test_an_outline_of_very_many_points_is_left_out(tmp_path: Path) -> None:
    document = json.loads(extracts.geojson(tmp_path / "a.geojson").read_text())
    first = document["features"][0]
    large = {**first, "geometry": {"type": "Polygon", "coordinates": [first["geometry"]["coordinates"][0] * 25_000]}}
    (tmp_path / "b.geojson").write_text(json.dumps({**document, "features": [large, *document["features"]]}))
    the_map, got = of(tmp_path / "b.geojson")
    assert (len(the_map), got.notes[-1][:26]) == (4, "1 polygons are left out: m")
    (tmp_path / "c.geojson").write_text(json.dumps({**document, "features": [large]}))
    with pytest.raises(MapError, match="more than 100000 points: simplify"):
        of(tmp_path / "c.geojson")
