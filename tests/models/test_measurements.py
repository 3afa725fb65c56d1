"""Every measurement model's Jacobian is its derivative on the manifold, and its innovation has the sign and axes it says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from models import so3
from models.measurements import (
    DIRECTION_SCALE,
    Heading,
    Height,
    Measurement,
    PartialPose,
    Pose,
    Position,
    Velocity,
    innovation_covariance,
    mahalanobis,
)
from models.messages import Array
from models.state import E, X, retract

GYRO = np.array([0.3, -0.7, 1.1])
LEVER = np.array([0.4, -0.2, 0.9])
ALL = np.arange(6)
ATTITUDE_ROWS = {"full": [3, 4, 5], "tilt": [3, 4], "yaw": [5], "none": []}


def _state(seed: int) -> Array:
    """A state far from the identity; pitch stays where a yaw exists."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=X.SIZE)
    x[X.Q] = so3.from_euler(rng.uniform(-3.0, 3.0), rng.uniform(-1.2, 1.2), rng.uniform(-3.1, 3.1))
    return x


def _identity() -> Array:
    x = np.zeros(X.SIZE)
    x[X.Q] = (1.0, 0.0, 0.0, 0.0)
    return x


STATES = {"identity": _identity(), "tiny": retract(_identity(), np.full(E.SIZE, 1e-9))}
STATES |= {f"random {seed}": _state(seed) for seed in range(4)}


def _noise(m: int) -> Array:
    a = np.random.default_rng(m).normal(size=(m, m))
    return a @ a.T + np.eye(m)


def _pose(x: Array, attitude: str, position: list[int]) -> Pose:
    rows = np.array([*position, *ATTITUDE_ROWS[attitude]])
    return Pose(x[X.P].copy(), x[X.Q].copy(), _noise(len(rows)), rows, attitude)


def _heading(x: Array, direction_b: Array) -> Heading:
    north, east, _ = so3.matrix(x[X.Q]) @ direction_b
    return Heading(direction_b, math.atan2(east, north), _noise(1))


def _models(x: Array) -> dict[str, Measurement]:
    """Every kind of measurement, reading exactly what the state x would give."""
    r, w = so3.matrix(x[X.Q]), GYRO - x[X.BG]
    models: dict[str, Measurement] = {
        "position": Position(x[X.P].copy(), _noise(3), np.arange(3), np.zeros(3)),
        "position with lever": Position(x[X.P] + r @ LEVER, _noise(3), np.arange(3), LEVER),
        "horizontal position with lever": Position(x[X.P] + r @ LEVER, _noise(2), np.arange(2), LEVER),
        "velocity": Velocity(x[X.V].copy(), _noise(3), np.zeros(3)),
        "velocity with lever": Velocity(x[X.V] + r @ np.cross(w, LEVER), _noise(3), LEVER),
        "heading": _heading(x, np.array([0.7, -0.4, 1.9])),
        "height": Height(-x[X.P][2], np.eye(1)),
    }
    for attitude in ATTITUDE_ROWS:
        models[f"pose, attitude {attitude}"] = _pose(x, attitude, [0, 1, 2])
        models[f"height and attitude {attitude}"] = _pose(x, attitude, [2])
    for attitude in ("full", "tilt", "yaw"):
        models[f"attitude {attitude} alone"] = _pose(x, attitude, [])
    for count in (1, 3, 5):
        models[f"{count} directions"] = PartialPose(
            x[X.P].copy(), x[X.Q].copy(), _directions(count), np.zeros(count), _noise(count)
        )
    return models


def _directions(r: int) -> Array:
    """(r, 6), orthonormal where a radian counts as RADIAN_M metres."""
    q, _ = np.linalg.qr(np.random.default_rng(r).normal(size=(6, r)))
    return np.asarray(q.T * DIRECTION_SCALE)


MODELS = list(_models(_identity()))


def _derivative(z: Measurement, x: Array) -> Array:
    """-d nu / d dx at dx = 0, by central differences on the manifold."""
    step = 1e-6
    columns = []
    for unit in np.eye(E.SIZE):
        ahead, _ = z.evaluate(retract(x, step * unit), GYRO)
        behind, _ = z.evaluate(retract(x, -step * unit), GYRO)
        columns.append((behind - ahead) / (2.0 * step))
    return np.array(columns).T


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("at", STATES)
def test_a_measurement_of_the_state_itself_has_no_innovation(model: str, at: str) -> None:
    x = STATES[at]
    z = _models(x)[model]
    nu, h = z.evaluate(x, GYRO)
    assert nu.shape == (len(z.rows),)
    assert h.shape == (len(z.rows), E.SIZE)
    assert z.noise.shape == (len(z.rows), len(z.rows))
    np.testing.assert_allclose(nu, 0.0, atol=1e-12)


@pytest.mark.parametrize("away", [0.0, 1e-9, 0.3])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("at", STATES)
def test_jacobian_is_the_derivative_on_the_manifold(model: str, at: str, away: float) -> None:
    x = STATES[at]
    seen_from = retract(x, away * np.random.default_rng(5).normal(size=E.SIZE))
    z = _models(x)[model]
    _, h = z.evaluate(seen_from, GYRO)
    np.testing.assert_allclose(h, _derivative(z, seen_from), atol=2e-8)


