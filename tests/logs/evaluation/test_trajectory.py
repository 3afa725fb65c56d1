import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.evaluation.trajectory import Trajectory, decode, decode_geodetic, from_rows, interpolate, nearest
from logs.wire import schemas
from logs.wire.codec import Encoded, encode, encode_input, encode_truth
from models import so3
from models.frames import ENU_FROM_NED, FLU_FROM_FRD, Origin
from models.messages import Array, Estimate, GnssFix, Mode, PoseFix
from models.state import E, X

Q_NB = so3.from_euler(0.1, -0.2, 1.2)
R_MF = ENU_FROM_NED @ so3.matrix(Q_NB) @ FLU_FROM_FRD


def straight(t_ns: list[int]) -> Trajectory:
    """Constant velocity and turn rate: 1 m and 0.1 rad a tick."""
    t = np.array(t_ns, np.int64)
    rows = np.zeros((len(t), 85))
    rows[:, 0], rows[:, 3:7] = t, Rotation.from_rotvec(np.outer(t, [0.0, 0.0, 0.1])).as_quat()
    rows[:, 7:43], rows[:, 43] = np.eye(6).ravel() * 0.01 * t[:, None], 1.0
    return from_rows(t, t + 1, rows)


def rotation_of(q_wxyz: Array) -> Rotation:
    return Rotation.from_quat(q_wxyz, scalar_first=True)


def test_an_estimate_comes_back_as_it_was_sent() -> None:
    rng = np.random.default_rng(1)
    root = 0.1 * rng.normal(size=(15, 15))
    nav = np.zeros(X.SIZE)
    nav[X.P], nav[X.V], nav[X.Q] = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], Q_NB
    P = root @ root.T
    sent = encode(Estimate(1_700_000_000_123_456_789, 0, nav, P, (0.0, 0.0, 0.0), Mode.AIDED, 0, 0))[0]
    t = decode(sent.schema, [sent.data], [42])
    assert t.t_ns.tolist() == [1_700_000_000_123_456_789]
    assert t.arrived_ns.tolist() == [42]
    np.testing.assert_allclose(t.p[0], [2.0, 1.0, -3.0])
    np.testing.assert_allclose(rotation_of(t.q_wxyz).as_matrix()[0], R_MF, atol=1e-12)
    np.testing.assert_allclose(t.v[0], [5.0, 4.0, -6.0])
    np.testing.assert_allclose(t.covariance[0, :3, :3], ENU_FROM_NED @ P[E.P, E.P] @ ENU_FROM_NED.T, atol=1e-12)
    to_map = ENU_FROM_NED @ so3.matrix(Q_NB)
    np.testing.assert_allclose(t.covariance[0, 3:, 3:], to_map @ P[E.THETA, E.THETA] @ to_map.T, atol=1e-12)


def test_of_two_messages_with_one_stamp_the_first_counts() -> None:
    sent = [encode_truth(t, (x, 0.0, 0.0), (0.0, 0.0, 0.0), Q_NB) for t, x in [(30, 1.0), (10, 2.0), (30, 3.0), (10, 4.0)]]
    t = decode(schemas.ODOMETRY, [s.data for s in sent], [0, 1, 2, 3])
    assert t.t_ns.tolist() == [10, 30]
    assert t.p[:, 1].tolist() == [2.0, 1.0]
    assert t.arrived_ns.tolist() == [1, 0]


def test_truncated_messages_are_left_out() -> None:
    sent = encode_truth(10, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), Q_NB).data
    assert len(decode(schemas.ODOMETRY, [sent[:700], sent[:3], b"", sent], [0, 1, 2, 3])) == 1
    assert len(decode(schemas.ODOMETRY, [], [])) == 0


def test_a_truth_without_attitude_has_none() -> None:
    sent = encode_truth(10, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (np.nan, np.nan, np.nan, np.nan))
    t = decode(sent.schema, [sent.data], [0])
    assert t.p[0].tolist() == [2.0, 1.0, -3.0]
    assert not t.has_attitude[0]
    assert np.isnan(t.v).all()


@pytest.mark.parametrize(("variance", "given"), [(0.01, True), (10.0, False), (1e6, False)])
def test_an_attitude_with_a_huge_variance_is_not_given(variance: float, given: bool) -> None:
    covariance = np.diag([1.0, 1.0, 1.0, 0.01, 0.01, variance])
    sent = encode_input(PoseFix(10, 10, (1.0, 2.0, 3.0), tuple(Q_NB), covariance))
    t = decode(sent.schema, [sent.data], [0])
    assert bool(t.has_attitude[0]) is given
    assert t.covariance[0, 5, 5] == variance
    assert np.isnan(t.v_body).all()


