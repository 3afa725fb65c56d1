"""The pipeline on rendered images: a fix where there is one, a reason and never an exception where there is none."""

from functools import cache
from typing import Any, NamedTuple

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig, Result
from vision.recognise import Identified, SegmentPath
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import Scene, WorldSpec, make_world

CHI2_9999_OF_3 = 21.108
SIGMA = np.array([5.0, 5.0, 5.0, *np.radians([1.0, 1.0, 2.0])])


class View(NamedTuple):
    """A pair, where it was truly taken, and the prior."""

    left: Image
    right: Image
    p_n: Array
    q_nb: Array
    prior: Prior


@cache
def scene() -> Scene:
    return make_world(
        2, WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1, outline_sigma_m=0.05)
    )


@cache
def view(seed: int = 1, north: float = 0.0, east: float = 0.0) -> View:
    rng = np.random.default_rng(seed)
    p_n, q = np.array([north, east, -80.0]), so3.from_euler(0.04, -0.03, 0.7)
    left, right = render_pair(scene().world, scene().rig, p_n, so3.matrix(q), Conditions(), rng)
    error = rng.normal(0.0, 0.5 * SIGMA)
    return View(left, right, p_n, q, Prior(p_n - error[:3], so3.multiply(so3.quat_exp(-error[3:]), q), np.diag(SIGMA**2)))


def pipeline(landmarks: LandmarkMap | None = None, rig: StereoRig | None = None) -> LandmarkPipeline:
    return LandmarkPipeline(rig or scene().rig_calibrated, scene().map if landmarks is None else landmarks)


def off(result: Result, truth: View) -> tuple[float, float]:
    """Distance of the fix with the prior from the truth [m], and squared Mahalanobis distance of the position alone."""
    assert result.fix is not None
    assert result.pose is not None
    e = truth.p_n - result.pose.joint_p_n
    return float(np.linalg.norm(e)), float(e @ np.linalg.solve(result.pose.joint_covariance[:3, :3], e))


def assert_not_confidently_wrong(result: Result, truth: View) -> None:
    assert result.report.outcome != "internal", result.report.detail
    assert (result.fix is not None) == (result.report.outcome == "fixed")
    if result.fix is not None:
        distance, squared = off(result, truth)
        assert distance < 3.0 or squared < CHI2_9999_OF_3


def test_a_pair_gives_the_position() -> None:
    v = view()
    result = pipeline().process(v.left, v.right, 5, v.prior)
    fix = result.fix
    assert fix is not None, result.report
    distance, squared = off(result, v)
    assert distance < 1.0
    assert squared < 16.3  # 99.9 % of 3
    assert (fix.t_ns, fix.arrived_ns, result.report.t_ns, result.report.outcome) == (5, 5, 5, "fixed")
    assert len(fix.landmarks) >= 3
    true = {m.id: m for m in scene().world.landmarks}
    assert set(fix.landmarks) <= set(true)
    assert 0.6 < fix.similarity <= 1.0
    assert 0.0 < fix.residual_px < 1.0
    assert np.linalg.eigvalsh(fix.covariance)[0] > 0.0


def test_every_region_reports_what_became_of_it() -> None:
    v = view()
    result = pipeline().process(v.left, v.right, 0, v.prior)
    states = [r.state for r in result.regions]
    assert set(states) <= {"identified", "open", "not_found", "not_in_map", "not_measured", "cut_off"}
    assert states.count("identified") == len(result.fix.landmarks if result.fix else ())
    assert all(r.reason or r.state == "identified" for r in result.regions)
    assert result.report.regions == len(result.regions)
    assert result.report.candidates == len(result.report.landmarks) == len(result.report.similarities)
    assert all(0.3 <= s <= 1.0 for s in result.report.similarities)


@pytest.mark.parametrize("lost", ["left", "right"])
def test_one_camera_goes_on_and_its_covariance_shows_it(lost: str) -> None:
    v = view()
    both = pipeline().process(v.left, v.right, 0, v.prior)
    one = pipeline().process(None if lost == "left" else v.left, None if lost == "right" else v.right, 0, v.prior)
    assert one.fix is not None, one.report
    assert both.fix is not None
    assert_not_confidently_wrong(one, v)
    assert f"{lost} camera not used: missing" in one.report.detail
    assert one.pose is not None
    assert both.pose is not None
    by_one, by_both = np.trace(one.fix.covariance[:3, :3]), np.trace(both.fix.covariance[:3, :3])
    assert by_one / one.pose.factor > 1.05 * by_both / both.pose.factor  # at the same scatter of edges