@pytest.mark.parametrize("model", MODELS)
def test_innovation_points_from_the_estimate_to_the_measurement(model: str) -> None:
    x = STATES["random 1"]
    dx = 1e-5 * np.random.default_rng(3).normal(size=E.SIZE)
    z = _models(retract(x, dx))[model]
    nu, h = z.evaluate(x, GYRO)
    np.testing.assert_allclose(nu, h @ dx, atol=1e-8)


def test_attitude_innovation_is_about_the_axes_of_n() -> None:
    x = STATES["random 2"]
    dtheta_n = np.array([0.3, -0.2, 0.5])
    measured = so3.multiply(so3.quat_exp(dtheta_n), x[X.Q])
    nu, _ = Pose(x[X.P], measured, np.eye(6), ALL).evaluate(x, GYRO)
    np.testing.assert_allclose(nu[3:], dtheta_n, atol=1e-12)


def test_either_sign_of_a_quaternion_is_the_same_attitude() -> None:
    x = STATES["random 0"]
    q = so3.multiply(so3.quat_exp(np.array([0.1, 0.2, 0.3])), x[X.Q])
    for attitude, rows in ATTITUDE_ROWS.items():
        given = np.array([0, 1, 2, *rows])
        nu, h = Pose(x[X.P], q, np.eye(len(given)), given, attitude).evaluate(x, GYRO)
        minus_nu, minus_h = Pose(x[X.P], -q, np.eye(len(given)), given, attitude).evaluate(x, GYRO)
        np.testing.assert_allclose(nu, minus_nu, atol=1e-15)
        np.testing.assert_allclose(h, minus_h, atol=1e-15)


def test_yaw_alone_wraps_at_south_and_ignores_roll_and_pitch() -> None:
    x = _identity()
    x[X.Q] = so3.from_euler(0.3, 0.2, math.radians(179.0))
    z = Pose(np.zeros(3), so3.from_euler(-0.5, 0.4, math.radians(-179.0)), np.eye(1), np.array([5]), "yaw")
    nu, _ = z.evaluate(x, GYRO)
    np.testing.assert_allclose(nu, [math.radians(2.0)], atol=1e-12)


def test_roll_and_pitch_alone_ignore_yaw() -> None:
    x = _identity()
    x[X.Q] = so3.from_euler(0.1, -0.2, 0.5)
    z = Pose(np.zeros(3), so3.from_euler(0.1, -0.2, 2.5), np.eye(2), np.array([3, 4]), "tilt")
    nu, h = z.evaluate(x, GYRO)
    np.testing.assert_allclose(nu, 0.0, atol=1e-12)
    turn_about_down = so3.matrix(x[X.Q]).T[:, 2]
    np.testing.assert_allclose(h[:, E.THETA] @ turn_about_down, 0.0, atol=1e-12)


@pytest.mark.parametrize("rows", [[0], [1, 2], [0, 2, 5], [2, 3, 4, 5]])
def test_only_given_components_have_a_row(rows: list[int]) -> None:
    x, given = STATES["random 3"], np.array(rows)
    q = so3.multiply(so3.quat_exp(np.array([0.1, 0.2, 0.3])), x[X.Q])
    whole_nu, whole_h = Pose(np.ones(3), q, np.eye(6), ALL).evaluate(x, GYRO)
    nu, h = Pose(np.ones(3), q, np.eye(len(rows)), given).evaluate(x, GYRO)
    np.testing.assert_array_equal(nu, whole_nu[given])
    np.testing.assert_array_equal(h, whole_h[given])


def test_directions_are_combinations_of_the_whole_pose() -> None:
    x = STATES["random 3"]
    q = so3.multiply(so3.quat_exp(np.array([0.1, 0.2, 0.3])), x[X.Q])
    whole_nu, whole_h = Pose(np.ones(3), q, np.eye(6), ALL).evaluate(x, GYRO)
    d = _directions(4)
    y = np.array([0.1, -0.2, 0.3, -0.4])
    nu, h = PartialPose(np.ones(3), q, d, y, np.eye(4)).evaluate(x, GYRO)
    np.testing.assert_allclose(nu, d @ whole_nu + y, atol=1e-12)
    np.testing.assert_allclose(h, d @ whole_h, atol=1e-12)


def _sees_point(x: Array, away: Array) -> PartialPose:
    """Where a point `away` from the vehicle is in body axes: -R^T (dp - [away]x dtheta)."""
    rows = np.hstack((np.eye(3), -so3.skew(away)))
    _, _, v = np.linalg.svd(rows / DIRECTION_SCALE, full_matrices=False)
    return PartialPose(x[X.P].copy(), x[X.Q].copy(), v * DIRECTION_SCALE, np.zeros(3), 1e-4 * np.eye(3))


