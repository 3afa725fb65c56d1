import numpy as np
import pytest

from models.camera import CameraModel
from vision.image.scaled import fits, scaled

CAMERA = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.mark.parametrize(
    ("size", "fitting"), [((1280, 960), True), ((4056, 3040), True), ((320, 241), False), ((640, 360), False)]
)
def test_which_sizes_have_the_camera_s_aspect_ratio(size: tuple[int, int], fitting: bool) -> None:
    assert fits(*size, CAMERA) is fitting


def test_a_larger_image_shows_the_same_thing_at_the_same_pixel() -> None:
    """A blob whose middle is at (200, 100) in pixels of the camera is at 2 (200 + 1/2) - 1/2 in an image twice as large."""
    v, u = np.indices((960, 1280))
    large = (255.0 * np.exp(-0.5 * ((u - 400.5) ** 2 + (v - 200.5) ** 2) / 8.0**2)).astype(np.uint8)
    small = scaled(large, CAMERA)
    assert small.shape == (480, 640)
    weights = small.astype(float)
    assert (weights * np.indices((480, 640))[1]).sum() / weights.sum() == pytest.approx(200.0, abs=0.02)
    assert (weights * np.indices((480, 640))[0]).sum() / weights.sum() == pytest.approx(100.0, abs=0.02)


def test_what_does_not_fit_or_need_it_is_left_as_it_is() -> None:
    for shape in ((480, 640), (360, 640)):
        image = np.zeros(shape, np.uint8)
        assert scaled(image, CAMERA) is image
