"""The map's image from disk: every pixel where it lies in n, and as high."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from estimator.map_files import image as image_store
from estimator.map_files.image_file import ImageFile
from models.maps.table import MapError
from models.messages import Array
from tests.estimator.map_files.image_files import ORIGIN, UTM, utm_affine, write
from tests.vision.ground import scene


def _file(path: Path, **changes: object) -> ImageFile:
    return ImageFile(path, 0.7, 480.0, 1.5, epsg=UTM)._replace(**changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(scene.map_image(scene.drawing(1)), tmp_path_factory.mktemp("ortho") / "ortho.png")


def _raster(path: Path, values: Array, affine: Array) -> Path:
    """Heights as a TIFF of floats with a world file."""
    cv2.imwrite(str(path), values.astype(np.float32))
    path.with_suffix(".tfw").write_text("\n".join(f"{x:.9f}" for x in affine.T.ravel()))
    return path


def test_pixels_lie_where_they_were_drawn(path: Path) -> None:
    truth, loaded = scene.map_image(scene.drawing(1)), image_store.load(_file(path), ORIGIN).image
    corners = np.array([[0.0, 0.0, 1.0], [532.0, 0.0, 1.0], [0.0, 532.0, 1.0], [532.0, 532.0, 1.0]])
    np.testing.assert_allclose(corners @ loaded.affine.T, corners @ truth.affine.T, atol=0.01)
    np.testing.assert_array_equal(loaded.image, truth.image)
    assert (loaded.name, loaded.sigma_m, loaded.height_sigma_m) == ("ortho.png", 0.7, 1.5)
    np.testing.assert_allclose(loaded.heights.at(np.array([[0.0, 0.0], [100.0, -100.0]])), 8.0, atol=0.01)


def test_level_ground_curves_away_with_the_earth(path: Path) -> None:
    far = (ORIGIN[0] + 0.1, *ORIGIN[1:])
    loaded = image_store.load(_file(path), far).image
    distance = np.hypot(*loaded.affine[:, 2])
    assert distance == pytest.approx(11_120.0, rel=0.02)
    assert loaded.heights.at(loaded.affine[None, :, 2])[0] == pytest.approx(8.0 + distance**2 / 2.0 / 6.37e6, abs=0.1)


def test_without_a_height_it_is_the_origins(path: Path) -> None:
    loaded = image_store.load(_file(path, height_m=None), ORIGIN).image
    np.testing.assert_allclose(loaded.heights.at(np.zeros((1, 2))), 0.0, atol=0.01)


def test_a_raster_of_heights_with_gaps(path: Path, tmp_path: Path) -> None:
    """A slope of 10 % to the east on a raster of 10 m, with holes."""
    affine = np.array([[0.0, -10.0, 200.0], [10.0, 0.0, -200.0]])
    east = -200.0 + 10.0 * np.arange(41.0)
    values = 480.0 + 0.1 * np.broadcast_to(east, (41, 41)).copy()
    values[20, 20], values[5:8, 5:8], values[0, 0] = np.nan, -9999.0, 3e38
    raster = _raster(tmp_path / "dsm.tif", values, utm_affine(affine, 41, 41))
    heights = image_store.load(_file(path, heights=raster), ORIGIN).image.heights
    place = np.array([[33.0, 105.0], [-120.0, -60.0], [0.0, 0.0], [-200.0, 500.0]])
    np.testing.assert_allclose(heights.at(place), 8.0 - 0.1 * np.array([105.0, -60.0, 0.0, 200.0]), atol=1.05)
    np.testing.assert_allclose(heights.at(place[:2]), 8.0 - 0.1 * place[:2, 1], atol=0.02)
    assert heights.slope == 0.0


def test_the_origin_is_the_first_pixel(path: Path) -> None:
    lat, lon, alt = image_store.origin(_file(path))
    assert (lat, lon) == pytest.approx((ORIGIN[0] + 160.0 / 111_200.0, ORIGIN[1] - 160.0 / 75_400.0), abs=2e-5)
    assert alt == 480.0


def test_what_cannot_be_used_gets_one_line(path: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.png"
    cv2.imwrite(str(plain), np.zeros((9, 9), np.uint8))
    with pytest.raises(MapError, match="not georeferenced"):
        image_store.load(_file(plain), ORIGIN)
    with pytest.raises(MapError, match="picture_epsg"):
        image_store.load(_file(path, epsg=0), ORIGIN)
    cv2.imwrite(str(tmp_path / "rgb.png"), np.zeros((9, 9, 3), np.uint8))
    (tmp_path / "rgb.pgw").write_text("1 0 0 -1 465000 5250000")
    with pytest.raises(MapError, match="not one of heights"):
        image_store.load(_file(path, heights=tmp_path / "rgb.png"), ORIGIN)
    empty = _raster(tmp_path / "empty.tif", np.full((9, 9), np.nan), np.array([[1.0, 0.0, 465000.0], [0.0, -1.0, 5250000.0]]))
    with pytest.raises(MapError, match="no heights"):
        image_store.load(_file(path, heights=empty), ORIGIN)


def test_an_image_of_a_country_is_too_large(tmp_path: Path) -> None:
    large = tmp_path / "large.png"
    cv2.imwrite(str(large), np.zeros((800, 800), np.uint8))
    large.with_suffix(".pgw").write_text("0.005 0 0 -0.005 6.0 49.0")
    with pytest.raises(MapError, match="too large for one plane"):
        image_store.load(_file(large, epsg=4326), ORIGIN)
