"""Colours from orthophotos: the image is painted first, the map is where its patches lie on Earth."""

import json
import re
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from estimator.cli import app
from estimator.map_files.orthophoto import georeference, load
from models.maps.landmarks import LandmarkMap
from models.maps.projection import from_lonlat, to_lonlat
from models.maps.table import MapError
from models.messages import Array

UTM = 32632
TURNED = np.array([[0.4, 0.3, 465_000.0], [0.1, -0.38, 5_250_000.0]])  # turned and strongly sheared
NORTH_UP = np.array([[0.5, 0.0, 465_000.25], [0.0, -0.5, 5_249_999.75]])
PATCHES = {  # centre u, v and half sides of patches in the image, and their colours
    "red": (100, 120, 30, 20, (20, 20, 220)),
    "green": (300, 100, 20, 20, (30, 180, 40)),
    "white": (200, 300, 40, 15, (250, 250, 250)),
}


def painted() -> NDArray[np.uint8]:
    """Speckled ground with the patches, each with a dark rim a pixel wide, and a red one that the border cuts."""
    rng = np.random.default_rng(0)
    image: NDArray[np.uint8] = rng.integers(60, 120, (400, 400, 3)).astype(np.uint8)
    for u, v, a, b, colour in PATCHES.values():
        image[v - b - 1 : v + b + 2, u - a - 1 : u + a + 2] = 0
        image[v - b : v + b + 1, u - a : u + a + 1] = colour
    image[340:380, :30] = PATCHES["red"][4]
    return image


def footprints(path: Path, affine: Array, **outside: tuple[float, float]) -> Path:
    """The patches as polygons; more of 40 px at other places."""
    places = {name: (u, v, a, b) for name, (u, v, a, b, _) in PATCHES.items()} | {k: (*c, 20, 20) for k, c in outside.items()}
    features = []
    for name, (u, v, a, b) in places.items():
        px = np.array([[u - a, v - b], [u + a, v - b], [u + a, v + b], [u - a, v + b]], dtype=float)
        lonlat = to_lonlat(UTM, px @ affine[:, :2].T + affine[:, 2])
        assert lonlat is not None
        geometry = {"type": "Polygon", "coordinates": [lonlat.tolist()]}
        features.append({"type": "Feature", "id": name, "properties": {}, "geometry": geometry})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def build(source: Path, orthophoto: Path, *more: str) -> LandmarkMap:
    out = source.with_name("map.geojson")
    arguments = ["map", "build", str(source), "-o", str(out), "--colour-from", str(orthophoto), *more]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.stderr
    return LandmarkMap.from_geojson(out.read_bytes())


def geotiff(path: Path, image: NDArray[np.uint8], order: str, epsg: int = UTM) -> Path:
    """An uncompressed GeoTIFF of NORTH_UP: tie point at the corner of the first pixel."""
    keys = [1, 1, 0, 2, 1025, 0, 1, 1, 3072, 0, 1, epsg]
    extra = struct.pack(f"{order}3d6d12H3H", 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 465_000.0, 5_250_000.0, 0.0, *keys, 8, 8, 8)
    pixels = np.ascontiguousarray(image[:, :, ::-1]).tobytes()
    at = 8 + len(pixels)
    entries = [
        (256, 4, 1, image.shape[1]), (257, 4, 1, image.shape[0]), (258, 3, 3, at + 96), (262, 4, 1, 2), (273, 4, 1, 8),
        (277, 4, 1, 3), (278, 4, 1, image.shape[0]), (279, 4, 1, len(pixels)), (33550, 12, 3, at), (33922, 12, 6, at + 24),
        (34735, 3, 12, at + 72),
    ]  # fmt: skip
    directory = struct.pack(order + "H", len(entries)) + b"".join(struct.pack(order + "HHII", *e) for e in entries)
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", at + len(extra))
    path.write_bytes(head + pixels + extra + directory + bytes(4))
    return path


