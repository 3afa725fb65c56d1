"""Pose from identified landmarks on rendered images whose truth is known: accuracy, consistency, systematic errors, what is
refused.
"""

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from tests.vision.roofs import nadir_rig
from vision.outline.visibility import MapError
from vision.pose import observation
from vision.pose.observation import Image, ObservationConfig, Scene
from vision.pose.pose import NoPose, PoseConfig, PoseEstimate, combine, difference, estimate_pose
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.world import Appearance, Sun, World

SIGMA = np.array([3.0, 3.0, 2.0, *np.radians([0.5, 0.5, 2.0])])
COLOURS = ((40, 50, 190), (170, 80, 40), (60, 170, 60))


@dataclass(frozen=True)
class Flight:
    """One view, and the prior of it."""

    images: tuple[Image, Image]
    rig: StereoRig
    landmarks: tuple[Landmark, ...]
    p_n: Array
    R_nb: Array
    prior: Prior


def flight(seed: int, marks: int = 3, height_m: float = 40.0, tilt: float = 0.15, rig: StereoRig | None = None) -> Flight:
    """Painted boxes below, seen from height_m; the prior is drawn about the truth."""
    rng, rig = np.random.default_rng(seed), rig or nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
    positions = np.array([(0.1, 0.0), (-0.2, 0.25), (-0.15, -0.25)])[:marks] * height_m
    true = []
    for k, position in enumerate(positions):
        a, size = rng.uniform(0.0, np.pi), rng.uniform(0.12, 0.2) * height_m
        turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        corners = np.array([(-0.5, -0.35), (0.5, -0.35), (0.5, 0.35), (-0.5, 0.35)]) * size
        true.append(Landmark.of(str(k), corners @ turn + position, 0.0, rng.uniform(0.03, 0.1) * height_m, COLOURS[k]))
    return seen_from_above(rng, rig, true, true, height_m, tilt, SIGMA)


def seen_from_above(
    rng: np.random.Generator,
    rig: StereoRig,
    true: list[Landmark],
    mapped: list[Landmark],
    height_m: float,
    tilt: float,
    sigma: Array,
) -> Flight:
    """Landmarks as they stand and as they are mapped, on textured ground; a prior drawn with sigma (6,) about the truth."""
    looks = tuple(Appearance(mark.colour_bgr or (0, 0, 0)) for mark in true)
    world = World(tuple(true), looks, (), Ground.procedural(rng), Sun(rng.uniform(-3.0, 3.0)))
    roll, pitch = rng.normal(0.0, tilt, 2)
    R_nb = so3.matrix(so3.from_euler(roll, pitch, rng.uniform(-3.0, 3.0)))
    p_n = np.array([*rng.normal(0.0, 1.0, 2), -height_m])
    images = render_pair(world, rig, p_n, R_nb, Conditions(), rng)
    error = sigma * rng.normal(size=6)
    q = so3.normalise(so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(R_nb)))
    return Flight(images, rig, tuple(mapped), p_n, R_nb, Prior(p_n - error[:3], q, np.diag(sigma**2)))


def near(view: Flight, seed: int = 0) -> tuple[Array, Array]:
    """A start as regions give it: a few pixels off."""
    error = np.random.default_rng(seed).normal(size=6) * np.array([0.1, 0.1, 0.2, 2e-3, 2e-3, 5e-3])
    return view.p_n + error[:3], so3.matrix(so3.quat_exp(error[3:])) @ view.R_nb


def estimate(view: Flight, images: tuple[Image | None, ...] | None = None, prior: Prior | None = None) -> PoseEstimate:
    found = estimate_pose(view.rig, images or view.images, view.landmarks, near(view), prior or view.prior)
    assert isinstance(found, PoseEstimate), found
    return found


def total(found: PoseEstimate) -> Array:
    result: Array = found.covariance + found.covariance_common
    return result


@pytest.fixture(scope="module")
def view() -> Flight:
    return flight(1)


