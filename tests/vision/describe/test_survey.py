"""All stages up to measure: good pairs, and every kind of bad one."""

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from tests.vision import roofs, stereo_scene
from vision.describe.survey import Settings, Survey, segment_regions, survey
from vision.image.rectify import Image, Rectification, rectification
from vision.show.annotate import annotate

RIG = roofs.nadir_rig(lens=(-0.12, 0.08, 0.0005, -0.0003), squint_rad=0.004)
MADE = rectification(RIG)
VIEW = roofs.view(3, 25.0, rig=RIG)
KNOWN = Settings(colours_bgr=roofs.COLOURS)


def seen(left: Image, right: Image, made: Rectification = MADE, settings: Settings = KNOWN) -> Survey:
    found = survey(left, right, made, settings)
    assert isinstance(found, Survey)
    return found


@pytest.mark.parametrize("settings", [KNOWN, Settings(), Settings(space="lab"), Settings(space="hsi"), Settings(space="yuv")])
def test_roofs_are_found_with_and_without_their_colours(settings: Settings) -> None:
    found = seen(VIEW.left, VIEW.right, settings=settings)
    assert found.problem is None
    R = MADE.rig.R_bc.T @ RIG.R_bc
    whole = [m for m in found.measured if not m.region.touches_border]
    truth = [c.mean(axis=0) @ R.T for c in VIEW.roofs_c]
    hits = {k for k, t in enumerate(truth) if any(np.linalg.norm(m.centre_c - t) < 0.6 for m in whole)}
    inside = {k for k, c in enumerate(VIEW.roofs_c) if RIG.left.contains(RIG.left.project(c), 8.0).all()}
    assert len(inside) >= 3
    assert len(hits & inside) >= len(inside) - 1


def test_cameras_of_different_height_are_rectified_first() -> None:
    """The right camera sits 9 cm higher and 3 cm further back: a third of the baseline is across the rows."""
    rig = msgspec.structs.replace(RIG, t_rc=np.array([-0.28, 0.09, 0.03]))
    made, view = rectification(rig), roofs.view(3, 25.0, rig=rig)
    found = seen(view.left, view.right, made)
    assert found.problem is None
    R = made.rig.R_bc.T @ rig.R_bc
    truth = [c.mean(axis=0) @ R.T for c in view.roofs_c]
    whole = [m for m in found.measured if not m.region.touches_border]
    assert len(whole) >= 4
    for m in whole:
        e = m.centre_c - min(truth, key=lambda t: float(np.linalg.norm(t - m.centre_c)))
        assert e @ np.linalg.solve(m.covariance_c, e) < 16.3  # chi-square of 3, 99.9 %


def test_sixteen_bit_grey_images_pass() -> None:
    """A thermal pair: 14 bits in 16, hot roofs."""
    left, right = (cv2.cvtColor(x, cv2.COLOR_BGR2HSV)[..., 1].astype(np.uint16) * 30 + 7000 for x in (VIEW.left, VIEW.right))
    found = seen(left, right, settings=Settings())
    assert found.problem is None
    assert found.left.dtype == np.uint8
    assert sum(not m.region.touches_border and m.region.corners is not None for m in found.measured) >= 2


def white(image: Image) -> Image:
    return np.full_like(image, 255)


def black(image: Image) -> Image:
    return np.zeros_like(image)


def torn(image: Image) -> Image:
    damaged = image.copy()
    damaged[200:] = 128
    return damaged


def saturated(image: Image) -> Image:
    return np.clip(image.astype(np.int32) + 215, 0, 255).astype(np.uint8)


def small(image: Image) -> Image:
    return image[:300]


@pytest.mark.parametrize("damage", [white, black, torn, saturated, small])
def test_bad_images_are_refused_with_a_reason(damage: object) -> None:
    assert callable(damage)
    assert isinstance(survey(damage(VIEW.left), VIEW.right, MADE, KNOWN), str)
    assert isinstance(survey(VIEW.left, damage(VIEW.right), MADE, KNOWN), str)
    assert isinstance(survey(damage(VIEW.left), damage(VIEW.right), MADE, KNOWN), str)


