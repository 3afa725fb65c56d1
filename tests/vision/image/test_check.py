"""Images and pairs that cannot be used."""

import numpy as np
import pytest

from tests.vision import stereo_scene
from vision.image.check import image_flaw, pair_flaw
from vision.image.rectify import Image

LEFT, RIGHT, _ = stereo_scene.board(stereo_scene.rig())


def torn(image: Image, fill: int) -> Image:
    damaged = image.copy()
    damaged[180:] = fill
    return damaged


def repeated(image: Image) -> Image:
    damaged = image.copy()
    damaged[150:] = damaged[150]
    return damaged


def overexposed(image: Image) -> Image:
    return np.clip(image.astype(np.int32) + 190, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("image", [LEFT, LEFT[..., 1], LEFT.astype(np.uint16) * 200, LEFT[..., 0].astype(np.uint16) + 20000])
def test_a_good_image_has_no_flaw(image: Image) -> None:
    assert image_flaw(image, stereo_scene.rig().left) is None


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros_like(LEFT), "black"),
        (np.full_like(LEFT, 255), "white"),
        (np.full_like(LEFT, 128), "flat"),
        (np.zeros((240, 320), np.uint16), "black"),
        (np.full((240, 320), 20000, np.uint16), "flat"),
        (overexposed(LEFT), "saturated"),
        (torn(LEFT, 128), "torn: nothing below row 1"),
        (repeated(LEFT), "torn: nothing below row 150"),
        (LEFT.astype(np.float32), "8 or 16 bit"),
        (LEFT[..., :2], "shape"),
        (LEFT[:, :100], "image is 100 x 240, the camera 320 x 240"),
        (LEFT[:0], "shape"),
    ],
)
def test_what_is_wrong_is_said(image: Image, reason: str) -> None:
    assert reason in (image_flaw(image, stereo_scene.rig().left) or "")


def test_pairs() -> None:
    assert pair_flaw(LEFT, RIGHT) is None
    assert "320 x 240" in (pair_flaw(LEFT, RIGHT[:100]) or "")
    assert "same image" in (pair_flaw(LEFT, LEFT.copy()) or "")
    assert "8 bit" in (pair_flaw(LEFT, RIGHT.astype(np.uint16)) or "")