def test_poses_of_painted_boxes_are_centimetres_off_and_know_it() -> None:
    """Mean squared Mahalanobis distance of 12 views, per degree of freedom, two-sided; of posterior and of images alone."""
    joint, alone = [], []
    for seed in range(12):
        one = flight(seed, marks=1 + seed % 3)
        found = estimate(one)
        truth = so3.from_matrix(one.R_nb)
        e = difference(found.joint_p_n, found.joint_R_nb, one.p_n, truth)
        joint.append(e @ np.linalg.solve(found.joint_covariance, e) / 6.0)
        e = difference(found.p_n, found.R_nb, one.p_n, truth)
        alone.append(e @ np.linalg.solve(total(found), e) / 6.0)
        if len(one.landmarks) == 3:
            assert np.linalg.norm(found.joint_p_n - one.p_n) < 0.12
    assert 0.35 < np.mean(joint) < 1.6
    assert 0.35 < np.mean(alone) < 1.6


def test_fusing_the_fix_with_the_prior_gives_the_joint_optimum(view: Flight) -> None:
    found = estimate(view)
    p_n, R_nb, covariance = combine(view.prior, found.p_n, found.R_nb, total(found))
    np.testing.assert_allclose(p_n, found.joint_p_n, atol=1e-3)
    np.testing.assert_allclose(R_nb, found.joint_R_nb, atol=1e-5)
    np.testing.assert_allclose(covariance, found.joint_covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_prior_is_not_in_the_fix(seed: int) -> None:
    """One landmark, where the prior matters most: covariance and attitude of the fix stay when the prior is another one."""
    one = flight(seed, marks=1)
    found = estimate(one)
    wide = estimate(one, prior=with_changes(one.prior, covariance=4.0 * one.prior.covariance))
    np.testing.assert_allclose(np.diag(total(wide)), np.diag(total(found)), rtol=0.3)
    q = so3.normalise(so3.multiply(so3.quat_exp(np.array([0.5, -0.5, 0.0]) * SIGMA[3:]), one.prior.q_nb_wxyz))
    moved = estimate(one, prior=with_changes(one.prior, q_nb_wxyz=q))
    fix = difference(moved.p_n, moved.R_nb, found.p_n, so3.from_matrix(found.R_nb))[3:5]
    joint = difference(moved.joint_p_n, moved.joint_R_nb, found.joint_p_n, so3.from_matrix(found.joint_R_nb))[3:5]
    assert np.linalg.norm(joint) > 0.1 * SIGMA[3]
    assert np.linalg.norm(fix) < 0.4 * np.linalg.norm(joint)


def with_changes(prior: Prior, **changes: Array) -> Prior:
    values = {"p_n": prior.p_n, "q_nb_wxyz": prior.q_nb_wxyz, "covariance": prior.covariance} | changes
    return Prior(values["p_n"], values["q_nb_wxyz"], values["covariance"])


def test_one_camera_is_enough_and_measures_less(view: Flight) -> None:
    both = estimate(view)
    for images in ((view.images[0], None), (None, view.images[1])):
        one = estimate(view, images)
        assert np.linalg.norm(one.joint_p_n - view.p_n) < 0.25
        assert np.trace(total(one)[:3, :3]) > np.trace(total(both)[:3, :3])


def test_grey_images_do(view: Flight) -> None:
    grey = [np.ascontiguousarray(image[:, :, 1]) for image in view.images]
    assert np.linalg.norm(estimate(view, (grey[0], grey[1])).joint_p_n - view.p_n) < 0.2


def test_map_errors_are_common_and_estimated() -> None:
    """All landmarks 0.4 m off to the east with sigma 0.5 m: the fix is off by as much, and says that this part repeats."""
    view = flight(2)
    shifted = [
        msgspec.structs.replace(mark, outline_n=mark.outline_n + np.array([0.0, 0.4]), sigma_m=0.5) for mark in view.landmarks
    ]
    start, turn = near(view)
    found = estimate_pose(view.rig, view.images, shifted, (start + np.array([0.0, 0.4, 0.0]), turn), view.prior)
    assert isinstance(found, PoseEstimate)
    assert found.joint_p_n[1] - view.p_n[1] == pytest.approx(0.4, abs=0.15)
    common, image = np.diag(found.covariance_common), np.diag(found.covariance)
    assert common[1] > 0.5**2 / 3.0
    assert common[1] > 5.0 * image[1]
    exact = estimate(view)
    assert np.diag(exact.covariance_common)[1] < 0.01 * common[1]
    ratio = image[:3] / np.diag(exact.covariance)[:3]
    assert (ratio > 0.25).all()
    assert (ratio < 20.0).all()  # landmarks are weighed by their map errors, not by how well they are seen: 1 to 14 in five views


def test_roofs_lower_than_mapped_are_seen_on_all_sides() -> None:
    """Their far sides are not hidden by the roofs as mapped: as many edges are fitted as with an exact map."""
    view = flight(7)
    high = [Landmark.of(m.id, m.outline_n, m.base_d, m.height_m + 0.4, m.colour_bgr, 0.0, 0.4) for m in view.landmarks]
    exact, fit = (estimate_pose(view.rig, view.images, some, near(view), view.prior) for some in (view.landmarks, high))
    assert isinstance(exact, PoseEstimate)
    assert isinstance(fit, PoseEstimate)
    assert fit.shift_m[:, MapError.RISE].min() < -0.2
    assert fit.edges >= exact.edges - 1


def test_one_landmark_off_the_map_moves_the_fix_less_than_its_error() -> None:
    """Landmarks are weighed by their map errors: that of 2 m does not pull those of 0.05 m."""
    view = flight(2)
    marks = [msgspec.structs.replace(mark, sigma_m=0.05) for mark in view.landmarks]
    marks[0] = msgspec.structs.replace(marks[0], outline_n=marks[0].outline_n + np.array([0.5, 0.0]), sigma_m=2.0)
    found = estimate_pose(view.rig, view.images, marks, near(view), view.prior)
    assert isinstance(found, PoseEstimate)
    assert abs(found.joint_p_n[0] - view.p_n[0]) < 0.15
    assert found.shift_m[0, 0] == pytest.approx(-0.5, abs=0.15)


def test_ground_that_slopes_does_not_bias_the_position() -> None:
    """A mark on ground of 3 degrees, known to be level to that: the attitude is the prior's, the place as sure as that."""
    level, slope = flight(1, marks=1, tilt=0.0), so3.matrix(so3.quat_exp(np.radians([3.0, 0.0, 0.0])))
    marks, images = _painted(level)
    tilted = [_on_slope(mark, slope) for mark in marks]
    q = so3.normalise(so3.multiply(so3.from_matrix(slope), level.prior.q_nb_wxyz))
    prior = Prior(slope @ level.prior.p_n, q, level.prior.covariance)
    p_n, R_nb = slope @ level.p_n, slope @ level.R_nb
    errors = []
    for marks in (tilted, [msgspec.structs.replace(mark, height_sigma_m=0.0) for mark in tilted]):
        found = estimate_pose(level.rig, images, marks, (p_n, R_nb), prior)
        assert isinstance(found, PoseEstimate), found
        e = found.joint_p_n - p_n
        errors.append((float(np.linalg.norm(e)), float(e @ np.linalg.solve(found.joint_covariance[:3, :3], e)) / 3.0))
    assert errors[0][0] < 0.6
    assert errors[0][1] < 3.0
    assert errors[1][0] > 1.0
    assert errors[1][1] > 20.0


def _painted(view: Flight) -> tuple[list[Landmark], tuple[Image, Image]]:
    """The view's landmarks without their height."""
    marks = [msgspec.structs.replace(mark, height_m=0.0) for mark in view.landmarks]
    looks = tuple(Appearance(COLOURS[k]) for k in range(len(marks)))
    rng = np.random.default_rng(0)
    world = World(tuple(marks), looks, (), Ground.procedural(rng), Sun(0.0))
    return marks, render_pair(world, view.rig, view.p_n, view.R_nb, Conditions(), rng)


def _on_slope(mark: Landmark, slope: Array) -> Landmark:
    """A painted mark of level ground as a map has it whose down is another: level at its mean height, and how much it is not."""
    corners = np.column_stack((mark.outline_n, np.zeros(len(mark.outline_n)))) @ slope.T
    base_d = float(corners[:, 2].mean())
    uneven = float(corners[:, 2].std())
    return Landmark.of(mark.id, corners[:, :2], base_d, 0.0, mark.colour_bgr, height_sigma_m=uneven)


def test_rig_errors_are_common() -> None:
    exact = flight(3)
    rig = msgspec.structs.replace(exact.rig, covariance_bc=np.diag([0.02] * 3 + [0.01] * 3) ** 2)
    found = estimate_pose(rig, exact.images, exact.landmarks, near(exact), exact.prior)
    assert isinstance(found, PoseEstimate)
    # A camera turned on the body by 10 mrad turns the attitude by as much.
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance_common))[3:], 0.01, rtol=0.1)