def test_the_same_image_twice_is_refused() -> None:
    assert "same image" in str(survey(VIEW.left, VIEW.left, MADE, KNOWN))


def test_swapped_images_are_said() -> None:
    assert "swapped" in (seen(VIEW.right, VIEW.left).problem or "")


@pytest.mark.parametrize(("turn", "pixels"), [((0.004, 0.0, 0.0), 2.4), ((-0.008, 0.0, 0.0), -4.8), ((0.0, 0.0, 0.02), 0.0)])
def test_a_wrong_calibration_is_flagged(turn: tuple[float, float, float], pixels: float) -> None:
    """The right camera sits otherwise than the rig file says: pitch or roll. No confident distance without a word."""
    wrong = msgspec.structs.replace(RIG, R_rc=so3.matrix(so3.quat_exp(np.array(turn))) @ RIG.R_rc)
    found = seen(VIEW.left, VIEW.right, rectification(wrong))
    assert found.residual is not None
    if pixels:
        assert abs(found.residual.vertical_px) == pytest.approx(abs(pixels), rel=0.3)
        assert "rows do not fit" in (found.problem or "")


def test_a_pair_that_was_not_taken_together_is_flagged() -> None:
    """The vehicle moved ahead between the two shutters: rows shift."""
    later = roofs.view(3, 25.0, rig=RIG)
    moved = np.roll(later.right, 5, axis=0)
    assert "not taken together" in (seen(VIEW.left, moved).problem or "")


def test_an_image_of_another_area_gives_nothing_confident() -> None:
    other = roofs.view(17, 25.0, rig=RIG)
    found = seen(VIEW.left, other.right)
    assert found.problem is not None or len(found.measured) <= 1


def test_noise_gives_nothing() -> None:
    rng = np.random.default_rng(1)
    a, b = (rng.integers(0, 255, VIEW.left.shape, dtype=np.uint8) for _ in range(2))
    assert seen(a, b).measured == ()


def test_the_annotated_image_shows_every_region() -> None:
    found = seen(VIEW.left, VIEW.right)
    drawn = annotate(found.left, found.measured, found.unmeasured)
    assert drawn.shape == (960, 1280, 3)
    plain = cv2.resize(found.left, (1280, 960), interpolation=cv2.INTER_CUBIC)
    for m in found.measured:
        u, v = np.rint(m.region.outline.mean(axis=0) * 2).astype(int)
        assert (drawn[v - 10 : v + 10, u - 10 : u + 10] != plain[v - 10 : v + 10, u - 10 : u + 10]).any()
    assert annotate(stereo_scene.board(stereo_scene.rig())[0][..., 0], []).shape == (480, 640, 3)


def dim(image: Image) -> Image:
    """Two stops less light."""
    return (0.25 * image).astype(np.uint8)


def foggy(image: Image) -> Image:
    """Two fifths of the light comes through, the rest is the fog's own."""
    return (0.4 * image + 0.6 * np.array([205.0, 198.0, 190.0])).astype(np.uint8)


def in_cloud_shadow(image: Image) -> Image:
    """The left half has a third of the light."""
    half = image.copy()
    half[:, : image.shape[1] // 2] = (half[:, : image.shape[1] // 2] * 0.35).astype(np.uint8)
    return half


@pytest.mark.parametrize("weather", [dim, foggy, in_cloud_shadow])
def test_known_colours_are_found_in_any_weather(weather: object) -> None:
    """As many roofs as on a plain day, but one."""
    assert callable(weather)
    plain, spoilt = (segment_regions(image, None, KNOWN) for image in (VIEW.left, weather(VIEW.left)))
    whole = [r for r in plain if not r.touches_border and r.corners is not None and r.area_px > 500.0]
    again = {k for k, a in enumerate(whole) for b in spoilt if np.hypot(*(a.outline.mean(0) - b.outline.mean(0))) < 3.0}
    assert len(whole) >= 3
    assert len(again) >= len(whole) - 1
