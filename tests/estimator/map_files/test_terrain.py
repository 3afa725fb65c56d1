"""Each landmark stands on the ground of a height model; what the model does not know is left out, or refused."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.map_files.geoid import geoid_m
from estimator.map_files.store import load
from estimator.map_files.terrain import Terrain
from models.maps.table import MapError
from models.messages import Array
from tests.estimator.map_files.extract import extracts
from tests.estimator.map_files.extract.extracts import COURT, HOUSE, LAT, LON

N = 1201
VOID = -32768


def plane(lonlat: Array) -> Array:
    """400 m at the corner, 1 m more a 0.001 degree north, half of it east."""
    return 400.0 + 1000.0 * (lonlat[:, 1] - 47.0) + 500.0 * (lonlat[:, 0] - 8.0)


def hgt(folder: Path, name: str = "N47E008.hgt", void: bool = False) -> Path:
    """A plane, rounded to metres as SRTM is."""
    lon, lat = np.meshgrid(8.0 + np.arange(N) / (N - 1), 48.0 - np.arange(N) / (N - 1))
    heights = np.rint(plane(np.column_stack((lon.ravel(), lat.ravel())))).reshape(N, N)
    if void:
        heights[:] = VOID
    heights.astype(">i2").tofile(folder / name)
    return folder / name


def geotiff(path: Path, heights: Array, west: float, north: float, step: float, key: int = 2048, epsg: int = 4326) -> Path:
    """Uncompressed float32, its pixels' places their centres, as Copernicus' tiles have them."""
    pixels = heights.astype("<f4").tobytes()
    at = 8 + len(pixels)
    keys = [1, 1, 0, 2, 1025, 0, 1, 2, key, 0, 1, epsg]
    extra = struct.pack("<3d6d12H", step, step, 0.0, 0.0, 0.0, 0.0, west, north, 0.0, *keys)
    rows, columns = heights.shape
    entries = [
        (256, 4, 1, columns), (257, 4, 1, rows), (258, 3, 1, 32), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8), (277, 3, 1, 1),
        (278, 4, 1, rows), (279, 4, 1, len(pixels)), (339, 3, 1, 3), (33550, 12, 3, at), (33922, 12, 6, at + 24),
        (34735, 3, 12, at + 72),
    ]  # fmt: skip
    directory = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *e) for e in entries)
    path.write_bytes(b"II*\0" + struct.pack("<I", at + len(extra)) + pixels + extra + directory + bytes(4))
    return path


def copernicus(path: Path, west: float = 8.5, columns: int = 200) -> Path:
    """A plane around the houses."""
    step, north = 1.0 / 3600.0, 47.4
    lon, lat = np.meshgrid(west + step * np.arange(columns), north - step * np.arange(200))
    return geotiff(path, plane(np.column_stack((lon.ravel(), lat.ravel()))).reshape(200, columns), west, north, step)


PLACES = np.array([[8.54, 47.37], [8.5401, 47.3803], [8.51, 47.36]])


def test_an_srtm_tile_gives_the_height_to_its_rounding(tmp_path: Path) -> None:
    above_sea = Terrain(hgt(tmp_path), above_ellipsoid=True).at(PLACES)
    assert above_sea == pytest.approx(plane(PLACES), abs=0.51)
    assert np.isnan(Terrain(tmp_path).at(np.array([[9.2, 47.5], [8.5, 46.9]]))).all()


def test_a_geotiff_gives_the_height_and_the_geoid_is_added_once(tmp_path: Path) -> None:
    path = copernicus(tmp_path / "dem.tif")
    assert Terrain(path, above_ellipsoid=True).at(PLACES) == pytest.approx(plane(PLACES), abs=1e-3)
    n = [geoid_m(lat, lon) for lon, lat in PLACES.tolist()]
    assert Terrain(path).at(PLACES) - plane(PLACES) == pytest.approx(n, abs=0.05)


def test_tiles_side_by_side_have_no_gap(tmp_path: Path) -> None:
    copernicus(tmp_path / "a.tif", 8.5, 100)
    copernicus(tmp_path / "b.tif", 8.5 + 100 / 3600.0, 100)
    across = np.column_stack((np.linspace(8.51, 8.54, 500), np.full(500, 47.37)))
    assert Terrain(tmp_path, above_ellipsoid=True).at(across) == pytest.approx(plane(across), abs=0.1)


def test_map_get_puts_each_landmark_on_its_ground(tmp_path: Path) -> None:
    houses, dem = extracts.geojson(tmp_path / "houses.geojson"), copernicus(tmp_path / "dem.tif")
    out = tmp_path / "map.geojson"
    args = ["map", "get", f"{LAT},{LON}", "--source", houses, "--terrain", dem, "--terrain-sigma-m", "3", "-o", out]
    done = CliRunner().invoke(app, [str(a) for a in args])
    assert done.exit_code == 0, done.output
    the_map = load(out)
    n = geoid_m(LAT, LON)
    assert the_map.origin[2] == pytest.approx(float(plane(np.array([[LON, LAT]]))[0]) + n, abs=0.1)
    for landmark in the_map:
        lat, lon, alt = the_map.frame.to_geodetic((*landmark.outline_n.mean(axis=0), landmark.base_d))
        assert alt == pytest.approx(float(plane(np.array([[lon, lat]]))[0]) + n, abs=0.1)
        assert landmark.height_sigma_m >= 3.0
    assert the_map.common_sigma_m[1] == pytest.approx(np.hypot(2.0, 3.0), abs=0.01)
    rise = 1000.0 * (np.mean([p[1] for p in COURT[:4]]) - np.mean([p[1] for p in HOUSE[:4]])) + 500.0 * 0.001
    by_size = sorted(the_map, key=lambda landmark: landmark.size_m2)
    assert by_size[0].base_d - by_size[-1].base_d == pytest.approx(rise, abs=0.1)


def test_landmarks_beyond_the_model_are_left_out_and_counted(tmp_path: Path) -> None:
    houses, dem = extracts.geojson(tmp_path / "houses.geojson"), copernicus(tmp_path / "dem.tif", 8.5, 146)  # to 8.5403
    args = ["map", "get", f"{LAT},{LON}", "--source", houses, "--terrain", dem, "-o", tmp_path / "map.geojson"]
    done = CliRunner().invoke(app, [str(a) for a in args])
    assert done.exit_code == 0, done.output
    assert "2 landmarks are left out: the height model does not reach them" in done.stderr


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: hgt(p, "dem.hgt"), "named after its south-west corner"),
        (lambda p: hgt(p, void=True), "all of its heights are marked as unknown"),
        (lambda p: geotiff(p / "d.tif", np.zeros((9, 9)), 2e6, 1e6, 1.0, 3072, 2056), "convert it: gdalwarp -t_srs EPSG:4326"),
        (lambda p: geotiff(p / "d.tif", np.zeros((9, 9)), 0.0, 0.0, 0.001), "does not reach 47.37, 8.54, the middle of the map"),
        (lambda p: p, "holds 0 tiles"),
        (lambda p: p / "none.tif", "no such file"),
    ],
)
def test_what_is_no_height_model_of_the_place_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Path], words: str
) -> None:
    folder = tmp_path / "dem"
    folder.mkdir()
    houses = extracts.geojson(tmp_path / "houses.geojson")
    args = ["map", "get", f"{LAT},{LON}", "--source", houses, "--terrain", make(folder), "-o", tmp_path / "map.geojson"]
    done = CliRunner().invoke(app, [str(a) for a in args])
    assert done.exit_code == 1
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_truncated_tile_is_refused(tmp_path: Path) -> None:
    (tmp_path / "N47E008.hgt").write_bytes(bytes(2 * 1000))
    with pytest.raises(MapError, match="no square of heights"):
        Terrain(tmp_path / "N47E008.hgt")
