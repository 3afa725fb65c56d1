"""The increment's Jacobians against differences on the manifold, and its conventions."""

import numpy as np
import pytest

from models import so3
from models.relative_pose import RelativePose, between, moved, pose_of
from models.state import E, NavState, local, retract

RNG = np.random.default_rng(5)
STEP = 1e-6


def _state(turn: float) -> np.ndarray:
    q = so3.quat_exp(turn * RNG.standard_normal(3))
    return NavState(RNG.normal(0, 5, 3), RNG.normal(0, 2, 3), q, RNG.normal(0, 0.01, 3), RNG.normal(0, 0.1, 3)).pack()


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1.0])
def test_jacobians_are_those_of_the_manifold(turn: float) -> None:
    x, origin = _state(turn), pose_of(_state(turn))
    step = between(origin, pose_of(_state(turn)))
    z = RelativePose(step[:3], step[3:], np.eye(6), np.arange(6), origin)
    _, h = z.evaluate(x, np.zeros(3))
    numeric = np.empty((6, E.SIZE))
    for k in range(E.SIZE):
        e = np.zeros(E.SIZE)
        e[k] = STEP
        numeric[:, k] = (z.evaluate(retract(x, -e), np.zeros(3))[0] - z.evaluate(retract(x, e), np.zeros(3))[0]) / (2 * STEP)
    np.testing.assert_allclose(h, numeric, atol=1e-7)
    numeric = np.empty((6, 6))
    for k in range(6):
        e = np.zeros(6)
        e[k] = STEP
        ahead, behind = z.since(moved(origin, e)[0]), z.since(moved(origin, -e)[0])
        numeric[:, k] = (behind.evaluate(x, np.zeros(3))[0] - ahead.evaluate(x, np.zeros(3))[0]) / (2 * STEP)
    np.testing.assert_allclose(z.by_origin(x), numeric, atol=1e-7)


def test_an_increment_leads_from_one_pose_to_the_next() -> None:
    x0, x1 = _state(1.0), _state(1.0)
    step = between(pose_of(x0), pose_of(x1))
    np.testing.assert_allclose(pose_of(x0)[:3] + so3.matrix(pose_of(x0)[3:]) @ step[:3], pose_of(x1)[:3])
    z = RelativePose(step[:3], step[3:], np.eye(6), np.arange(6), pose_of(x0))
    np.testing.assert_allclose(z.evaluate(x1, np.zeros(3))[0], 0.0, atol=1e-12)


def test_only_given_rows_are_seen() -> None:
    z = RelativePose(np.ones(3), np.array([1.0, 0, 0, 0]), np.eye(2), np.array([0, 5]), pose_of(_state(1.0)))
    nu, h = z.evaluate(_state(1.0), np.zeros(3))
    whole = RelativePose(z.dp_b, z.dq_wxyz, np.eye(6), np.arange(6), z.origin)
    assert nu.shape == (2,)
    assert h.shape == (2, E.SIZE)
    assert whole.by_origin(_state(1.0)).shape == (6, 6)


def test_a_kept_pose_moves_as_the_state_does() -> None:
    x, dx = _state(1.0), np.zeros(E.SIZE)
    dx[E.P], dx[E.THETA] = [1.0, 2.0, 3.0], [0.1, -0.2, 0.3]
    pose, _ = moved(pose_of(x), dx[np.r_[E.P, E.THETA]])
    np.testing.assert_allclose(pose, pose_of(retract(x, dx)), atol=1e-15)
    assert local(x, retract(x, dx)) == pytest.approx(dx, abs=1e-12)
