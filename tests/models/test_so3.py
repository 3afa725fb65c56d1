"""The laws of rotations, at identity, next to it, on both sides of every branch, at random, and close to half a turn."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from models import so3
from models.messages import Array


def _vectors() -> list[Array]:
    """Rotation vectors [rad]: identity, the tiny ones around each series' threshold, random ones, nearly half a turn."""
    rng = np.random.default_rng(1)
    lengths = [0.0, 1e-12, 1e-9, 0.99e-8, 1.01e-8, 0.99e-5, 1.01e-5, 1e-3, *rng.uniform(0.1, 3.0, 8), math.pi - 1e-3]
    return [length * _unit(rng) for length in lengths]


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _quaternions(seed: int, count: int) -> list[Array]:
    return [q / np.linalg.norm(q) for q in np.random.default_rng(seed).normal(size=(count, 4))]


def _scipy(q: Array) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


VECTORS = _vectors()
QUATERNIONS = [np.array([1.0, 0.0, 0.0, 0.0]), *(so3.quat_exp(r) for r in VECTORS[1:4]), *_quaternions(2, 6)]
EPS = 1e-14


@pytest.mark.parametrize("r", VECTORS)
def test_exp_agrees_with_the_matrix_exponential(r: Array) -> None:
    np.testing.assert_allclose(so3.matrix(so3.quat_exp(r)), expm(so3.skew(r)), rtol=0, atol=1e-13)


@pytest.mark.parametrize("r", VECTORS)
def test_exp_is_a_unit_quaternion(r: Array) -> None:
    assert abs(np.linalg.norm(so3.quat_exp(r)) - 1.0) < EPS


@pytest.mark.parametrize("r", VECTORS)
def test_log_undoes_exp(r: Array) -> None:
    np.testing.assert_allclose(so3.quat_log(so3.quat_exp(r)), r, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("q", QUATERNIONS)
def test_log_takes_the_shorter_way_whatever_the_sign(q: Array) -> None:
    r = so3.quat_log(q)
    assert np.linalg.norm(r) <= math.pi + EPS
    np.testing.assert_allclose(so3.quat_log(-q), r, rtol=0, atol=EPS)


def test_log_of_three_quarters_of_a_turn_is_a_quarter_backwards() -> None:
    np.testing.assert_allclose(
        so3.quat_log(so3.quat_exp(np.array([0.0, 0.0, 1.5 * math.pi]))), [0.0, 0.0, -0.5 * math.pi], atol=EPS
    )


@pytest.mark.parametrize("q", QUATERNIONS)
def test_matrix_is_a_rotation_and_agrees_with_scipy(q: Array) -> None:
    m = so3.matrix(q)
    np.testing.assert_allclose(m @ m.T, np.eye(3), rtol=0, atol=EPS)
    assert abs(np.linalg.det(m) - 1.0) < EPS
    np.testing.assert_allclose(m, _scipy(q).as_matrix(), rtol=0, atol=EPS)


@pytest.mark.parametrize(("p", "q"), list(zip(QUATERNIONS, _quaternions(3, len(QUATERNIONS)), strict=True)))
def test_product_of_quaternions_is_product_of_matrices(p: Array, q: Array) -> None:
    np.testing.assert_allclose(so3.matrix(so3.multiply(p, q)), so3.matrix(p) @ so3.matrix(q), rtol=0, atol=EPS)


@pytest.mark.parametrize("q", QUATERNIONS)
def test_conjugate_is_the_inverse_on_both_sides(q: Array) -> None:
    for product in (so3.multiply(q, so3.conjugate(q)), so3.multiply(so3.conjugate(q), q)):
        np.testing.assert_allclose(product, [1.0, 0.0, 0.0, 0.0], rtol=0, atol=EPS)


def test_product_follows_hamilton_not_jpl() -> None:
    i, j, k = np.eye(4)[1:]
    np.testing.assert_array_equal(so3.multiply(i, j), k)
    np.testing.assert_array_equal(so3.multiply(j, i), -k)


@pytest.mark.parametrize("r", VECTORS)
def test_turning_the_axis_turns_the_rotation(r: Array) -> None:
    """R exp(r) R^T = exp(R r): body errors become map errors by R_nb."""
    q = _quaternions(4, 1)[0]
    turned = so3.multiply(so3.multiply(q, so3.quat_exp(r)), so3.conjugate(q))
    np.testing.assert_allclose(turned, so3.quat_exp(so3.matrix(q) @ r), rtol=0, atol=EPS)


@pytest.mark.parametrize("q", QUATERNIONS)
def test_from_matrix_undoes_matrix_with_positive_w(q: Array) -> None:
    back = so3.from_matrix(so3.matrix(q))
    assert back[0] >= 0.0
    np.testing.assert_allclose(back, q if q[0] >= 0.0 else -q, rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.array([0.6, 0.8, 0.0]), np.array([0.0, -0.6, 0.8])])
