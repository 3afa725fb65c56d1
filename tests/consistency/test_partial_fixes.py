"""Is a filter consistent that fuses fixes in part? One landmark point, seen from afar, leaves the attitude open; and the truth
bends.

Vision is played by its own equations: the joint optimum of prior and image, linearised and reported there. The image is where
the point is in body axes, which is exactly the same from every place on a sphere about it.
"""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import innovation
from estimator.sources.base.aid import Aid
from estimator.sources.landmark import landmark_aid
from estimator.sources.pose import LandmarkFixConfig
from models import so3
from models.imu import Coast, ImuNoise, constants
from models.measurements import PartialPose
from models.messages import Array, LandmarkFix, vec3
from models.state import E, X, local, retract
from tests import long
from tests.estimator.partial import not_measured, orthonormal, point_rows

POINT = np.array([10.0, -4.0, 0.0])
TRUE_P = np.array([0.0, 0.0, -40.0])
SIGMA_M = 0.1
RUNS = 400
CONSTANTS = constants(ImuNoise(), Coast(), None)
ALONE = LandmarkFixConfig(lasting_share=0.0)


class Prior(NamedTuple):
    x: Array
    cov: Array


def _prior(truth: Array, sigma_m: float, sigma_rad: float, rng: np.random.Generator) -> Prior:
    cov = np.diag([sigma_m**2] * 3 + [1.0] * 3 + [sigma_rad**2] * 3 + [1e-4] * 6)
    return Prior(retract(truth, -np.sqrt(np.diag(cov)) * rng.standard_normal(E.SIZE)), cov)


def _seen(x: Array) -> Array:
    """The point in body axes."""
    return np.asarray(so3.matrix(x[X.Q]).T @ (POINT - x[X.P]))


def _look(z_b: Array, prior: Prior) -> LandmarkFix:
    """What vision reports of a point seen at z_b: Gauss-Newton on prior and image, then the image alone."""
    x, information = prior.x.copy(), np.linalg.inv(prior.cov)
    for _ in range(20):
        R = so3.matrix(x[X.Q])
        rows = -R.T @ point_rows(POINT - x[X.P])  # d seen / d (dp, dtheta_n)
        h = np.zeros((3, E.SIZE))
        h[:, E.P], h[:, E.THETA] = rows[:, :3], rows[:, 3:] @ R
        gradient = h.T @ (z_b - _seen(x)) / SIGMA_M**2 + information @ local(x, prior.x)
        x = retract(x, np.asarray(np.linalg.solve(information + h.T @ h / SIGMA_M**2, gradient), dtype=np.float64))
    rows = -so3.matrix(x[X.Q]).T @ point_rows(POINT - x[X.P])
    directions = orthonormal(rows)
    there = np.linalg.pinv(directions)
    through = rows @ there
    readings: Array = np.asarray(np.linalg.solve(through, z_b - _seen(x)), dtype=np.float64)
    noise = SIGMA_M**2 * np.linalg.inv(through.T @ through)
    wide = not_measured(directions)
    w, qx, qy, qz = x[X.Q].tolist()
    covariance = there @ noise @ there.T + 1e4 * wide.T @ wide
    return LandmarkFix(
        0, 0, vec3(x[X.P]), (w, qx, qy, qz), covariance, None, ("a",), 0.9, 0.3, directions=directions, readings=readings
    )  # fmt: skip


def _fuse(fix: LandmarkFix, prior: Prior, *, bends: bool = True) -> Eskf:
    aid = landmark_aid(fix, ALONE)
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert isinstance(z, PartialPose)
    eskf = Eskf(0, prior.x.copy(), prior.cov.copy(), CONSTANTS)
    seen = innovation(eskf, aid, z, np.zeros(3))
    eskf.update(seen if bends else replace(seen, noise=z.noise))  # the control takes the linear model for the truth
    return eskf


def _distance2(found: Eskf, truth: Array, rows: Array) -> float:
    """Squared Mahalanobis distance of `rows` (k, 6) of the pose's error (dp, dtheta_n), over k."""
    e, R = local(found.x, truth), so3.matrix(found.x[X.Q])
    to_pose = np.zeros((6, E.SIZE))
    to_pose[:3, E.P], to_pose[3:, E.THETA] = np.eye(3), R
    e, cov = rows @ to_pose @ e, rows @ to_pose @ found.cov @ to_pose.T @ rows.T
    return float(e @ np.linalg.solve(cov, e)) / len(rows)


def _runs(sigma_m: float, sigma_rad: float, later: bool = False, bends: bool = True) -> Array:
    """(RUNS, 2) of the whole pose and of what was measured. later: the filter has another prior than vision had."""
    result = []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        truth = np.zeros(X.SIZE)
        truth[X.P], truth[X.Q] = TRUE_P, so3.quat_exp(rng.normal(0.0, 0.2, 3))
        asked = _prior(truth, sigma_m, sigma_rad, rng)
        prior = _prior(truth, sigma_m, sigma_rad, rng) if later else asked
        fix = _look(_seen(truth) + SIGMA_M * rng.standard_normal(3), asked)
        assert fix.directions is not None
        found = _fuse(fix, prior, bends=bends)
        result.append((_distance2(found, truth, np.eye(6)), _distance2(found, truth, fix.directions)))
    return np.array(result)


@long.parametrize("later", [False, True])
def test_a_point_is_fused_consistently_where_the_attitude_is_known(later: bool) -> None:
    """Attitude 1 degree, position 3 m: the bend is below a centimetre. 99.9 % bands of 2400 and 1200 degrees of freedom."""
    pose, measured = _runs(3.0, np.radians(1.0), later).mean(axis=0)
    assert 0.90 < pose < 1.10
    assert 0.86 < measured < 1.14


@long.parametrize("later", [False, True])
def test_a_point_is_fused_consistently_where_the_attitude_is_not(later: bool) -> None:
    """Attitude 10 degrees: the sphere about the point bends by 0.6 m where 0.1 m is measured."""
    bent, flat = _runs(3.0, np.radians(10.0), later), _runs(3.0, np.radians(10.0), later, bends=False)
    assert flat[:, 1].mean() > 3.0
    assert 0.1 < bent[:, 1].mean() < 1.3
    assert bent[:, 0].mean() < 1.3
    assert np.mean(3.0 * bent[:, 1] < 7.81) > 0.92  # the tail of a square is longer than that of a Gaussian: 95 % there


def test_a_late_fix_whose_prior_has_moved_claims_less() -> None:
    """By a turn of 20 degrees about the point, which this fix cannot see: it was linearised elsewhere."""
    truth = np.zeros(X.SIZE)
    truth[X.P], truth[X.Q] = TRUE_P, (1.0, 0.0, 0.0, 0.0)
    asked = Prior(truth, np.diag([1.0] * 6 + [1e-4] * 3 + [1e-4] * 6))
    fix = _look(_seen(truth), asked)
    turned = truth.copy()
    turned[X.Q] = so3.from_euler(0.0, np.radians(20.0), 0.0)
    turned[X.P] = POINT - so3.matrix(turned[X.Q]) @ (POINT - TRUE_P)
    now, moved = _fuse(fix, asked), _fuse(fix, Prior(turned, asked.cov))
    sure, less = (np.sqrt(np.diag(f.cov)[E.P].sum()) for f in (now, moved))
    assert less > 1.7 * sure
    assert np.linalg.norm(moved.x[X.P] - turned[X.P]) < 2.5  # and so does not pull: the image is the same from there