def test_a_pose_alone_is_read_from_the_end_of_its_message() -> None:
    T = schemas.STORE.types
    header = T[schemas.HEADER](stamp=T["builtin_interfaces/msg/Time"](sec=1, nanosec=5), frame_id="some_odd_frame")
    pose = T["geometry_msgs/msg/Pose"](
        position=T["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
        orientation=T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=1.0, w=0.0),
    )
    message = T[schemas.POSE](header=header, pose=pose)
    for little in (True, False):
        data = bytes(schemas.STORE.serialize_cdr(message, schemas.POSE, little_endian=little))
        t = decode(schemas.POSE, [data], [0])
        assert (t.t_ns.tolist(), t.p.tolist(), t.q_wxyz.tolist()) == ([1_000_000_005], [[1.0, 2.0, 3.0]], [[0.0, 0.0, 0.0, 1.0]])


def test_geodetic_fixes_become_positions_on_the_map() -> None:
    origin = Origin(47.4, 8.5, 500.0)
    lla = origin.to_geodetic((100.0, 20.0, -30.0))
    covariance = np.diag([1.0, 4.0, 9.0])

    def sent(status: int, topic: str = "/gnss") -> Encoded:
        return encode_input(GnssFix(10 + status, 0, *lla, covariance, status, topic))

    t = decode_geodetic([sent(0).data, sent(-1).data, sent(2).data, b"torn"], [0, 1, 2, 3], origin)
    assert t.t_ns.tolist() == [10, 12]
    np.testing.assert_allclose(t.p, [[20.0, 100.0, 30.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(np.diagonal(t.covariance[0])[:3], [4.0, 1.0, 9.0])
    assert not t.has_attitude.any()


def test_nearest_is_exact_on_integer_nanoseconds() -> None:
    """GIVEN stamps of this epoch a nanosecond apart, which floats cannot tell, THEN the nearest is still right."""
    epoch = 1_700_000_000_000_000_000
    stamps = epoch + np.array([0, 10, 11, 500], np.int64)
    wanted = epoch + np.array([-3, 4, 5, 6, 10, 11, 255, 256, 503, 504], np.int64)
    row, near = nearest(stamps, wanted, 3)
    assert row.tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 3, 3]
    assert near.tolist() == [True, False, False, False, True, True, False, False, True, False]
    assert not nearest(np.empty(0, np.int64), wanted, 3)[1].any()


def test_interpolation_of_a_constant_motion_is_exact() -> None:
    at, inside = interpolate(straight([0, 10, 20]), np.array([0, 4, 10, 15, 20]), 10)
    assert inside.all()
    np.testing.assert_allclose(at.p[:, 0], [0, 4, 10, 15, 20], atol=1e-12)
    np.testing.assert_allclose(rotation_of(at.q_wxyz).as_euler("ZYX")[:, 0], [0.0, 0.4, 1.0, 1.5, 2.0], atol=1e-12)
    np.testing.assert_allclose(at.covariance[:, 2, 2], [0.0, 0.04, 0.1, 0.15, 0.2], atol=1e-12)
    np.testing.assert_allclose(at.v_body[:, 0], 1.0)
    assert at.arrived_ns.tolist() == [1, 11, 11, 21, 21]


def test_slerp_goes_the_short_way_round() -> None:
    t = straight([0, 10])
    flipped = Trajectory(t.t_ns, t.arrived_ns, t.p, t.q_wxyz * [[1.0], [-1.0]], t.v_body, t.covariance, t.v_covariance)
    at, _ = interpolate(flipped, np.array([5]), 10)
    np.testing.assert_allclose(rotation_of(at.q_wxyz).as_euler("ZYX")[0, 0], 0.5, atol=1e-12)


def test_positions_without_attitude_are_interpolated_too() -> None:
    t = np.array([0, 10], np.int64)
    at, inside = interpolate(from_rows(t, t, np.array([[0.0, 0.0, 0.0], [2.0, 4.0, 6.0]])), np.array([5]), 10)
    assert inside.all()
    assert at.p.tolist() == [[1.0, 2.0, 3.0]]
    assert not at.has_attitude.any()


def test_nothing_is_reported_outside_or_in_a_hole_but_at_its_edges() -> None:
    at, inside = interpolate(straight([10, 20, 50, 60]), np.array([5, 10, 15, 20, 35, 50, 55, 65]), 10)
    assert inside.tolist() == [False, True, True, True, False, True, True, False]
    np.testing.assert_allclose(at.p[:, 0], [10, 15, 20, 50, 55], atol=1e-12)
    assert not interpolate(straight([]), np.array([1, 2]), 10)[1].any()
    assert interpolate(straight([7]), np.array([7, 8]), 10)[1].tolist() == [True, False]


def test_a_twist_that_nobody_filled_in_is_no_velocity() -> None:
    t, rows = np.array([1, 2, 3]), np.zeros((3, 85))
    rows[:, 6] = 1.0
    assert (from_rows(t, t, rows.copy()).v_body == 0.0).all()  # at rest
    rows[:, 0] = 0.0, 2.0, 4.0
    assert np.isnan(from_rows(t, t, rows).v_body).all()
