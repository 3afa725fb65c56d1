"""Foreign axes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.importers import frames
from logs.store.reader import LogError
from models import so3


def test_letters_say_where_x_y_and_z_point() -> None:
    np.testing.assert_array_equal(frames.body_axes("frd"), np.eye(3))
    np.testing.assert_array_equal(frames.body_axes("flu"), np.diag([1, -1, -1]))
    up = frames.body_axes("urf") @ [1.0, 0.0, 0.0]  # EuRoC: x points up
    np.testing.assert_array_equal(up, [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(frames.world_axes("enu") @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0])
    np.testing.assert_array_equal(frames.world_axes("nwu") @ [1.0, 2.0, 3.0], [1.0, -2.0, -3.0])


@pytest.mark.parametrize(
    ("letters", "reason"),
    [
        ("frd1", "expected three letters"),
        ("fr", "expected three"),
        ("ned", "expected three"),
        ("ffd", "twice"),
        ("fld", "left-handed"),
    ],
)
def test_letters_that_make_no_axes_are_refused(letters: str, reason: str) -> None:
    with pytest.raises(LogError, match=f"--axes {letters}: .*{reason}"):
        frames.body_axes(letters)


def test_a_component_that_is_not_given_does_not_spoil_the_others() -> None:
    v = np.array([[1.0, np.nan, np.inf], [1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(frames.turned(v, frames.body_axes("urf")), [[np.inf, np.nan, -1.0], [3.0, 2.0, -1.0]])


def test_attitude_changes_both_of_its_frames() -> None:
    """R_nb = W R B^T, as matrices."""
    q = np.random.default_rng(5).standard_normal((20, 4))
    W, B = frames.world_axes("enu"), frames.body_axes("urf")
    expected = W @ Rotation.from_quat(q, scalar_first=True).as_matrix() @ B.T
    got = Rotation.from_quat(frames.attitude(q, W, B), scalar_first=True).as_matrix()
    np.testing.assert_allclose(got, expected, atol=1e-14)


def test_an_attitude_that_is_not_given_stays_so() -> None:
    q = frames.attitude(np.array([[np.nan] * 4, [0.0] * 4, [2.0, 0.0, 0.0, 0.0]]), np.eye(3), np.eye(3))
    assert np.isnan(q[:2]).all()
    np.testing.assert_array_equal(q[2], [1.0, 0.0, 0.0, 0.0])


def test_euler_angles_agree_with_so3() -> None:
    angles = np.random.default_rng(6).uniform(-3.0, 3.0, (50, 3))
    expected = [so3.from_euler(*row) for row in angles.tolist()]
    np.testing.assert_allclose(frames.attitude_from_euler(*angles.T), expected, atol=1e-15)


def test_attitude_between_two_known_ones() -> None:
    known_ns = np.array([0, 100, 1000], dtype=np.int64)
    turns = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02], [0.0, 0.0, 0.5]])
    q_known = np.array([so3.quat_exp(r) for r in turns])
    q_known[1] *= -1.0  # the same attitude
    q = frames.attitude_at(np.array([-1, 0, 25, 100, 500, 1001], dtype=np.int64), known_ns, q_known, 500)
    assert np.isnan(q[[0, 4, 5]]).all()  # before, in a gap, after
    angles = [so3.quat_log(row)[2] for row in q[1:4]]
    np.testing.assert_allclose(angles, [0.0, 0.005, 0.02], atol=1e-7)