def test_the_common_part_is_distinguished_by_landmark_and_rig() -> None:
    view = flight(2)
    marks = [msgspec.structs.replace(mark, sigma_m=0.5, height_sigma_m=0.2) for mark in view.landmarks]
    rig = msgspec.structs.replace(view.rig, covariance_bc=np.diag([0.02] * 3 + [0.01] * 3) ** 2)
    found = estimate_pose(rig, view.images, marks, near(view), view.prior)
    assert isinstance(found, PoseEstimate)
    assert found.landmark_errors.shape == (len(marks), 6, len(MapError))
    whole = np.einsum("mik,mjk->ij", found.landmark_errors, found.landmark_errors) + found.covariance_rig
    np.testing.assert_allclose(whole, found.covariance_common, atol=1e-9)
    together = np.abs(found.landmark_errors[:, :2, :2].sum(axis=0))  # a map shifted as a whole shifts the fix by as much
    np.testing.assert_allclose(together, 0.5 * np.eye(2), atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance_rig))[3:], 0.01, rtol=0.1)


def test_half_a_turn_is_left_open_without_a_heading() -> None:
    """One rectangle painted on the ground and a prior that knows no heading."""
    view = flight(5, marks=1)
    flat = msgspec.structs.replace(view.landmarks[0], height_m=0.0, base_d=view.landmarks[0].roof_d)
    loose = with_changes(view.prior, covariance=np.diag([20.0, 20.0, 2.0, 0.3, 0.3, 3.0]) ** 2)
    found = estimate_pose(view.rig, view.images, [flat], near(view), loose)
    assert isinstance(found, NoPose)
    assert found.reason == "ambiguous"
    assert isinstance(estimate_pose(view.rig, view.images, [flat], near(view), view.prior), PoseEstimate)


