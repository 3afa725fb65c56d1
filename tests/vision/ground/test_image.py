"""A georeferenced image: places, heights, and grey values without aliasing."""

from dataclasses import replace

import numpy as np
import pytest

from vision.ground.image import GroundImage, Heights, pyramid, sample

AFFINE = np.array([[0.1, -0.5, 40.0], [0.5, 0.1, -30.0]])


def test_pixels_and_positions_are_inverse_to_each_other() -> None:
    image = GroundImage("x", np.zeros((60, 80), np.uint8), AFFINE, Heights.level(3.0))
    px = np.array([[0.0, 0.0], [79.0, 59.0], [12.3, 45.6]])
    position = px @ AFFINE[:, :2].T + AFFINE[:, 2]
    np.testing.assert_allclose(image.to_pixels(position), px, atol=1e-9)
    assert image.pixel_m == pytest.approx(np.sqrt(0.26))
    np.testing.assert_allclose(image.points(position)[:, 2], 3.0)
    outside = np.array([[-0.1, 5.0], [5.0, 59.1]]) @ AFFINE[:, :2].T + AFFINE[:, 2]
    assert image.contains(position).all()
    assert not image.contains(outside).any()


def test_heights_are_bilinear_and_end_at_the_border() -> None:
    down = np.array([[0.0, 10.0, 20.0], [4.0, 14.0, 24.0]])
    heights = Heights(down, np.array([[0.0, 2.0, 0.0], [2.0, 0.0, 0.0]]), 1.0)  # u is east, v is north, 2 m apart
    position = np.array([[0.0, 1.0], [1.0, 3.0], [9.0, 9.0], [-5.0, -5.0]])
    np.testing.assert_allclose(heights.at(position), [5.0, 17.0, 24.0, 0.0])


def test_what_stands_on_the_ground_raises_it() -> None:
    """A tenth of the edges, each 10 m high: the standard deviation of the heights is 3 m, and their mean 1 m."""
    heights = np.repeat((10.0, 0.0), (1, 9))
    image = GroundImage(
        "x", np.zeros((9, 9), np.uint8), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), Heights.level(0.0, heights.std())
    )
    assert image.shared_sigma == pytest.approx((0.0, heights.mean(), 0.05))
    known = replace(image, height_sigma_m=0.5)
    assert known.shared_sigma[1] == pytest.approx(np.hypot(0.5, heights.mean()))


def test_a_georeference_without_area_is_refused() -> None:
    with pytest.raises(ValueError, match="x: its georeference"):
        GroundImage("x", np.zeros((9, 9), np.uint8), np.zeros((2, 3)), Heights.level(0.0))


def test_values_are_taken_where_they_are_and_beyond_the_border_the_borders() -> None:
    v, u = np.indices((200, 300))
    levels = pyramid((u * 0.5 + v * 0.4).astype(np.uint8))
    px = np.array([[[10.0, 20.0], [250.5, 150.25]], [[-50.0, 100.0], [np.nan, 0.0]]])
    np.testing.assert_allclose(sample(levels, px, 1.0), [[13.0, 185.2], [40.0, 0.0]], atol=1.0)
    u_far, v_far = np.meshgrid(np.arange(50.0, 250.0, 4.0), np.arange(40.0, 160.0, 4.0))
    coarse = sample(levels, np.stack((u_far, v_far), axis=-1), 4.0)
    np.testing.assert_allclose(coarse[3:-3, 3:-3], (0.5 * u_far + 0.4 * v_far)[3:-3, 3:-3], atol=1.0)


def test_fine_stripes_do_not_alias() -> None:
    stripes = np.where(np.indices((512, 512)).sum(axis=0) % 3 == 0, 250, 5).astype(np.uint8)
    at = np.arange(20.0, 480.0, 5.0)
    values = sample(pyramid(stripes), np.stack(np.meshgrid(at, at), axis=-1), 5.0)
    assert values.std() < 8.0


def test_only_the_part_in_view_of_a_large_image_is_touched() -> None:
    """An image wider than OpenCV's remap takes."""
    wide = np.zeros((64, 40_000), np.uint8)
    wide[:, 39_990:] = 200
    px = np.stack(np.meshgrid(np.arange(39_980.0, 39_999.0), np.arange(10.0, 20.0)), axis=-1)
    values = sample((wide,), px, 1.0)
    assert values[0, 0] == 0.0
    assert values[0, -1] == 200.0
