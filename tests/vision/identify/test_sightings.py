"""Sightings against geometry done by hand: a roof of known size seen from a known pose."""

import math

import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from models.maps import outline as polygon
from models.messages import Array
from models.prior import Prior
from vision.describe.measure import Measured
from vision.describe.regions import Region
from vision.identify import sightings
from vision.identify.catalogue import Sighting
from vision.synthetic.rigs import make_rig

ROOF_D, WIDTH, LENGTH, TURN = -4.0, 8.0, 14.0, 0.6
CENTRE = np.array([6.0, -9.0, ROOF_D])
P_N, Q = np.array([1.0, -2.0, -70.0]), so3.from_euler(0.08, -0.06, 1.2)
PRIOR = Prior(P_N, Q, np.diag([9.0] * 3 + [math.radians(1.0) ** 2] * 3))


def roof() -> Array:
    c, s = math.cos(TURN), math.sin(TURN)
    flat = 0.5 * np.array([[LENGTH, WIDTH], [-LENGTH, WIDTH], [-LENGTH, -WIDTH], [LENGTH, -WIDTH]]) @ np.array([[c, s], [-s, c]])
    return np.asarray(np.column_stack([flat, np.zeros(4)]) + CENTRE)


def region(rig: StereoRig) -> Region:
    p_nc, R_nc = rig.camera_pose(P_N, so3.matrix(Q))
    px = rig.left.project((roof() - p_nc) @ R_nc)
    return Region(px, px, abs(polygon.area(px)), (0, 0, 1, 1), np.ones((1, 1), np.bool_), False, (1.0, 2.0, 3.0), 0.1, 1)


def check(s: Sighting | None, scale: float = 1.0) -> Sighting:
    assert s is not None
    np.testing.assert_allclose(s.arm_n, scale * (CENTRE - P_N), atol=0.1)
    assert (s.width_m, s.length_m) == pytest.approx((scale * WIDTH, scale * LENGTH), rel=2e-3)
    assert s.size_m2 == pytest.approx(scale**2 * WIDTH * LENGTH, rel=2e-3)
    assert s.fill_ratio == pytest.approx(1.0, abs=1e-3)
    assert s.orientation_rad == pytest.approx(TURN, abs=1e-3)
    assert s.colour_bgr == (1.0, 2.0, 3.0)
    for covariance in (s.covariance_n, s.log_size_covariance):
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
    return s


def test_one_camera_measures_on_the_plane_of_the_roofs() -> None:
    rig = make_rig(distortion=())
    check(sightings.from_one_camera(region(rig), PRIOR, rig, ROOF_D))


def test_a_higher_prior_makes_all_larger_alike() -> None:
    rig = make_rig(distortion=())
    rig = StereoRig(rig.left, rig.right, rig.R_rc, rig.t_rc, rig.R_bc, np.zeros(3))
    higher = Prior(P_N - np.array([0.0, 0.0, 6.6]), Q, PRIOR.covariance)
    check(sightings.from_one_camera(region(rig), higher, rig, ROOF_D), 1.1)


def test_the_right_camera_alone_measures_the_same() -> None:
    rig = make_rig(distortion=())
    alone = sightings.one_eyed(rig, right=True)
    p, R = rig.right_camera_pose(P_N, so3.matrix(Q))
    np.testing.assert_allclose(alone.camera_pose(P_N, so3.matrix(Q))[0], p)
    np.testing.assert_allclose(alone.camera_pose(P_N, so3.matrix(Q))[1], R)
    check(sightings.from_one_camera(region(alone), PRIOR, alone, ROOF_D))
    assert sightings.one_eyed(rig, right=False) is rig


def measured(rig: StereoRig, error: float = 0.0) -> Measured:
    """As stereo would have it, all depths wrong by a factor."""
    p_nc, R_nc = rig.camera_pose(P_N, so3.matrix(Q))
    centre_c, r = (1.0 + error) * (CENTRE - p_nc) @ R_nc, region(rig)
    distance, disparity = float(np.linalg.norm(centre_c)), rig.left.fx * rig.baseline_m / float(centre_c[2])
    return Measured(
        r, centre_c, np.eye(3), np.zeros(3), np.zeros(3), np.zeros((4, 3)), distance, WIDTH, LENGTH, WIDTH * LENGTH, 1.0, 0.0,
        0.1, np.eye(5), disparity, 0.05, 0.1,
    )  # fmt: skip


def test_stereo_measures_at_the_distance_it_measured() -> None:
    rig = make_rig(distortion=())
    s = check(sightings.from_stereo(measured(rig), PRIOR, rig))
    disparity = measured(rig).disparity_px
    assert s.depth_sigma == pytest.approx(math.hypot(0.05, 0.03) / disparity)
    assert sightings.shared_scale_sigma([measured(rig)]) == pytest.approx(0.1 / disparity)
    centred = StereoRig(rig.left, rig.right, rig.R_rc, rig.t_rc, rig.R_bc, np.zeros(3))
    check(sightings.from_stereo(measured(centred, 0.05), PRIOR, centred), 1.05)


def test_a_region_at_the_horizon_is_not_measured() -> None:
    rig = make_rig(distortion=(), pitch_deg=-10.0)
    flat = Prior(P_N, so3.from_euler(0.0, 0.0, 0.0), PRIOR.covariance)
    px = np.array([[300.0, 200.0], [300.0, 240.0], [340.0, 240.0], [340.0, 200.0]])
    far = Region(px, px, 1600.0, (0, 0, 1, 1), np.ones((1, 1), np.bool_), False, (1.0, 2.0, 3.0), 0.1, 1)
    assert sightings.from_one_camera(far, flat, rig, ROOF_D) is None
    assert sightings.from_one_camera(region(make_rig()), PRIOR, make_rig(), P_N[2] + 0.5) is None


def test_roofs_are_level() -> None:
    rig = make_rig()
    level = sightings.level(PRIOR, rig)
    np.testing.assert_allclose(so3.matrix(Q) @ rig.R_bc @ level.normal_c, [0.0, 0.0, -1.0], atol=1e-12)
    assert level.sigma_rad == pytest.approx(math.hypot(math.radians(1.0), math.radians(1.0)))