@pytest.mark.parametrize("turn_rad", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bend_is_what_the_linear_model_leaves_out(turn_rad: float, axis: int) -> None:
    """A vehicle turned about a point 40 m away sees it where it was."""
    x, away = _identity(), np.array([12.0, -5.0, 38.0])
    z = _sees_point(x, away)
    turn = turn_rad * np.eye(3)[axis]
    there = x.copy()
    there[X.Q] = so3.quat_exp(turn)
    there[X.P] = x[X.P] + away - so3.matrix(there[X.Q]) @ away
    nu, h = z.evaluate(there, GYRO)
    known = 1e-10 * np.eye(E.SIZE)
    b = z.bend(there, known, nu, h, h @ known @ h.T + z.noise)
    assert np.linalg.norm(nu) > 0.2 * turn_rad**2 * np.linalg.norm(np.cross(np.eye(3)[axis], away))
    np.testing.assert_allclose(b, np.outer(nu, nu), atol=(0.02 + turn_rad**2) * float(nu @ nu))


def test_bend_covers_what_is_not_known() -> None:
    """Not the error but its uncertainty: attitude unknown to 0.2 rad, 40 m away."""
    x = _identity()
    z = _sees_point(x, np.array([0.0, 0.0, 40.0]))
    cov = np.diag([25.0] * 3 + [1.0] * 3 + [0.04] * 3 + [1e-4] * 6)
    nu, h = z.evaluate(x, GYRO)
    rng, left_out = np.random.default_rng(1), []
    for dx in rng.multivariate_normal(np.zeros(E.SIZE), cov, 4000):
        turned = so3.matrix(so3.quat_exp(dx[E.THETA]))
        there = retract(x, dx)
        there[X.P] = np.array([0.0, 0.0, 40.0]) - turned @ np.array([0.0, 0.0, 40.0])  # the same image
        left_out.append(z.evaluate(there, GYRO)[0])
    cov[E.P, E.P] *= 1e4  # position unknown, but what the reading and the attitude say of it
    expected = np.mean([np.outer(n, n) for n in left_out], axis=0)
    b = z.bend(x, cov, nu, h, h @ cov @ h.T + z.noise)
    np.testing.assert_allclose(b, expected, atol=0.1 * float(np.trace(expected)))


def test_what_contradicts_the_reading_hardly_bends() -> None:
    """100 m and 10 degrees off where it was measured, and sure of it: the gate must see that."""
    x = _identity()
    z = _sees_point(x, np.array([0.0, 0.0, 40.0]))
    there = x.copy()
    there[X.P], there[X.Q] = (60.0, 0.0, 80.0), so3.from_euler(math.radians(10.0), 0.0, 0.0)
    nu, h = z.evaluate(there, GYRO)
    known = 1e-6 * np.eye(E.SIZE)
    s = h @ known @ h.T + z.noise
    assert mahalanobis(nu, s + z.bend(there, known, nu, h, s))[0] > 60.0


def _random(m: int, n: int, seed: int) -> tuple[Array, Array, Array]:
    """P (n, n), H (m, n), R (m, m)."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    return a @ a.T, rng.normal(size=(m, n)), b @ b.T + np.eye(m)


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_innovation_covariance_is_that_of_the_textbook_and_exactly_symmetric(m: int) -> None:
    cov, h, noise = _random(m, E.SIZE, m)
    h[0, :3] = 0.0
    s, hp = innovation_covariance(cov, h, noise)
    np.testing.assert_allclose(s, h @ cov @ h.T + noise, rtol=1e-12)
    np.testing.assert_allclose(hp, h @ cov, atol=1e-12)
    np.testing.assert_array_equal(s, s.T)


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_mahalanobis_distance_and_determinant(m: int) -> None:
    _, _, s = _random(m, m, 10 + m)
    nu = np.random.default_rng(m).normal(size=m)
    distance2, logdet = mahalanobis(nu, s)
    assert distance2 == pytest.approx(nu @ np.linalg.solve(s, nu), rel=1e-12)
    assert logdet == pytest.approx(np.linalg.slogdet(s)[1], rel=1e-12)


@pytest.mark.parametrize(
    "s", [np.zeros((2, 2)), np.diag([1.0, -1.0]), np.array([[1.0, 2.0], [2.0, 1.0]]), np.full((2, 2), np.nan)]
)
def test_a_matrix_that_is_no_covariance_has_an_infinite_distance(s: NDArray[np.float64]) -> None:
    assert mahalanobis(np.ones(2), s) == (math.inf, math.inf)


def test_a_steep_heading_is_moved_by_a_turn_about_the_vertical_and_by_no_tilt() -> None:
    x = np.random.default_rng(1).normal(size=X.SIZE)
    x[X.Q] = so3.from_euler(0.2, -0.3, 1.0)
    steep = replace(_heading(x, np.array([0.7, -0.4, 1.9])), is_steep=True)
    down_b = so3.matrix(x[X.Q])[2]
    _, h = steep.evaluate(x, GYRO)
    assert h[0, E.THETA] @ down_b == pytest.approx(1.0)  # the azimuth turns with the vehicle
    np.testing.assert_allclose(np.cross(h[0, E.THETA], down_b), 0.0, atol=1e-12)
