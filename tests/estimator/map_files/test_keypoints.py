"""Keypoints kept beside a map's image: the same ones, found once for each content, and never a reason to fail."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from estimator.map_files import image as image_store
from estimator.map_files import keypoints as store
from estimator.map_files.image_file import ImageFile
from tests.estimator.map_files.image_files import ORIGIN, UTM, write
from tests.vision.ground import scene
from vision.recognisers import MapImage


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(scene.map_image(scene.drawing(1)), tmp_path / "ortho.png")


def _load(path: Path) -> MapImage:
    return image_store.load(ImageFile(path, 0.7, 480.0, 1.5, epsg=UTM), ORIGIN)


def _kept(path: Path) -> Path:
    return path.with_name("ortho.png.keypoints.npz")


def test_the_second_time_they_are_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = _load(path).features
    assert len(first.x_n) > 100
    assert _kept(path).exists()
    monkeypatch.setattr(store, "map_keypoints", lambda *_: pytest.fail("found anew"))
    second = _load(path).features
    np.testing.assert_array_equal(first.x_n, second.x_n)
    np.testing.assert_array_equal(first.descriptors, second.descriptors)


def test_another_content_has_other_keypoints(path: Path) -> None:
    _load(path)
    before = _kept(path).read_bytes()
    cv2.imwrite(str(path), scene.map_image(scene.drawing(2)).image)
    changed = _load(path).features
    assert _kept(path).read_bytes() != before
    np.testing.assert_array_equal(changed.descriptors, MapImage.of(changed.image).features.descriptors)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"not an archive", None])
def test_a_damaged_file_is_made_anew(path: Path, damage: bytes | None) -> None:
    whole = _load(path).features
    kept = _kept(path)
    kept.write_bytes(kept.read_bytes()[:-200] if damage is None else damage)
    np.testing.assert_array_equal(_load(path).features.x_n, whole.x_n)
    with np.load(kept, allow_pickle=False) as archive:
        assert len(archive["px"]) == len(whole.x_n)


def test_a_file_with_this_key_and_other_points_is_made_anew(path: Path) -> None:
    whole = _load(path).features
    with np.load(_kept(path), allow_pickle=False) as archive:
        key, descriptors = archive["key"], archive["descriptors"]
    for px in (np.full((len(descriptors), 2), np.nan), np.zeros((3, 2)), np.full((len(descriptors), 2), 1e6)):
        np.savez(_kept(path), key=key, px=px, descriptors=descriptors)
        np.testing.assert_array_equal(_load(path).features.x_n, whole.x_n)


def test_where_nothing_can_be_written_it_works_without(path: Path) -> None:
    _kept(path).mkdir()
    assert len(_load(path).features.x_n) > 100
