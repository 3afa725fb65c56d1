"""Registration against an image of the ground: rendered ground, true poses, drawn priors."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from models import so3
from models.messages import Array
from models.prior import Prior
from tests import long
from tests.vision.ground import scene
from vision.ground.image import GroundImage, Heights, pyramid
from vision.ground.registration import Registered, register
from vision.ground.search import NotRegistered, RegistrationConfig, search, shift_of_ground
from vision.pose.pose import difference

_SIGMA = np.array([8.0, 8.0, 3.0, 0.01, 0.01, 0.03])
_CONFIG = RegistrationConfig()


def _case(seed: int, season: int = 0) -> tuple[Array, Array, Prior, GroundImage, Registered | NotRegistered]:
    rng = np.random.default_rng(seed)
    ground = scene.drawing(seed)
    map_image = scene.map_image(scene.drawing(seed, season) if season else ground)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    return p_n, R_nb, prior, map_image, register(scene.RIG, scene.shot(ground, p_n, R_nb, rng), prior, map_image)


def _error(p_n: Array, R_nb: Array, of_p: Array, of_R: Array) -> Array:
    return difference(p_n, R_nb, of_p, so3.from_matrix(np.ascontiguousarray(of_R)))


@long.parametrize("season", [0, 1])
def test_every_pose_is_found_and_its_covariance_is_true(season: int) -> None:
    squared, alone = [], []
    for seed in range(12):
        p_n, R_nb, _, _, found = _case(seed, season)
        assert isinstance(found, Registered)
        assert found.is_sure(_CONFIG), (seed, found.chance, found.ratio)
        fit = found.pose
        e = _error(p_n, R_nb, fit.joint_p_n, fit.joint_R_nb)
        assert np.linalg.norm(e[:2]) < 0.8
        squared.append(float(e @ np.linalg.solve(fit.joint_covariance, e)))
        alone.append(scene.chi_square(fit, p_n, R_nb))
    for values in (squared, alone):
        assert max(values) < chi2.ppf(1.0 - 1e-4, 6)
        assert 0.2 < np.mean(values) / 6.0 < 1.3  # a mean of 1 is exact, above is the worse side; the map itself: floors alone


def test_a_camera_that_looks_ahead() -> None:
    """25 degrees from straight down, heading and height off: what is seen lies far from below the vehicle."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        ground = scene.drawing(seed)
        p_n, q = np.array([-40.0, 10.0, -100.0]), so3.from_euler(0.02, 0.44, 0.3)
        q0 = so3.normalise(so3.multiply(so3.from_euler(0.0, 0.0, 0.05), q))
        prior = Prior(p_n + np.array([7.0, -6.0, 6.0]), q0, np.diag(_SIGMA**2))
        image, map_image = scene.shot(ground, p_n, so3.matrix(q), rng), scene.map_image(ground)
        position = search(scene.RIG, pyramid(image), prior, map_image, _CONFIG)
        assert not isinstance(position, NotRegistered)
        assert np.linalg.norm((position.p_n - p_n)[:2]) < 1.2, "turned about the vehicle, not about what it sees"
        found = register(scene.RIG, image, prior, map_image)
        assert isinstance(found, Registered)
        assert found.is_sure(_CONFIG)
        assert np.linalg.norm(found.pose.joint_p_n - p_n) < 0.8


@long.parametrize("decoy", ["turned", "another place", "another ground"])
def test_a_wrong_map_is_refused(decoy: str) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        ground = scene.drawing(seed)
        p_n, R_nb, prior = scene.flight(rng, _SIGMA)
        known = {
            "turned": ground[::-1, ::-1],
            "another place": np.roll(ground, 500, (0, 1)),
            "another ground": scene.drawing(seed + 99),
        }
        found = register(scene.RIG, scene.shot(ground, p_n, R_nb, rng), prior, scene.map_image(known[decoy]))
        assert isinstance(found, NotRegistered) or not found.is_likely(_CONFIG)


def test_an_error_of_the_georeference_is_common_and_not_more() -> None:
    rng = np.random.default_rng(5)
    ground = scene.drawing(5)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    image = scene.shot(ground, p_n, R_nb, rng)
    true, wrong = scene.map_image(ground), scene.map_image(ground, sigma_m=0.5)
    moved = wrong.affine.copy()
    moved[:, 2] += (0.7, -0.4)
    shifted = GroundImage("ortho", wrong.image, moved, wrong.heights, wrong.sigma_m)
    a, b = register(scene.RIG, image, prior, true), register(scene.RIG, image, prior, shifted)
    assert isinstance(a, Registered)
    assert isinstance(b, Registered)
    np.testing.assert_allclose((b.pose.p_n - a.pose.p_n)[:2], (0.7, -0.4), atol=0.15)
    floor_m = 0.1 * true.pixel_m  # of every block's place, at the same fraction of a pixel: no number of blocks makes it less
    np.testing.assert_allclose(a.pose.covariance_common[:2, :2], floor_m**2 * np.eye(2), atol=0.3 * floor_m**2)
    np.testing.assert_allclose(b.pose.covariance_common[:2, :2], 0.25 * np.eye(2), atol=0.02)
    L = b.pose.landmark_errors[0]
    np.testing.assert_allclose(L @ L.T + b.pose.covariance_rig, b.pose.covariance_common, atol=1e-12)


