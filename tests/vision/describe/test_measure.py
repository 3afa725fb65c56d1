"""What is measured, and whether its standard deviations are true."""

import msgspec
import numpy as np
import pytest

from models import so3
from models.messages import Array
from tests.vision import roofs, stereo_scene
from tests.vision.describe.test_correspond import grey, regions_of
from vision.describe.correspond import Match, correspond
from vision.describe.measure import QUANTITIES, Level, Measured, Unmeasured, measure
from vision.describe.plane import DisparityPlane
from vision.describe.regions import Region
from vision.describe.survey import Settings, survey
from vision.image.rectify import rectification


def perfect_match(corners_c: Array, sigma_px: float = 0.02) -> Match:
    """What correspond would say of a flat polygon in space that it sees without error."""
    rig = stereo_scene.rig()
    px = rig.left.project(corners_c)
    disparity = stereo_scene.F * stereo_scene.BASELINE / corners_c[:, 2]
    origin = px.mean(axis=0)
    A = np.column_stack((np.ones(len(px)), px - origin))
    coefficients = np.linalg.lstsq(A, disparity, rcond=None)[0]
    plane = DisparityPlane(origin, coefficients, np.diag([sigma_px**2, 1e-10, 1e-10]), 1.0, 20)
    region = Region(px, px, 1.0, (0, 0, 1, 1), np.ones((1, 1), np.bool_), False, (0.0, 0.0, 0.0), 0.05, 1)
    return Match(region, px, disparity, np.full(len(px), 0.1), plane, 0.9, 0.0, 0.1)


def rectangle_c(size: tuple[float, float], slope: Array, depth_m: float, turn: float) -> Array:
    """Corners (4, 3) of a rectangle, anticlockwise as seen, tilted by the rotation vector slope."""
    c, s = np.cos(turn), np.sin(turn)
    flat = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * np.array(size) / 2.0 @ np.array([[c, s], [-s, c]])
    return np.asarray(np.column_stack((flat, np.zeros(4))) @ so3.matrix(so3.quat_exp(slope)).T + (0.4, -0.2, depth_m))


@pytest.mark.parametrize("slope", [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.3, 0.6, 0.0)])
@pytest.mark.parametrize("turn", [0.2, 1.1, 2.5])
def test_a_rectangle_in_space_is_measured_exactly(slope: tuple[float, float, float], turn: float) -> None:
    """Width, length, size, fill ratio, centre, normal and axis of a tilted rectangle, from its projection and plane."""
    corners = rectangle_c((1.5, 2.5), np.array(slope), 9.0, turn)
    m = measure(perfect_match(corners), stereo_scene.rig())
    assert isinstance(m, Measured)
    assert (m.width_m, m.length_m, m.size_m2, m.fill_ratio) == pytest.approx((1.5, 2.5, 3.75, 1.0), rel=1e-6)
    np.testing.assert_allclose(m.outline_c, corners, atol=1e-9)
    np.testing.assert_allclose(m.centre_c, corners.mean(axis=0), atol=1e-9)
    assert m.distance_m == pytest.approx(np.linalg.norm(corners.mean(axis=0)))
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    np.testing.assert_allclose(m.normal_c, -normal / np.linalg.norm(normal) * np.sign(normal @ m.centre_c), atol=1e-9)
    along = (corners[1] - corners[0]) / 2.5
    assert abs(m.axis_c @ along) == pytest.approx(1.0, abs=1e-9)
    assert m.disparity_px == pytest.approx(stereo_scene.F * stereo_scene.BASELINE / m.centre_c[2], rel=2e-3)


def test_a_depth_error_moves_all_sizes_together() -> None:
    """s_Z = Z^2 s_d / (f b), s_L / L = s_Z / Z: where only the disparity is uncertain."""
    corners = rectangle_c((1.5, 2.5), np.zeros(3), 9.0, 0.3)
    m = measure(perfect_match(corners, sigma_px=0.5), stereo_scene.rig())
    assert isinstance(m, Measured)
    relative = 0.5 * 9.0 / (stereo_scene.F * stereo_scene.BASELINE)
    assert m.sigma("distance_m") / m.distance_m == pytest.approx(relative, rel=0.02)
    assert m.sigma("width_m") / m.width_m == pytest.approx(relative, rel=0.1)
    assert m.sigma("size_m2") / m.size_m2 == pytest.approx(2.0 * relative, rel=0.1)
    correlation = m.covariance / np.sqrt(np.outer(np.diag(m.covariance), np.diag(m.covariance)))
    assert correlation[:4, :4].min() > 0.9
    assert m.sigma("fill_ratio") < 0.02


def test_the_rigs_uncertainty_is_in_the_covariance() -> None:
    """A yaw of the right camera by theta moves the disparity by f theta (1 + x^2); a longer baseline all sizes alike."""
    corners = rectangle_c((1.5, 2.5), np.zeros(3), 9.0, 0.3)
    rig, match = stereo_scene.rig(), perfect_match(corners)
    exact = measure(match, rig)
    yaw = measure(match, msgspec.structs.replace(rig, covariance_rc=np.diag([0, 0, 0, 0, 1e-3, 0]) ** 2))
    baseline = measure(match, msgspec.structs.replace(rig, covariance_rc=np.diag([3e-3, 0, 0, 0, 0, 0]) ** 2))
    assert isinstance(exact, Measured)
    assert isinstance(yaw, Measured)
    assert isinstance(baseline, Measured)
    assert exact.rig_sigma_px == 0.0
    assert yaw.rig_sigma_px == pytest.approx(0.5, rel=0.01)
    assert baseline.rig_sigma_px / baseline.disparity_px == pytest.approx(3e-3 / 0.3, rel=0.01)
    assert yaw.sigma("distance_m") == pytest.approx(0.5 * 81.0 / 150.0, rel=0.05)