def test_colours_of_an_image_with_a_world_file(tmp_path: Path) -> None:
    path = tmp_path / "ortho.png"
    cv2.imwrite(str(path), painted())
    path.with_suffix(".pgw").write_text("\n".join(f"{x:.10f}" for x in TURNED.T.ravel()))
    the_map = build(footprints(tmp_path / "in.geojson", TURNED, edge=(395.0, 200.0)), path, "--picture-epsg", str(UTM))
    assert {x.id: x.colour_bgr for x in the_map} == {name: patch[4] for name, patch in PATCHES.items()} | {"edge": None}


@pytest.mark.parametrize("order", ["<", ">"])
def test_colours_of_a_geotiff(tmp_path: Path, order: str) -> None:
    path = geotiff(tmp_path / "ortho.tif", painted(), order)
    np.testing.assert_allclose(load(path).affine, NORTH_UP)
    the_map = build(footprints(tmp_path / "in.geojson", NORTH_UP), path)
    assert {x.id: x.colour_bgr for x in the_map} == {name: patch[4] for name, patch in PATCHES.items()}


def test_landmarks_are_picked_from_an_image(tmp_path: Path) -> None:
    """The patches come out where the polygons of the other tests are, to a fifth of a pixel in size."""
    path, out = geotiff(tmp_path / "ortho.tif", painted(), "<"), tmp_path / "picked.geojson"
    result = CliRunner().invoke(
        app, ["map", "build", str(path), "-o", str(out), "--pick", "red, #28b41e ,white", "--height-m", "0"]
    )
    assert result.exit_code == 0, result.stderr
    picked = LandmarkMap.from_geojson(out.read_bytes())
    expected = build(footprints(tmp_path / "in.geojson", NORTH_UP), path, "--origin", ",".join(map(repr, picked.origin)))
    assert len(picked) == len(PATCHES)
    assert picked.automatic
    assert not expected.automatic
    assert build(out, path).automatic, "built anew it is still one that a program picked"
    for there in expected:
        (found,) = picked.near(*there.centre_n, 1.0)
        assert found.centre_n == pytest.approx(there.centre_n, abs=0.1)
        assert found.length_m == pytest.approx(there.length_m + 0.5, abs=0.35), "half a pixel more on each side"
        assert found.width_m == pytest.approx(there.width_m + 0.5, abs=0.35)
        assert found.colour_bgr is not None
        assert np.abs(np.array(found.colour_bgr) - np.array(there.colour_bgr)).max() < 25
        assert (found.height_m, len(found.outline_n)) == (0.0, 4)


def test_without_colours_to_look_for_the_image_s_own_divide_it(tmp_path: Path) -> None:
    path, out = geotiff(tmp_path / "ortho.tif", painted(), ">"), tmp_path / "map.geojson"
    result = CliRunner().invoke(app, ["map", "build", str(path), "-o", str(out), "--least-m2", "200"])
    assert result.exit_code == 0, result.stderr
    found = LandmarkMap.from_geojson(out.read_bytes())
    expected = build(footprints(tmp_path / "in.geojson", NORTH_UP), path, "--origin", ",".join(map(repr, found.origin)))
    assert len(found) == len(PATCHES)
    for there in expected:
        (one,) = found.near(*there.centre_n, 1.0)
        assert (one.length_m, one.width_m) == pytest.approx((there.length_m + 0.5, there.width_m + 0.5), abs=0.4)
        assert (one.sigma_m, one.outline_sigma_m) == (0.5, 0.25), "a pixel, and half of one"