def test_a_quarter_turn_is_left_open_by_a_square() -> None:
    """The prior allows a quarter turn and no half one."""
    view = flight(5, marks=1)
    middle = view.landmarks[0].outline_n.mean(axis=0)
    square = 3.0 * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) + middle
    mark = Landmark.of("0", square, 0.0, 0.0, COLOURS[0])
    world = World((mark,), (Appearance(COLOURS[0]),), (), Ground.procedural(np.random.default_rng(1)))
    images = render_pair(world, view.rig, view.p_n, view.R_nb, Conditions(), np.random.default_rng(2))
    found = []
    for sigma_deg in (35.0, 2.0):
        loose = with_changes(view.prior, covariance=np.diag([15.0, 15.0, 2.0, 0.05, 0.05, np.radians(sigma_deg)]) ** 2)
        found.append(estimate_pose(view.rig, images, [mark], near(view), loose))
    assert isinstance(found[0], NoPose)
    assert found[0].reason == "ambiguous"
    assert isinstance(found[1], PoseEstimate)


@pytest.mark.parametrize("value", [0, 255])
def test_images_of_nothing_are_no_pose(view: Flight, value: int) -> None:
    blank = np.full_like(view.images[0], value)
    found = estimate_pose(view.rig, (blank, blank), view.landmarks, near(view), view.prior)
    assert isinstance(found, NoPose)
    assert found.reason in ("too_few_edges", "not_found")