def test_relief_moves_the_camera_by_what_the_raster_reports() -> None:
    rng = np.random.default_rng(7)
    ground = scene.drawing(7)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    image, map_image = scene.shot(ground, p_n, R_nb, rng), scene.map_image(ground)
    raised = GroundImage("ortho", map_image.image, map_image.affine, Heights.level(-20.0, 0.0, 0.0))
    higher = Prior(prior.p_n - (0.0, 0.0, 20.0), prior.q_nb_wxyz, prior.covariance)
    a, b = register(scene.RIG, image, prior, map_image), register(scene.RIG, image, higher, raised)
    assert isinstance(a, Registered)
    assert isinstance(b, Registered)
    np.testing.assert_allclose(b.pose.p_n - a.pose.p_n, (0.0, 0.0, -20.0), atol=0.02)


def test_what_is_not_known_of_the_ground_widens_the_covariance() -> None:
    rng = np.random.default_rng(7)
    ground = scene.drawing(7)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    image, map_image = scene.shot(ground, p_n, R_nb, rng), scene.map_image(ground)
    rough = GroundImage("ortho", map_image.image, map_image.affine, Heights.level(0.0))
    a, b = register(scene.RIG, image, prior, map_image), register(scene.RIG, image, prior, rough)
    assert isinstance(a, Registered)
    assert isinstance(b, Registered)
    assert np.all(np.diag(b.pose.covariance)[:3] > 4.0 * np.diag(a.pose.covariance)[:3])
    assert 0.9 < np.sqrt(b.pose.covariance_common[2, 2]) < 1.1  # roofs stand up: a third of 3 m is common to all of them


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"sky": True}, "no_ground"),
        ({"far": True}, "outside"),
        ({"wide": True}, "prior_too_wide"),
        ({"blank": True}, "no_structure"),
        ({"landed": True}, "prior_too_wide"),
    ],
)
def test_the_reason_for_none_is_reported(change: dict[str, bool], reason: str) -> None:
    rng = np.random.default_rng(3)
    ground = scene.drawing(3)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    image, map_image = scene.shot(ground, p_n, R_nb, rng), scene.map_image(ground)
    q, p0, covariance = prior.q_nb_wxyz, prior.p_n, prior.covariance
    if "sky" in change:
        q = so3.multiply(so3.from_euler(np.pi, 0.0, 0.0), q)
    if "far" in change:
        p0 = p0 + np.array([900.0, 0.0, 0.0])
    if "landed" in change:
        p0 = np.array([0.0, 0.0, -0.2])
    if "wide" in change:
        covariance = covariance * 400.0
    if "blank" in change:
        image = np.full_like(image, 90)
    found = register(scene.RIG, image, Prior(p0, q, covariance), map_image)
    assert isinstance(found, NotRegistered)
    assert found.reason == reason


def test_the_shift_of_the_ground_is_the_derivative() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        arm = np.array([*rng.normal(0.0, 60.0, 2), rng.uniform(50.0, 150.0)])

        def hit(x: Array, arm: Array = arm) -> Array:
            ray = so3.matrix(so3.quat_exp(np.ascontiguousarray(x[3:]))) @ arm
            reach: Array = x[:2] + ray[:2] * (arm[2] - x[2]) / ray[2]
            return reach

        step = 1e-6
        numeric = np.column_stack([(hit(step * d) - hit(-step * d)) / (2.0 * step) for d in np.eye(6)])
        np.testing.assert_allclose(shift_of_ground(arm), numeric, rtol=1e-5, atol=1e-5)


def test_evidence_is_needed_of_both_kinds() -> None:
    *_, found = _case(0)
    assert isinstance(found, Registered)
    fields = {name: getattr(found, name) for name in found.__dataclass_fields__}
    lower = replace(found.peak, ratio=1.1)
    assert not Registered(**{**fields, "peak": lower}).is_sure(_CONFIG)
    assert Registered(**{**fields, "peak": lower}).is_likely(_CONFIG)
    assert not Registered(**{**fields, "chance": 1e-3}).is_likely(_CONFIG)
    strict = msgspec.structs.replace(_CONFIG, sure=1e-30)
    assert not found.is_sure(strict)