def test_a_panchromatic_image_of_16_bits_gives_outlines_and_no_colours(tmp_path: Path) -> None:
    grey = cv2.cvtColor(painted(), cv2.COLOR_BGR2GRAY).astype(np.uint16) * 20 + 300
    path, out = tmp_path / "pan.png", tmp_path / "map.geojson"
    cv2.imwrite(str(path), grey)
    path.with_suffix(".pgw").write_text("\n".join(f"{x:.10f}" for x in NORTH_UP.T.ravel()))
    arguments = ["map", "build", str(path), "-o", str(out), "--picture-epsg", str(UTM), "--least-m2", "200", "--sigma-m", "2"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    found = LandmarkMap.from_geojson(out.read_bytes())
    (white,) = (x for x in found if x.length_m == pytest.approx(40.5, abs=0.5))
    assert white.width_m == pytest.approx(15.5, abs=0.5)
    assert (white.colour_bgr, white.sigma_m) == (None, 2.0)


@pytest.mark.parametrize(("source", "pick", "words"), [("a.geojson", "red", "image"), ("a.png", "reddish", "'reddish'")])
def test_wrong_use_of_pick(tmp_path: Path, source: str, pick: str, words: str) -> None:
    arguments = ["map", "build", str(tmp_path / source), "-o", str(tmp_path / "out.geojson"), *(["--pick", pick] if pick else [])]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert words in result.stderr


@pytest.mark.parametrize(
    ("wkt", "epsg"),
    [
        ('PROJCS["WGS_1984_UTM_Zone_32N",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984"]]]', 32632),
        ('PROJCS["WGS 84 / UTM zone 7S",GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]],AUTHORITY["EPSG","32707"]]', 32707),
        ('PROJCRS["WGS 84 / UTM zone 33N",BASEGEOGCRS["WGS 84",ID["EPSG",4326]],ID["EPSG",32633]]\n', 32633),
        ('GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]]]', 4326),
        ('PROJCS["ETRS_1989_UTM_Zone_32N",GEOGCS["GCS_ETRS_1989"]]', None),
        ('PROJCS["NAD83 / UTM zone 15N",GEOGCS["NAD83",AUTHORITY["EPSG","4269"]]]', None),
        ("", None),
    ],
)
def test_a_prj_beside_the_world_file_names_the_system(tmp_path: Path, wkt: str, epsg: int | None) -> None:
    """A code given wins over it; a system that is not known asks for one."""
    path = tmp_path / "ortho.png"
    path.write_bytes(b"")
    path.with_suffix(".pgw").write_text("0.5 0 0 -0.5 400000 5200000")
    path.with_suffix(".prj").write_text(wkt)
    assert georeference(path, 32631)[1] == 32631
    if epsg is None:
        with pytest.raises(MapError, match="--picture-epsg"):
            georeference(path)
    else:
        assert georeference(path)[1] == epsg


def test_given_colours_stay(tmp_path: Path) -> None:
    path = geotiff(tmp_path / "ortho.tif", painted(), "<")
    source = footprints(tmp_path / "in.geojson", NORTH_UP)
    data = json.loads(source.read_text())
    data["features"][0]["properties"]["colour"] = "#0000ff"
    source.write_text(json.dumps(data))
    assert build(source, path)["red"].colour_bgr == (255, 0, 0)


def test_what_cannot_be_used_gets_one_line(tmp_path: Path) -> None:
    plain, text, tiff = tmp_path / "plain.png", tmp_path / "text.png", tmp_path / "cut.tif"
    cv2.imwrite(str(plain), painted())
    text.write_text("no image")
    with pytest.raises(MapError, match=r"plain\.png: is not georeferenced.*plain\.pgw"):
        load(plain)
    with pytest.raises(MapError, match=r"text\.png: not an image"):
        load(text)
    plain.with_suffix(".pgw").write_text("0.5 0 0 x")
    with pytest.raises(MapError, match=r"plain\.pgw: not a world file of six numbers"):
        load(plain)
    plain.with_suffix(".pgw").write_text("0 0 0 0 1 1")
    with pytest.raises(MapError, match="not usable"):
        load(plain, UTM)
    plain.with_suffix(".pgw").write_text("0.5 0 0 -0.5 1 1")
    with pytest.raises(MapError, match="--picture-epsg"):
        load(plain)
    whole = geotiff(tmp_path / "whole.tif", painted(), "<").read_bytes()
    for length in (3, 100, len(whole) - 40, len(whole) - 130):
        tiff.write_bytes(whole[:length])
        with pytest.raises(MapError):
            load(tiff)


@pytest.mark.parametrize(
    ("epsg", "said"),
    [
        (25832, "EPSG:25832 is not known here: it is WGS 84's of zone 32 within a metre: give 32632 (--picture-epsg"),
        (2056, "EPSG:2056 is not known here: give 4326, 326xx, 327xx or 3857 (--picture-epsg"),
    ],
)
def test_another_coordinate_system_names_its_remedy(tmp_path: Path, epsg: int, said: str) -> None:
    path = geotiff(tmp_path / "photo.tif", painted(), "<", epsg)
    with pytest.raises(MapError, match=re.escape(said)):
        load(path)
    assert load(path, 32632).epsg == 32632


def test_a_real_geotiff_lies_where_its_readme_reports(landfix_data: Path) -> None:
    ortho = load(landfix_data / "images/spacenet_atlanta_footprints/sample_geotiff.tif")
    assert ortho.epsg == 32616
    assert ortho.is_grey
    corners = np.array([[-0.5, -0.5], [899.5, 899.5]]) @ ortho.affine[:, :2].T + ortho.affine[:, 2]
    np.testing.assert_allclose(corners, [[733_601, 3_725_139], [734_051, 3_724_689]])
    assert 100 < np.ptp(ortho.image) <= 255


def test_road_islands_of_a_real_orthophoto(landfix_data: Path, tmp_path: Path) -> None:
    """Grass between roads, seen from 40 m: two islands of 200 m2; ragged edges that cross themselves get their reason."""
    folder = landfix_data / "images/brighton_beach_uav"
    reference = json.loads((folder / "georef.json").read_text())
    path, out = tmp_path / "ortho.png", tmp_path / "map.geojson"
    shutil.copyfile(folder / "ortho_0.1m_utm15n.png", path)
    step = reference["res"]
    path.with_suffix(".pgw").write_text(f"{step}\n0\n0\n{-step}\n{reference['x0']}\n{reference['y1']}\n")
    arguments = ["--pick", "#7a9a45", "--least-m2", "50", "--picture-epsg", "32615", "--json"]
    result = CliRunner().invoke(app, ["map", "build", str(path), "-o", str(out), *arguments])
    assert result.exit_code == 0, result.stderr
    islands = sorted(x.size_m2 for x in LandmarkMap.from_geojson(out.read_bytes()))
    assert len([size for size in islands if 150.0 < size < 260.0]) >= 2
    assert all("crosses itself" in finding["text"] for finding in json.loads(result.stdout)["report"]["rejected"])


def test_the_south_is_the_mirror_of_the_north() -> None:
    xy = np.array([[334_000.0, 3_748_000.0], [512_000.0, 10.0]])
    north, south = to_lonlat(32656, xy), to_lonlat(32756, np.array([0.0, 1e7]) + xy * [1.0, -1.0])
    assert north is not None
    assert south is not None
    np.testing.assert_allclose(south, north * [1.0, -1.0], atol=1e-9)
    assert north[0] == pytest.approx([151.2, 33.86], abs=0.02), "zone 56 is centred on 153 degrees"


@pytest.mark.parametrize(
    ("epsg", "lon", "lat"), [(32616, -87.0, 0.0), (32633, 15.0, 47.0), (32755, 147.0, -80.0), (3857, 10.0, 50.0)]
)
def test_projections_undo_each_other(epsg: int, lon: float, lat: float) -> None:
    rng = np.random.default_rng(0)
    lonlat = np.column_stack((lon + rng.uniform(-3.5, 3.5, 200), lat + rng.uniform(-3.0, 3.0, 200)))
    if epsg == 32616:
        lonlat[:, 1] = np.abs(lonlat[:, 1])
    xy = from_lonlat(epsg, lonlat)
    assert xy is not None
    back = to_lonlat(epsg, xy)
    assert back is not None
    assert np.abs(back - lonlat).max() * 111e3 < 1e-4