def test_a_dirty_lens_is_a_camera_lost() -> None:
    v = view()
    result = pipeline().process(v.left, np.full_like(v.right, 3), 0, v.prior)
    assert result.fix is not None
    assert "right camera not used: black" in result.report.detail
    assert_not_confidently_wrong(result, v)


def torn(image: Image) -> Image:
    half = image.copy()
    half[image.shape[0] // 2 :] = 128
    return half


@pytest.mark.parametrize(
    "spoil",
    [
        np.zeros_like,
        lambda image: np.full_like(image, 255),
        lambda image: np.minimum(image.astype(np.int32) * 12 + 120, 255).astype(np.uint8),
        torn,
        lambda image: image[:100],
        lambda image: image[:, :, :2],
        lambda image: image.astype(np.float32),
        lambda image: image[:0, :0],
    ],
    ids=["black", "white", "saturated", "torn", "cropped", "two channels", "floats", "empty"],
)
def test_useless_images_are_a_reason(spoil: Any) -> None:
    v = view()
    result = pipeline().process(spoil(v.left), spoil(v.right), 0, v.prior)
    assert result.fix is None
    assert result.report.outcome == "no_image"
    assert "left:" in result.report.detail
    assert_not_confidently_wrong(pipeline().process(spoil(v.left), v.right, 0, v.prior), v)
    assert_not_confidently_wrong(pipeline().process(v.left, spoil(v.right), 0, v.prior), v)


def test_no_image_at_all() -> None:
    assert pipeline().process(None, None, 0, view().prior).report.outcome == "no_image"


def test_noise_and_an_image_of_nothing() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    for left, right in (
        (noise, noise[::-1].copy()),
        (cv2.GaussianBlur(noise, (0, 0), 9), cv2.GaussianBlur(noise[::-1], (0, 0), 9)),
    ):
        result = pipeline().process(left, right, 0, view().prior)
        assert result.fix is None
        assert result.report.outcome in {"no_region", "no_candidate", "no_image", "not_in_map"}


def test_swapped_cameras_are_said() -> None:
    v = view()
    result = pipeline().process(v.right, v.left, 0, v.prior)
    assert result.fix is None
    assert result.report.outcome == "swapped"
    assert "swapped" in result.report.detail


def test_the_same_image_twice_is_one_camera() -> None:
    v = view()
    result = pipeline().process(v.left, v.left, 0, v.prior)
    assert "same image" in result.report.detail
    assert_not_confidently_wrong(result, v)


@pytest.mark.parametrize("moved_m", [0.3, 3.0, 30.0])
def test_images_not_taken_together(moved_m: float) -> None:
    v, later = view(), view(1, moved_m, 0.6 * moved_m)
    result = pipeline().process(v.left, later.right, 0, v.prior)
    assert_not_confidently_wrong(result, v)


@pytest.mark.parametrize("turn", [(0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.03)], ids=["pitch", "yaw", "roll"])
def test_a_wrong_calibration(turn: tuple[float, float, float]) -> None:
    """By half a degree and more, far outside what the rig says of itself."""
    v, rig = view(), scene().rig_calibrated
    wrong = msgspec.structs.replace(rig, R_rc=so3.matrix(so3.quat_exp(np.array(turn))) @ rig.R_rc)
    result = pipeline(rig=wrong).process(v.left, v.right, 0, v.prior)
    assert_not_confidently_wrong(result, v)
    if turn[0]:
        assert "right camera not used" in result.report.detail


def test_no_landmark_near() -> None:
    v = view()
    far = Prior(v.prior.p_n + np.array([20_000.0, 0.0, 0.0]), v.prior.q_nb_wxyz, v.prior.covariance)
    assert pipeline().process(v.left, v.right, 0, far).report.outcome == "no_landmark_near"
    empty = LandmarkMap.from_landmarks(scene().map.origin, [])
    assert pipeline(empty).process(v.left, v.right, 0, v.prior).report.outcome == "no_landmark_near"


def test_a_prior_that_leaves_too_many_landmarks_open() -> None:
    """Cut to the nearest ones, the right one might be missing, and a wrong one look sure."""
    v = view()
    few = LandmarkPipeline(scene().rig_calibrated, scene().map, PipelineConfig(path="segment", most_landmarks=20))
    result = few.process(v.left, v.right, 0, v.prior)
    assert (result.fix, result.report.outcome) == (None, "prior_too_wide")


def test_a_heading_too_open_for_the_outlines_is_said_with_what_would_do() -> None:
    v = view()
    sigma = np.array([5.0, 5.0, 5.0, *np.radians([1.0, 1.0, 20.0])])
    noise = np.random.default_rng(3).integers(0, 255, v.left.shape).astype(np.uint8)
    result = pipeline().process(noise, None, 0, Prior(v.prior.p_n, v.prior.q_nb_wxyz, np.diag(sigma**2)))
    assert result.fix is None
    assert "outlines not searched: heading open by" in result.report.detail
    assert "searched up to 12.0" in result.report.detail


def test_the_wrong_street_is_not_taken_for_the_right_one() -> None:
    """The prior is wrong by 50 m, two blocks, ten of its sigmas."""
    v = view()
    wrong = Prior(v.p_n + np.array([50.0, 0.0, 0.0]), v.q_nb, v.prior.covariance)
    for _ in range(2):
        result = pipeline().process(v.left, v.right, 0, wrong)
        assert result.fix is None or np.linalg.norm(v.p_n - np.array(result.fix.p_n)) < 3.0, result.report


def test_a_map_that_is_shifted_as_it_says_is_found_and_the_claim_holds_the_shift() -> None:
    """All of the map lies 4 m off, with a prior good to 0.3 m: the fix is where the map says, its error that of the map."""
    v, sigma, shift = view(), np.array([0.3, 0.3, 0.3, *np.radians([0.2, 0.2, 0.5])]), np.array([2.4, -3.2])
    moved = [msgspec.structs.replace(m, outline_n=m.outline_n + shift, centre_n=m.centre_n + shift) for m in scene().map]
    prior = Prior(v.p_n, v.q_nb, np.diag(sigma**2))
    found = []
    for common_sigma_m in (0.0, 3.0):
        the_map = LandmarkMap.from_landmarks(scene().map.origin, moved, (common_sigma_m, 0.0))
        found.append(pipeline(the_map).process(v.left, v.right, 0, prior).fix)
    silent, fix = found
    assert silent is None
    assert fix is not None
    assert fix.covariance_common is not None
    assert np.linalg.norm(np.array(fix.p_n[:2]) - v.p_n[:2] - shift) < 0.5
    e, P = np.array(fix.p_n[:2]) - v.p_n[:2], (fix.covariance + fix.covariance_common)[:2, :2]
    assert e @ np.linalg.solve(P, e) < 5.991
    assert np.linalg.eigvalsh(P)[0] > 3.0**2


def drawn(rng: np.random.Generator, world: Scene, sigma: Array) -> View:
    """A pair from anywhere near the middle, nearly level, and a prior as wrong as it says."""
    p_n = np.array([*rng.uniform(-60.0, 60.0, 2), -rng.uniform(50.0, 90.0)])
    roll, pitch = rng.normal(0.0, np.radians(4.0), 2)
    q = so3.from_euler(roll, pitch, rng.uniform(-np.pi, np.pi))
    left, right = render_pair(world.world, world.rig, p_n, so3.matrix(q), Conditions(), rng)
    error = rng.normal(0.0, sigma)
    return View(left, right, p_n, q, Prior(p_n - error[:3], so3.multiply(so3.quat_exp(-error[3:]), q), np.diag(sigma**2)))


@pytest.mark.parametrize(("seeds", "frame", "sigma_m"), [((601, 10, 10, 0), 0, 10.0), ((601, 10, 5, 4), 8, 5.0)])
def test_the_next_house_is_not_taken_for_the_right_one(seeds: tuple[int, ...], frame: int, sigma_m: float) -> None:
    """Three and one roofs of the map lie on roofs 25 m aside, of which no map knows, as predict and verify sees them."""
    rng, sigma = np.random.default_rng(seeds), np.array([sigma_m] * 3 + np.radians([1.0, 1.0, 2.0]).tolist())
    spec = WorldSpec(
        "lookalikes", 280.0, painted=1.0, unmapped=0.3, gone=0.1, sigma_m=0.3, height_sigma_m=0.2, outline_sigma_m=0.08
    )
    world = make_world(int(rng.integers(1 << 31)), spec)
    v = [drawn(rng, world, sigma) for _ in range(frame + 1)][-1]
    result = pipeline(world.map, world.rig_calibrated).process(v.left, v.right, 0, v.prior)
    assert_not_confidently_wrong(result, v)
    only = LandmarkPipeline(world.rig_calibrated, world.map, PipelineConfig(path="predict"))
    answer = only.process(v.left, v.right, 0, v.prior)
    assert (answer.fix, answer.report.outcome) == (None, "ambiguous")


def test_a_position_that_the_image_contradicts_is_no_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where identified regions say: at the true place there is a fix, 13 m aside, between look-alikes, there is none."""
    v, sigma = view(), np.diag(np.array([0.5, 0.5, 0.5, *np.radians([0.3, 0.3, 0.5])]) ** 2)
    results = []
    for aside in (0.0, 13.0):
        position = Prior(v.p_n + np.array([aside, 0.0, 0.0]), v.q_nb, sigma)
        monkeypatch.setattr(SegmentPath, "locate", lambda _, images, *__, at=position: Identified(images, at, []))
        segmenting = LandmarkPipeline(scene().rig_calibrated, scene().map, PipelineConfig(path="segment"))
        results.append(segmenting.process(v.left, v.right, 0, v.prior))
    assert results[0].fix is not None
    assert_not_confidently_wrong(results[0], v)
    assert (results[1].fix, results[1].report.outcome) == (None, "not_found")


def test_regions_determine_the_position_and_the_outlines_there_make_the_fix() -> None:
    v = view()
    segmenting = LandmarkPipeline(scene().rig_calibrated, scene().map, PipelineConfig(path="segment"))
    result = segmenting.process(v.left, v.right, 0, v.prior)
    assert result.fix is not None
    assert_not_confidently_wrong(result, v)
    assert "regions identified" in result.report.detail
    assert "predicted:" in result.report.detail
    assert {r.path for r in result.regions} == {"predict", "segment"}
    assert sum(r.state == "identified" for r in result.regions) == len(result.fix.landmarks)
    assert result.report.regions == len(result.regions)


def moved_mark(mark: Landmark, north: float) -> Landmark:
    return Landmark.of(
        mark.id, mark.outline_n + np.array([north, 0.0]), mark.base_d, mark.height_m, mark.colour_bgr, mark.sigma_m,
        mark.height_sigma_m, mark.outline_sigma_m,
    )  # fmt: skip


def test_a_landmark_that_moved_is_rejected() -> None:
    v = view()
    used = pipeline().process(v.left, v.right, 0, v.prior)
    assert used.fix is not None
    name = used.fix.landmarks[0]
    wrong = LandmarkMap.from_landmarks(scene().map.origin, [moved_mark(m, 6.0) if m.id == name else m for m in scene().map])
    result = pipeline(wrong).process(v.left, v.right, 0, v.prior)
    assert_not_confidently_wrong(result, v)
    assert result.fix is not None
    assert name not in result.fix.landmarks


@pytest.mark.parametrize(
    "spoil",
    [
        lambda p: Prior(p.p_n * np.nan, p.q_nb_wxyz, p.covariance),
        lambda p: Prior(p.p_n, 2.0 * p.q_nb_wxyz, p.covariance),
        lambda p: Prior(p.p_n, p.q_nb_wxyz, -p.covariance),
        lambda p: Prior(p.p_n, p.q_nb_wxyz, np.zeros((6, 6))),
        lambda p: Prior(p.p_n[:2], p.q_nb_wxyz, p.covariance),
    ],
    ids=["nan", "quaternion", "negative", "zero", "shape"],
)
def test_a_prior_that_is_none(spoil: Any) -> None:
    v = view()
    assert pipeline().process(v.left, v.right, 0, spoil(v.prior)).report.outcome == "no_prior"


@pytest.mark.parametrize("height_m", [0.0, -5.0, 2000.0])
def test_a_prior_under_the_ground_or_in_the_sky(height_m: float) -> None:
    v = view()
    odd = Prior(np.array([0.0, 0.0, -height_m]), v.prior.q_nb_wxyz, v.prior.covariance)
    assert_not_confidently_wrong(pipeline().process(v.left, v.right, 0, odd), v)


def test_looking_at_the_sky() -> None:
    v = view()
    up = Prior(v.prior.p_n, so3.from_euler(np.pi, 0.0, 0.0), v.prior.covariance)
    result = pipeline().process(v.left, v.right, 0, up)
    assert result.fix is None
    assert result.report.outcome != "internal"


def test_thermal_images_of_16_bit() -> None:
    """Grey, 16 bit, a map without colours: seeds divide the image."""
    v = view()
    marks = [msgspec.structs.replace(m, colour_bgr=None) for m in scene().map]
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.uint16) * 40 + 20_000 for image in (v.left, v.right)]
    result = pipeline(LandmarkMap.from_landmarks(scene().map.origin, marks)).process(grey[0], grey[1], 0, v.prior)
    assert_not_confidently_wrong(result, v)
    assert result.report.outcome not in {"no_image", "internal"}


def test_same_images_same_fix() -> None:
    v = view()
    a, b = (pipeline().process(v.left, v.right, 0, v.prior) for _ in range(2))
    assert a.fix is not None
    assert b.fix is not None
    assert a.fix.p_n == b.fix.p_n
    assert a.report.detail == b.report.detail
    np.testing.assert_array_equal(a.fix.covariance, b.fix.covariance)