def test_nothing_to_look_at(view: Flight) -> None:
    assert estimate_pose(view.rig, (None, None), view.landmarks, near(view), view.prior) == NoPose("no_image")
    assert isinstance(estimate_pose(view.rig, view.images, [], near(view), view.prior), NoPose)


def test_a_prior_that_is_none_is_no_pose_and_no_exception(view: Flight) -> None:
    singular = with_changes(view.prior, covariance=np.diag([1.0, 1.0, 0.0, 0.01, 0.01, 0.01]))
    found = estimate_pose(view.rig, view.images, view.landmarks, near(view), singular)
    assert isinstance(found, NoPose)
    assert found.reason == "diverged"


def test_a_start_elsewhere_is_no_confident_wrong_pose(view: Flight) -> None:
    """20 m off the outlines fall on grass."""
    p, turn = near(view)
    found = estimate_pose(view.rig, view.images, view.landmarks, (p + np.array([20.0, 0.0, 0.0]), turn), view.prior)
    if isinstance(found, PoseEstimate):
        e = difference(found.p_n, found.R_nb, view.p_n, so3.from_matrix(view.R_nb))
        assert e @ np.linalg.solve(total(found), e) < 40.0


@pytest.mark.parametrize(("east_m", "reaches"), [(0.0, [2.5]), (0.02, [2.5]), (0.12, [2.5, 1.5])])
def test_edges_that_hardly_move_are_looked_at_once(
    view: Flight, east_m: float, reaches: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """15 px a metre; one look and two give the same pose."""
    given, looked = list[float](), Scene.observe

    def noted(*args: Any, **kwargs: Any) -> observation.Observation:
        given.append(kwargs["farthest_px"])
        return looked(*args, **kwargs)

    def at(east: float, farthest: tuple[float, ...]) -> PoseEstimate:
        start = view.p_n + np.array([0.0, east, 0.0]), view.R_nb
        config = PoseConfig(observation=ObservationConfig(search_px=(), farthest_px=farthest))
        found = estimate_pose(view.rig, view.images, view.landmarks, start, view.prior, config)
        assert isinstance(found, PoseEstimate)
        return found

    best = at(0.0, (2.5, 1.5, 1.5))
    monkeypatch.setattr(Scene, "observe", lambda self, *args: noted(self, *args[:5], search_px=args[5], farthest_px=args[6]))
    found = at(east_m, (2.5, 1.5))
    assert given == reaches
    off = difference(found.joint_p_n, found.joint_R_nb, best.joint_p_n, so3.from_matrix(best.joint_R_nb))
    assert off @ np.linalg.solve(best.joint_covariance, off) < 0.3


def test_a_side_that_stays_off_is_not_found_though_nothing_else_moves(view: Flight) -> None:
    """A porch: the side stands 2 px farther out than mapped, within reach of the first look and not of the second."""
    outline = view.landmarks[0].outline_n.copy()
    along = outline[1] - outline[0]
    inwards = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    inwards *= np.sign(inwards @ (outline[2] - outline[0]))
    outline[:2] += 2.0 / 15.0 * inwards
    marks = [msgspec.structs.replace(view.landmarks[0], outline_n=outline), *view.landmarks[1:]]

    def share(*farthest: float) -> float:
        config = PoseConfig(observation=ObservationConfig(search_px=(), farthest_px=farthest))
        found = estimate_pose(view.rig, view.images, marks, (view.p_n, view.R_nb), view.prior, config)
        assert isinstance(found, PoseEstimate)
        return found.found

    assert share(2.5, 1.5) < share(2.5, 2.5) - 0.05


def test_same_input_same_bits(view: Flight) -> None:
    first, second = estimate(view), estimate(view)
    assert first.p_n.tobytes() == second.p_n.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