def test_a_wrong_rig_is_off_by_what_its_covariance_reports() -> None:
    """The right camera turned and moved by draws of the covariance: distance errors have unit variance in sigmas."""
    rng = np.random.default_rng(5)
    sigmas = np.array([1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4])
    corners = rectangle_c((1.5, 2.5), np.array([0.2, -0.1, 0.0]), 9.0, 0.3)
    rig = msgspec.structs.replace(stereo_scene.rig(), covariance_rc=np.diag(sigmas**2))
    normalised = []
    for _ in range(120):
        e = rng.normal(0.0, sigmas)
        x_r = (corners + rig.t_rc) @ so3.matrix(so3.quat_exp(e[3:])).T + e[:3]
        match = perfect_match(corners, 1e-4)
        d = match.region.contour[:, 0] - rig.right.project(x_r)[:, 0]
        A = np.column_stack((np.ones(4), match.region.contour - match.plane.origin))
        plane = DisparityPlane(
            match.plane.origin, np.linalg.lstsq(A, d, rcond=None)[0].astype(np.float64), match.plane.covariance, 1.0, 20
        )
        m = measure(Match(match.region, match.points, d, match.sigmas, plane, 0.9, 0.0, 0.1), rig)
        assert isinstance(m, Measured)
        values = np.array([m.distance_m - np.linalg.norm(corners.mean(axis=0)), m.width_m - 1.5, m.size_m2 - 3.75])
        normalised.append(values / (m.sigma("distance_m"), m.sigma("width_m"), m.sigma("size_m2")))
    assert (np.abs(np.sqrt(np.mean(np.square(normalised), axis=0)) - (1.0, 0.75, 0.95)) < 0.25).all()


def test_what_is_too_far_or_behind_is_not_measured() -> None:
    rig = stereo_scene.rig()
    far = measure(perfect_match(rectangle_c((40.0, 60.0), np.zeros(3), 900.0, 0.3), 0.1), rig)
    assert isinstance(far, Unmeasured)
    assert "too far" in far.reason
    match = perfect_match(rectangle_c((1.5, 2.5), np.zeros(3), 9.0, 0.3))
    behind = DisparityPlane(match.plane.origin, -match.plane.coefficients, match.plane.covariance, 1.0, 20)
    result = measure(Match(match.region, match.points, match.disparities, match.sigmas, behind, 0.9, 0.0, 0.1), rig)
    assert isinstance(result, Unmeasured)
    assert "behind" in result.reason


def test_a_known_normal_makes_the_sizes_better() -> None:
    """Tilt hardly seen at a distance: with the attitude known the sizes are right, and their sigmas smaller."""
    rig = stereo_scene.rig()
    left, right, corners = stereo_scene.board(rig, 11.0, slope=(0.3, -0.2), noise=3.0, contrast=8.0)
    (match,) = correspond(grey(left), grey(right), regions_of(left), rig)
    assert isinstance(match, Match)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normal *= -np.sign(normal[2]) / np.linalg.norm(normal)
    free, level = measure(match, rig), measure(match, rig, level=Level(normal, np.radians(1.0)))
    assert isinstance(free, Measured)
    assert isinstance(level, Measured)
    assert abs(level.width_m - 1.6) < 3.0 * level.sigma("width_m") < 0.15
    assert level.sigma("size_m2") < 0.7 * free.sigma("size_m2")
    assert np.degrees(np.arccos(level.normal_c @ normal)) < 1.5


def normalised_errors(with_level: bool) -> tuple[Array, Array]:
    """Errors of QUANTITIES in sigmas (N, 5), and chi-square of the centre (N,), over rendered views through bent lenses."""
    rig = roofs.nadir_rig(lens=(-0.12, 0.08, 0.0005, -0.0003), squint_rad=0.004)
    made = rectification(rig)
    R = made.rig.R_bc.T @ rig.R_bc
    errors, squares = [], []
    for seed in range(24):
        view = roofs.view(seed, height_m=(20.0, 40.0)[seed % 2], rig=rig)
        turned = roofs.View(
            view.left, view.right, rig, view.landmarks, tuple(c @ R.T for c in view.roofs_c),
            Level(R @ view.level.normal_c, view.level.sigma_rad),
        )  # fmt: skip
        found = survey(
            view.left, view.right, made, Settings(colours_bgr=roofs.COLOURS, level=turned.level if with_level else None)
        )
        assert not isinstance(found, str)
        assert found.problem is None
        for m in found.measured:
            k = roofs.roof_at(turned, m.region.contour, made.rig)
            if k is None or m.region.touches_border:
                continue
            mark, centre = view.landmarks[k], turned.roofs_c[k].mean(axis=0)
            true = (np.linalg.norm(centre), mark.width_m, mark.length_m, mark.size_m2, mark.fill_ratio)
            errors.append([(getattr(m, q) - t) / m.sigma(q) for q, t in zip(QUANTITIES, true, strict=True)])
            squares.append((m.centre_c - centre) @ np.linalg.solve(m.covariance_c, m.centre_c - centre))
    return np.array(errors), np.array(squares)


@pytest.mark.parametrize("with_level", [False, True])
def test_the_standard_deviations_are_true(with_level: bool) -> None:
    """Rendered roofs through bent lenses at 20 and 40 m: errors in sigmas have unit variance, and are not too good either."""
    errors, squares = normalised_errors(with_level)
    assert len(errors) > 45
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert (rms[:4] > 0.5).all()
    assert (rms < 1.5).all(), rms
    assert (np.abs(errors[:, :4]) < 3.0).mean() > 0.97
    assert 1.5 < np.mean(squares) < 5.0