@pytest.mark.parametrize("short_of_half_a_turn", [0.0, 1e-9, 0.3])
def test_from_matrix_is_exact_where_the_trace_is_negative(axis: Array, short_of_half_a_turn: float) -> None:
    m = so3.matrix(so3.quat_exp((math.pi - short_of_half_a_turn) * axis))
    np.testing.assert_allclose(so3.matrix(so3.from_matrix(m)), m, rtol=0, atol=EPS)


def test_skew_is_the_cross_product() -> None:
    v, w = np.random.default_rng(5).normal(size=(2, 3))
    np.testing.assert_allclose(so3.skew(v) @ w, np.cross(v, w), rtol=0, atol=EPS)
    np.testing.assert_array_equal(so3.skew(v), -so3.skew(v).T)


@pytest.mark.parametrize("r", VECTORS)
def test_right_jacobian_inverse_is_the_derivative_of_log(r: Array) -> None:
    """Columns: d/dd log(exp(r) exp(d)) at d = 0, by central differences."""
    h = 1e-4
    columns = [
        (
            so3.quat_log(so3.multiply(so3.quat_exp(r), so3.quat_exp(d)))
            - so3.quat_log(so3.multiply(so3.quat_exp(r), so3.quat_exp(-d)))
        )
        / (2.0 * h)
        for d in h * np.eye(3)
    ]
    np.testing.assert_allclose(so3.right_jacobian_inverse(r), np.column_stack(columns), rtol=0, atol=1e-7)


@pytest.mark.parametrize("r", VECTORS)
def test_right_jacobian_inverse_inverts_the_series(r: Array) -> None:
    """J_r(r) = sum_k (-[r]x)^k / (k + 1)!   (Sola 2017, eq. 183, as its power series)"""
    term, series = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ -so3.skew(r) / (k + 1)
        series = series + term
    np.testing.assert_allclose(so3.right_jacobian_inverse(r) @ series, np.eye(3), rtol=0, atol=2e-11)


def test_yaw_turns_the_nose_from_north_to_east_and_pitch_lifts_it() -> None:
    nose = np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(so3.matrix(so3.from_euler(0.0, 0.0, math.pi / 2)) @ nose, [0.0, 1.0, 0.0], atol=EPS)
    np.testing.assert_allclose(so3.matrix(so3.from_euler(0.0, math.pi / 2, 0.0)) @ nose, [0.0, 0.0, -1.0], atol=EPS)
    right = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(so3.matrix(so3.from_euler(math.pi / 2, 0.0, 0.0)) @ right, [0.0, 0.0, 1.0], atol=EPS)


@pytest.mark.parametrize("angles", np.random.default_rng(6).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (8, 3)))
def test_euler_angles_go_round_and_agree_with_scipy(angles: Array) -> None:
    roll, pitch, yaw = (float(a) for a in angles)
    q = so3.from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(so3.matrix(q), Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), rtol=0, atol=EPS)
    np.testing.assert_allclose(so3.to_euler(q), angles, rtol=0, atol=1e-12)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_euler_angles_are_finite_straight_up_and_down(pitch: float) -> None:
    roll, found, yaw = so3.to_euler(so3.from_euler(0.3, pitch, 0.7))
    assert math.isfinite(roll)
    assert math.isfinite(yaw)
    assert abs(found - pitch) < 1e-7


def test_products_are_those_of_matrices() -> None:
    a, b = np.random.default_rng(9).normal(size=(2, 3, 3))
    np.testing.assert_allclose(so3.product(a, b), a @ b, rtol=0, atol=1e-14)
    np.testing.assert_allclose(so3.applied(a, b[0]), a @ b[0], rtol=0, atol=1e-14)


def test_normalise_keeps_the_direction() -> None:
    q = np.array([3.0, 0.0, -4.0, 0.0])
    np.testing.assert_allclose(so3.normalise(q), [0.6, 0.0, -0.8, 0.0], rtol=0, atol=EPS)


@pytest.mark.parametrize("function", [so3.normalise, so3.conjugate, so3.quat_log, so3.matrix])
def test_arguments_are_left_as_they_were(function: object) -> None:
    assert callable(function)
    q = np.array([0.5, -0.5, 0.5, -0.5])
    function(q)
    np.testing.assert_array_equal(q, [0.5, -0.5, 0.5, -0.5])
