"""The wire: values against hand-made and rosbags' ones, bytes against rosbags, and what is no message."""

import struct
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from logs.wire import schemas
from logs.wire.codec import (
    SCHEMAS,
    Decoder,
    ImuMounting,
    Topics,
    decode_aid_status,
    decode_integrity,
    decode_odometry,
    decode_vision_request,
    encode,
    encode_input,
    encode_slow,
    encode_truth,
    is_own_transform,
    type_hash,
)
from logs.wire.schemas import STORE
from models import so3
from models.frames import ENU_FROM_NED, FLU_FROM_FRD, Origin
from models.messages import (
    AidStatus,
    Alert,
    Array,
    AttitudePrior,
    Estimate,
    GnssFix,
    GnssVelocity,
    Health,
    ImageName,
    ImuSample,
    Input,
    Integrity,
    LandmarkFix,
    LastGnss,
    Mode,
    OdometryDelta,
    OdometryPose,
    PoseFix,
    Quat,
    Reading,
    Reason,
    Reset,
    Tick,
    Unusable,
    Vec3,
    VisionReport,
    VisionRequest,
    vec3,
)
from models.state import E, X, retract

ALL = Topics(
    baro=("/baro",),
    magnetometer=("/mag",),
    heading=("/heading",),
    velocity_body=("/velocity_body",),
    range=("/range",),
    beacon=("/beacon/2",),
    airspeed=("/airspeed",),
    attitude=("/attitude",),
    odometry=("/odometry",),
)  # every input, the optional ones too
T_NS, ARRIVED_NS = 1_700_000_000_123_456_789, 1_700_000_000_200_000_000


def exact(got: Any, expected: Any) -> None:
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


def covariance(size: int, seed: int = 0) -> Array:
    a = np.random.default_rng(seed).standard_normal((size, size))
    return a @ a.T + np.eye(size)


def quaternion(seed: int) -> Quat:
    w, x, y, z = so3.normalise(np.random.default_rng(seed).standard_normal(4))
    return float(w), float(x), float(y), float(z)


def estimate(seed: int = 0, origin: Vec3 | None = None) -> Estimate:
    rng = np.random.default_rng(seed)
    nav = rng.standard_normal(X.SIZE) * 10
    nav[X.Q] = quaternion(seed)
    return Estimate(T_NS, ARRIVED_NS, nav, covariance(E.SIZE, seed), vec3(rng.standard_normal(3)), Mode.AIDED, 2, T_NS, origin)


def inputs() -> list[Input]:
    """One of each kind."""
    q, p = quaternion(1), (1.5, -2.5, 3.5)
    return [
        ImuSample(T_NS, ARRIVED_NS, (0.1, -0.2, 0.3), (1.0, 2.0, -9.8)),
        GnssFix(T_NS, ARRIVED_NS, 47.1, 8.2, 403.4, covariance(3), status=2),
        GnssFix(T_NS, ARRIVED_NS, 47.1, 8.2, 403.4, None, status=-1),
        GnssVelocity(T_NS, ARRIVED_NS, (1.0, -2.0, 0.5), covariance(3, 1)),
        GnssVelocity(T_NS, ARRIVED_NS, (1.0, -2.0, 0.5), None),
        PoseFix(T_NS, ARRIVED_NS, p, q, covariance(6)),
        LandmarkFix(
            T_NS,
            ARRIVED_NS,
            p,
            q,
            covariance(6),
            covariance(6, 2),
            ("roof 12", "Schwimmbecken ü", ""),
            0.81,
            0.4,
            np.arange(3 * 6 * 4, dtype=float).reshape(3, 6, 4),
            covariance(6, 5),
        ),
        LandmarkFix(T_NS, ARRIVED_NS, p, q, covariance(6), None, (), 0.75, 0.0),
        LandmarkFix(
            T_NS,
            ARRIVED_NS,
            p,
            q,
            covariance(6),
            None,
            ("a",),
            0.75,
            0.0,
            directions=covariance(6, 3)[:4],
            readings=np.arange(4.0),
        ),
        Reading(T_NS, ARRIVED_NS, "/baro", "baro", (95_321.5,), np.eye(1) * 4.0),
        OdometryDelta(T_NS, ARRIVED_NS, T_NS - 500_000_001, p, q, covariance(6), covariance(6, 7)[:, :2], epoch=3),
        OdometryDelta(T_NS, ARRIVED_NS, T_NS - 500_000_001, p, q, covariance(6)),
        OdometryPose(T_NS, ARRIVED_NS, p, q, "odom 2"),
        Reading(T_NS, ARRIVED_NS, "/mag", "magnetometer", (2e-5, -3e-6, 4e-5), 1e-14 * covariance(3)),
        Reading(T_NS, ARRIVED_NS, "/mag", "magnetometer", (2e-5, -3e-6, 4e-5)),
        Reading(T_NS, ARRIVED_NS, "/heading", "heading", (-2.5,), np.eye(1) * 4e-4),
        Reading(T_NS, ARRIVED_NS, "/heading", "heading", (3.0,)),
        Reading(T_NS, ARRIVED_NS, "/velocity_body", "velocity_body", (5.0, -0.1, 0.2), covariance(3)),
        Reading(T_NS, ARRIVED_NS, "/range", "range", (12.5,)),
        Reading(T_NS, ARRIVED_NS, "/beacon/2", "beacon", (42.25,)),
        Reading(T_NS, ARRIVED_NS, "/airspeed", "airspeed", (17.25,)),
        Reading(T_NS, ARRIVED_NS, "/airspeed", "airspeed", (17.25,), np.eye(1) * 0.25),
        AttitudePrior(T_NS, ARRIVED_NS, q, covariance(3)),
        Tick(T_NS, ARRIVED_NS),
    ]


def same(a: Any, b: Any) -> None:
    """Equal to 1e-12, the sign of a quaternion apart."""
    assert type(a) is type(b)
    if isinstance(a, msgspec.Struct):
        for name in a.__struct_fields__:
            x, y = getattr(a, name), getattr(b, name)
            if name in {"q_nb_wxyz", "q_ob_wxyz"} and np.dot(x, y) < 0:
                y = tuple(-np.array(y))
            same(x, y)
    elif isinstance(a, np.ndarray | float) or (isinstance(a, tuple) and a and isinstance(a[0], float)):
        exact(a, b)
    else:
        assert a == b


def ros(encoded: tuple[str, str, bytes]) -> Any:
    """The message as rosbags reads it."""
    return STORE.deserialize_cdr(encoded[2], encoded[1])


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def xyz(v: Any) -> Array:
    return np.array([v.x, v.y, v.z])


def rotation(q: Any) -> Rotation:
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


@pytest.mark.parametrize("one_eyed", [False, True])
def test_a_request_to_vision_comes_back_as_it_was(one_eyed: bool) -> None:
    left = None if one_eyed else ImageName("/left/image", T_NS - 3)
    request = VisionRequest(T_NS, ARRIVED_NS, (1.0, -2.0, 3.0), (0.5, -0.5, 0.5, 0.5), covariance(6), left, ImageName("/r", 7), 4)
    (message,) = encode(request)
    assert (message.topic, message.schema) == ("/landfix/vision_request", schemas.VISION_REQUEST)
    same(decode_vision_request(message.data, ARRIVED_NS), request)
    with pytest.raises(ValueError, match=r"."):
        decode_vision_request(message.data[:50], ARRIVED_NS)


# --- values on the wire -------------------------------------------------------------------------------------------------


def test_level_and_facing_north_is_a_quarter_turn_in_enu() -> None:
    # GIVEN a body at north 1, east 2, down 3, level and facing north, its errors known per axis
    fix = PoseFix(T_NS, ARRIVED_NS, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), np.diag([1.0, 4.0, 9.0, 0.1, 0.4, 0.9]))
    # WHEN it is written
    message = ros(encode_input(fix))
    # THEN map is east north up, and x forward points 90 degrees from east
    assert message.header.frame_id == "map"
    assert stamp_ns(message.header) == T_NS
    exact(xyz(message.pose.pose.position), [2.0, 1.0, -3.0])
    np.testing.assert_allclose(rotation(message.pose.pose.orientation).as_rotvec(), [0.0, 0.0, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(message.pose.covariance.reshape(6, 6), np.diag([4.0, 1.0, 9.0, 0.4, 0.1, 0.9]))


def test_gnss_axes() -> None:
    velocity = ros(encode_input(GnssVelocity(T_NS, ARRIVED_NS, (1.0, 2.0, 3.0), np.diag([1.0, 4.0, 9.0]))))
    np.testing.assert_allclose(xyz(velocity.twist.twist.linear), [2.0, 1.0, -3.0])
    np.testing.assert_allclose(np.diag(velocity.twist.covariance.reshape(6, 6)), [4.0, 1.0, 9.0, 0.0, 0.0, 0.0])
    cross = np.array([[1.0, 0.1, 0.2], [0.1, 4.0, 0.3], [0.2, 0.3, 9.0]])
    fix = ros(encode_input(GnssFix(T_NS, ARRIVED_NS, 47.0, 8.0, 400.0, cross)))
    np.testing.assert_allclose(fix.position_covariance.reshape(3, 3), [[4.0, 0.1, -0.3], [0.1, 1.0, -0.2], [-0.3, -0.2, 9.0]])
    assert fix.position_covariance_type == fix.COVARIANCE_TYPE_KNOWN


@pytest.mark.parametrize(
    ("mounting", "expected"),
    [
        (ImuMounting("frd"), (1.0, 2.0, 3.0)),
        (ImuMounting("flu"), (1.0, -2.0, -3.0)),
        (ImuMounting("frd", yaw_deg=90.0), (-2.0, 1.0, 3.0)),  # its x looks to the body's right
        (ImuMounting("flu", roll_deg=180.0), (1.0, 2.0, 3.0)),
        (ImuMounting("frd", pitch_deg=90.0), (3.0, 2.0, -1.0)),  # its x looks up
    ],
)
def test_imu_axes_and_mounting(mounting: ImuMounting, expected: Vec3) -> None:
    # GIVEN bytes whose numbers are 1 2 3, written for an IMU along the body's FRD axes
    data = encode_input(ImuSample(T_NS, ARRIVED_NS, (1.0, 2.0, 3.0), (10.0, 20.0, 30.0)), ImuMounting("frd")).data
    # WHEN they are read as those of an IMU that sits otherwise
    sample = Decoder(ALL, mounting).decode("/imu", schemas.IMU, data, ARRIVED_NS)
    # THEN the body's rates are the turned ones
    assert isinstance(sample, ImuSample)
    np.testing.assert_allclose(sample.gyro_b, expected, atol=1e-12)
    np.testing.assert_allclose(sample.accel_b, 10 * np.array(expected), atol=1e-11)


def test_what_is_not_given_stays_in_its_place() -> None:
    # GIVEN a fix on the wire with unknown east, up and yaw (NaN, huge, negative)
    wire = np.diag([np.nan, 2.0, 1e6, 0.1, 0.2, -1.0])
    wire[0, 3] = np.nan
    fix = PoseFix(T_NS, ARRIVED_NS, (np.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.zeros((6, 6)))
    message = ros(encode_input(fix))
    message.pose.covariance = wire.ravel()
    data = bytes(STORE.serialize_cdr(message, schemas.POSE_FIX))
    # WHEN it is read
    got = Decoder(ALL).decode("/pose_fix", schemas.POSE_FIX, data, ARRIVED_NS)
    # THEN they are unknown east, down and yaw, and nothing else has become unknown
    assert isinstance(got, PoseFix)
    expected = np.diag([2.0, np.nan, 1e6, 0.2, 0.1, -1.0])
    expected[1, 4] = np.nan
    np.testing.assert_array_equal(got.covariance, expected)
    assert np.isnan(got.p_n).tolist() == [True, False, False]


def test_directions_are_reported_in_map_axes() -> None:
    # GIVEN a fix that measured north with the turn about east, down, and the turn about down
    rows = np.zeros((3, 6))
    rows[0, [0, 4]], rows[1, 2], rows[2, 5] = (0.6, 40.0), 1.0, 50.0
    fix = LandmarkFix(T_NS, ARRIVED_NS, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6), None, (), 0.8, 0.3, directions=rows)
    message = ros(encode_input(fix))
    # THEN on the wire it is y with the turn about x, and z and the turn about z the other way round
    expected = np.zeros((3, 6))
    expected[0, [1, 3]], expected[1, 2], expected[2, 5] = (0.6, 40.0), -1.0, -50.0
    np.testing.assert_array_equal(message.directions.reshape(3, 6), expected)


def test_directions_of_no_whole_number_of_rows_are_no_fix() -> None:
    fix = LandmarkFix(T_NS, ARRIVED_NS, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6), None, (), 0.8, 0.3)
    message = ros(encode_input(fix))
    assert len(message.directions) == 0
    message.directions = np.ones(7)
    data = bytes(STORE.serialize_cdr(message, schemas.LANDMARK_FIX))
    assert isinstance(Decoder(ALL).decode("/landfix/fix", schemas.LANDMARK_FIX, data, ARRIVED_NS), Unusable)


def test_unknown_velocity_covariances() -> None:
    message = ros(encode_input(GnssVelocity(T_NS, ARRIVED_NS, (1.0, 2.0, 3.0), np.eye(3))))
    for first, known in ((-1.0, False), (1.0, True), (np.nan, True)):
        covariance36 = message.twist.covariance.copy()
        covariance36[0] = first
        message.twist.covariance = covariance36
        data = bytes(STORE.serialize_cdr(message, schemas.TWIST))
        got = Decoder(ALL).decode("/gnss/velocity", schemas.TWIST, data, ARRIVED_NS)
        assert isinstance(got, GnssVelocity)
        assert (got.covariance_n is not None) == known


# --- round trips --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("message", inputs(), ids=lambda m: type(m).__name__)
@pytest.mark.parametrize("mounting", [ImuMounting(), ImuMounting("frd", 3.0, -4.0, 130.0)], ids=["flu", "turned"])
def test_inputs_round_trip(message: Input, mounting: ImuMounting) -> None:
    encoded = encode_input(message, mounting)
    assert encoded.topic == message.topic
    got = Decoder(ALL, mounting).decode(*encoded, ARRIVED_NS)
    same(got, message)


finite = st.floats(-1e9, 1e9)
vectors = st.tuples(finite, finite, finite)
times = st.integers(0, 2**31 * 10**9 - 1)


@given(t_ns=times, gyro=vectors, accel=vectors)
def test_imu_round_trip_over_the_message_space(t_ns: int, gyro: Vec3, accel: Vec3) -> None:
    sample = ImuSample(t_ns, ARRIVED_NS, gyro, accel)
    same(Decoder(ALL).decode(*encode_input(sample), ARRIVED_NS), sample)


@given(t_ns=times, p_n=vectors, rates=st.tuples(finite, finite, finite, finite).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_pose_round_trip_over_the_message_space(t_ns: int, p_n: Vec3, rates: Quat) -> None:
    w, x, y, z = so3.normalise(np.array(rates))
    fix = PoseFix(t_ns, ARRIVED_NS, p_n, (float(w), float(x), float(y), float(z)), covariance(6))
    same(Decoder(ALL).decode(*encode_input(fix), ARRIVED_NS), fix)


def test_the_common_covariance_of_a_pose_fix_is_added() -> None:
    own, common = covariance(6), covariance(6, 1)
    fix = PoseFix(T_NS, ARRIVED_NS, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), own, common)
    got = Decoder(ALL).decode(*encode_input(fix), ARRIVED_NS)
    assert isinstance(got, PoseFix)
    exact(got.covariance, own + common)


def test_truth_round_trip() -> None:
    p_n, v_n, q = (1.0, 2.0, 3.0), (4.0, -5.0, 6.0), quaternion(3)
    encoded = encode_truth(T_NS, p_n, v_n, q)
    assert encoded[:2] == ("/truth", schemas.ODOMETRY)
    got = decode_odometry(encoded.data)
    assert got.t_ns == T_NS
    exact(got.p_n, p_n)
    exact(got.v_n, v_n)
    exact(so3.matrix(np.array(got.q_nb_wxyz)), so3.matrix(np.array(q)))
    assert not got.pose_covariance.any()


def test_an_unusable_message_cannot_be_written() -> None:
    with pytest.raises(ValueError, match="/x: a message that could not be read"):
        encode_input(Unusable(T_NS, ARRIVED_NS, "/x", "torn"))


# --- bytes against rosbags ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame_id", ["", "a", "imu", "base_link", "ö" * 7, *("x" * n for n in range(4, 21))])
@pytest.mark.parametrize("little_endian", [True, False])
def test_imu_with_any_frame_id_is_what_rosbags_reads(frame_id: str, little_endian: bool) -> None:
    rng = np.random.default_rng(len(frame_id))
    message = ros(encode_input(ImuSample(T_NS, ARRIVED_NS, vec3(rng.standard_normal(3)), vec3(rng.standard_normal(3)))))
    message.header.frame_id = frame_id
    message.orientation_covariance = rng.standard_normal(9)
    message.angular_velocity_covariance = rng.standard_normal(9)
    data = bytes(STORE.serialize_cdr(message, schemas.IMU, little_endian=little_endian))
    got = Decoder(ALL, ImuMounting("frd")).decode("/imu", schemas.IMU, data, ARRIVED_NS)
    assert isinstance(got, ImuSample)
    assert got.t_ns == T_NS
    assert got.arrived_ns == ARRIVED_NS
    assert got.gyro_b == tuple(xyz(message.angular_velocity))
    assert got.accel_b == tuple(xyz(message.linear_acceleration))


@pytest.mark.parametrize("seed", range(5))
def test_odometry_bytes_are_rosbags_bytes(seed: int) -> None:
    encoded = encode(estimate(seed))[0]
    again = bytes(STORE.serialize_cdr(ros(encoded), schemas.ODOMETRY))
    assert encoded.data == again


def test_odometry_pose_and_twist() -> None:
    output = estimate(4)
    message = ros(encode(output)[0])
    R_nb = Rotation.from_matrix(so3.matrix(output.nav[X.Q]))
    turn, flip = Rotation.from_matrix(ENU_FROM_NED), Rotation.from_matrix(FLU_FROM_FRD)
    assert (message.header.frame_id, message.child_frame_id, stamp_ns(message.header)) == ("map", "base_link", T_NS)
    exact(xyz(message.pose.pose.position), turn.apply(output.nav[X.P]))
    attitude = (turn * R_nb * flip).as_matrix()
    exact(rotation(message.pose.pose.orientation).as_matrix(), attitude)
    exact(xyz(message.twist.twist.linear), flip.apply(R_nb.inv().apply(output.nav[X.V])))
    exact(xyz(message.twist.twist.angular), flip.apply(output.gyro_b))


@pytest.mark.parametrize("seed", range(3))
def test_odometry_covariance_is_that_of_the_published_quantities(seed: int) -> None:
    """J P J^T, J by central differences of what a reader of the message sees."""
    output = estimate(seed)

    def seen(dx: Array) -> tuple[Array, Rotation, Array, Array]:
        nav = retract(output.nav, dx)
        gyro_b = vec3(np.array(output.gyro_b) - dx[E.BG])  # a larger bias is a smaller rate
        message = ros(encode(msgspec.structs.replace(output, nav=nav, gyro_b=gyro_b))[0])
        twist = message.twist.twist
        pose = message.pose.pose
        return xyz(pose.position), rotation(pose.orientation), xyz(twist.linear), xyz(twist.angular)

    step = 1e-5
    columns = []
    for i in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[i] = step
        p1, r1, v1, w1 = seen(dx)
        p0, r0, v0, w0 = seen(-dx)
        columns.append(np.concatenate([p1 - p0, (r1 * r0.inv()).as_rotvec(), v1 - v0, w1 - w0]) / (2 * step))
    jacobian = np.array(columns).T
    expected = jacobian @ output.covariance @ jacobian.T
    message = ros(encode(output)[0])
    got_pose, got_twist = message.pose.covariance.reshape(6, 6), message.twist.covariance.reshape(6, 6)
    np.testing.assert_allclose(got_pose, expected[:6, :6], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(got_twist, expected[6:, 6:], rtol=1e-6, atol=1e-4)
    for got in (got_pose, got_twist):
        np.testing.assert_array_equal(got, got.T)
        assert np.linalg.eigvalsh(got)[0] > 0


def test_odometry_reads_back_in_our_axes() -> None:
    output = estimate(5)
    got = decode_odometry(encode(output)[0].data)
    exact(got.p_n, output.nav[X.P])
    exact(got.v_n, output.nav[X.V])
    exact(got.gyro_b, output.gyro_b)
    exact(got.pose_covariance[:3, :3], output.covariance[E.P, E.P])
    R_nb = so3.matrix(output.nav[X.Q])
    np.testing.assert_allclose(got.pose_covariance[3:, 3:], R_nb @ output.covariance[E.THETA, E.THETA] @ R_nb.T, rtol=1e-12)
    exact(got.twist_covariance[3:, 3:], output.covariance[E.BG, E.BG])


# --- other outputs ------------------------------------------------------------------------------------------------------


def test_aid_status_round_trip() -> None:
    status = AidStatus(T_NS, ARRIVED_NS, "/gnss", "gnss", Reason.GATED, 3, (1.0, 2.0), (0.5, 0.25), 1.75, 0.1, 12, "far off")
    encoded = encode(status)[0]
    assert encoded[:2] == ("/landfix/aid_status", "landfix_msgs/msg/AidStatus")
    same(decode_aid_status(encoded.data), status)
    with pytest.raises(ValueError, match="AidStatus"):
        decode_aid_status(encoded.data[:40])


def test_integrity_round_trip() -> None:
    risks, levels = (1e-3, 1e-5, 1e-7), (1.0, 3.5, np.inf)
    integrity = Integrity(
        T_NS, ARRIVED_NS, Alert.CAUTION, "HPL 12 m", 1e-5, 12.0, 4.0, 10.0, np.inf, risks, levels, levels, 0.2, 0.3
    )
    encoded = encode(integrity)[0]
    assert encoded[:2] == ("/landfix/integrity", "landfix_msgs/msg/Integrity")
    same(decode_integrity(encoded.data, ARRIVED_NS), integrity)
    with pytest.raises(ValueError, match="string length"):
        decode_integrity(encoded.data[:40])


def test_health_reports_every_field() -> None:
    last = LastGnss(47.0, 8.0, 400.0, 12.5, 3.0)
    sources, counts = {"/imu": "active", "/gnss": "stopped"}, {"fused": 12, "gated": 1}
    health = Health(
        T_NS, ARRIVED_NS, Mode.COASTING, np.inf, 3.5, 0.2, 4, sources, counts, 1, last, "IMU silent", {"gyro_x": 0.001},
        weights={"IMU wrong": -4.4},
    )  # fmt: skip
    encoded = encode(health)[0]
    assert encoded[:2] == ("/landfix/health", "diagnostic_msgs/msg/DiagnosticArray")
    (status,) = ros(encoded).status
    assert (status.name, status.level, status.message) == ("landfix", status.ERROR, "coasting: IMU silent")
    values = {v.key: v.value for v in status.values}
    assert values["absolute_age_s"] == "inf"
    assert values["sources /gnss"] == "stopped"
    assert values["counts fused"] == "12"
    assert values["last_gnss age_s"] == "12.5"
    assert values["biases gyro_x"] == "0.001"
    assert values["weights IMU wrong"] == "-4.4"
    fields = set(health.__struct_fields__) - {"t_ns", "arrived_ns"}
    assert {key.split(" ")[0] for key in values} == fields
    levels = {mode: ros(encode(msgspec.structs.replace(health, mode=mode, last_gnss=None))[0]).status[0].level for mode in Mode}
    assert levels[Mode.AIDED] == status.OK
    assert levels[Mode.DEAD_RECKONING] == levels[Mode.ALIGNING] == levels[Mode.STARTING] == status.WARN


def test_reset_is_reported_in_map_axes() -> None:
    encoded = encode(Reset(T_NS, ARRIVED_NS, 2, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (0.1, 0.2, 0.3)))[0]
    message = ros(encoded)
    assert encoded[:2] == ("/landfix/reset", "landfix_msgs/msg/Reset")
    assert (message.counter, message.header.frame_id) == (2, "map")
    np.testing.assert_array_equal(xyz(message.delta_position), [2.0, 1.0, -3.0])
    np.testing.assert_array_equal(xyz(message.delta_velocity), [5.0, 4.0, -6.0])
    np.testing.assert_array_equal(xyz(message.delta_rotation), [0.2, 0.1, -0.3])


def test_vision_report_reports_every_field() -> None:
    report = VisionReport(T_NS, ARRIVED_NS, "ambiguous", "pool or court", 5, 2, ("pool", "court"), (0.97, 0.81), 0.31, 0.012)
    encoded = encode(report)[0]
    assert encoded[:2] == ("/landfix/vision", "landfix_msgs/msg/VisionReport")
    message = ros(encoded)
    assert (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec, message.header.frame_id) == (T_NS, "camera")
    for field in set(report.__struct_fields__) - {"t_ns", "arrived_ns", "similarities"}:
        value = getattr(message, field)
        assert (tuple(value) if isinstance(value, list) else value) == getattr(report, field), field
    np.testing.assert_array_equal(message.similarities, report.similarities)
    assert np.isnan(ros(encode(VisionReport(T_NS, ARRIVED_NS, "no_image"))[0]).residual_px)


def test_viewers_get_the_pose_of_the_odometry_and_the_place_on_earth() -> None:
    output = estimate(6, (47.0, 8.0, 400.0))
    odometry = ros(encode(output)[0]).pose
    pose, tf, place = (ros(e) for e in encode_slow(output))
    assert [e.topic for e in encode_slow(output)] == ["/landfix/pose", "/tf", "/landfix/global"]
    assert [e.topic for e in encode_slow(estimate(6))] == ["/landfix/pose", "/tf"]
    (transform,) = tf.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    for position, q in (
        (pose.pose.position, pose.pose.orientation),
        (transform.transform.translation, transform.transform.rotation),
    ):
        exact(xyz(position), xyz(odometry.pose.position))
        exact(rotation(q).as_matrix(), rotation(odometry.pose.orientation).as_matrix())
    back = Origin(47.0, 8.0, 400.0).to_ned(place.latitude, place.longitude, place.altitude)
    np.testing.assert_allclose(back, output.nav[X.P], atol=1e-6)
    exact(place.position_covariance.reshape(3, 3), odometry.covariance.reshape(6, 6)[:3, :3])


def test_our_own_transform_is_reported_from_others() -> None:
    tf = encode_slow(estimate())[1]
    assert is_own_transform(tf.data)
    message = ros(tf)
    (transform,) = message.transforms
    message.transforms = [transform, transform]
    assert not is_own_transform(bytes(STORE.serialize_cdr(message, schemas.TF)))
    transform.header.frame_id = "odom"
    message.transforms = [transform]
    assert not is_own_transform(bytes(STORE.serialize_cdr(message, schemas.TF)))
    assert not is_own_transform(tf.data[:50])


def test_hashes_and_schemas() -> None:
    # As published with ROS 2 (rmw_zenoh keys carry them).
    assert type_hash("nav_msgs/msg/Odometry") == "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    assert type_hash("sensor_msgs/msg/Imu") == "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
    with pytest.raises(KeyError):
        type_hash("no_such/msg/Type")
    for name, text in SCHEMAS.items():
        fresh = get_typestore(Stores.EMPTY)
        fresh.register(get_types_from_msg(text, name))
        assert fresh.hash_rihs01(name) == type_hash(name)


# --- what is no message -------------------------------------------------------------------------------------------------

ENCODED = [encode_input(message) for message in inputs()]


def flip(data: bytes, bit: int) -> bytes:
    damaged = bytearray(data)
    damaged[bit // 8 % len(data)] ^= 1 << bit % 8
    return bytes(damaged)


@given(index=st.integers(0, len(ENCODED) - 1), data=st.binary(max_size=600))
def test_random_bytes_never_raise(index: int, data: bytes) -> None:
    encoded = ENCODED[index]
    for start in (b"", encoded.data[:4], encoded.data[:16]):
        got = Decoder(ALL).decode(encoded.topic, encoded.schema, start + data, ARRIVED_NS)
        assert isinstance(got, Input)
        assert got.topic == encoded.topic
        assert got.arrived_ns == ARRIVED_NS


@given(index=st.integers(0, len(ENCODED) - 1), bits=st.lists(st.integers(0, 2**13), min_size=1, max_size=8))
def test_flipped_bits_never_raise(index: int, bits: list[int]) -> None:
    topic, schema, data = ENCODED[index]
    for bit in bits:
        data = flip(data, bit)
    assert isinstance(Decoder(ALL).decode(topic, schema, data, ARRIVED_NS), Input)


@pytest.mark.parametrize("encoded", ENCODED, ids=lambda e: e.topic)
def test_a_message_cut_anywhere_is_unusable(encoded: tuple[str, str, bytes]) -> None:
    topic, schema, data = encoded
    for size in range(len(data)):
        got = Decoder(ALL).decode(topic, schema, data[:size], ARRIVED_NS)
        assert isinstance(got, Unusable)
        assert (got.t_ns, got.arrived_ns, got.topic) == (ARRIVED_NS, ARRIVED_NS, topic)
        assert "\n" not in got.detail


@pytest.mark.parametrize("part", ["pose", "twist"])
def test_an_odometry_that_says_it_is_lost_gives_no_pose(part: str) -> None:
    """Without a pose RTAB-Map's quaternion is zero."""
    topic, schema, data = next(e for e in ENCODED if e[:2] == ("/odometry", schemas.ODOMETRY))
    for variances, is_lost in ((np.full(6, 9999.0), True), (np.array([0.1, 0.1, 1e6, 1e6, 1e6, 0.1]), False)):
        message: Any = schemas.STORE.deserialize_cdr(data, schema)
        getattr(message, part).covariance = np.diag(variances).ravel()
        for k, name in enumerate("xyzw"):
            setattr(message.pose.pose.orientation, name, 0.0 if is_lost else 0.5 * (-1.0) ** k)
        got = Decoder(ALL).decode(topic, schema, bytes(schemas.STORE.serialize_cdr(message, schema)), ARRIVED_NS)
        assert isinstance(got, OdometryPose)
        assert (got.t_ns, got.is_lost) == (T_NS, is_lost)
        again = Decoder(ALL).decode(*encode_input(got), ARRIVED_NS)
        assert isinstance(again, OdometryPose)
        assert again.is_lost == is_lost


def _isaac_status(state: int, stamp_ns: int) -> bytes:
    """VisualSlamStatus: header, uint8 vo_state, padding, four float64."""
    return struct.pack("<4siII4sB7x4d", b"\0\1\0\0", *divmod(stamp_ns, 10**9), 4, b"map\0", state, 0.02, 0.01, 0.01, 0.05)


@pytest.mark.parametrize(("state", "is_lost"), [(0, False), (1, False), (2, True), (3, True)])
def test_a_status_of_isaac_says_that_its_odometry_is_lost(state: int, is_lost: bool) -> None:
    topics = Topics(odometry=("/wheels", "/vo"), isaac_status=("/wheels/status", "/vo/status"))
    got = Decoder(topics).decode("/vo/status", schemas.ISAAC_STATUS, _isaac_status(state, T_NS), ARRIVED_NS)
    assert (got is not None) == is_lost
    if got is not None:
        assert isinstance(got, OdometryPose)
        assert (got.t_ns, got.arrived_ns, got.topic, got.is_lost) == (T_NS, ARRIVED_NS, "/vo", True)


@pytest.mark.parametrize("more", [b"", b"\3", b"\3\0", b"\3\0\0"], ids=len)
def test_a_status_of_zed_is_that_of_the_newest_pose_whatever_its_version_adds(more: bytes) -> None:
    decoder = Decoder(Topics(odometry=("/odometry",), zed_status=("/pose/status",)))

    def tell(state: bytes) -> Input | None:
        return decoder.decode("/pose/status", schemas.ZED_STATUS, b"\0\1\0\0" + state + more, ARRIVED_NS)

    assert tell(b"\1") is None  # no pose yet
    topic, schema, data = next(e for e in ENCODED if e.topic == "/odometry")
    assert decoder.decode(topic, schema, data, ARRIVED_NS) is not None
    assert tell(b"\0") is None
    for state in (b"\1", b"\2"):
        got = tell(state)
        assert isinstance(got, OdometryPose)
        assert (got.t_ns, got.topic, got.is_lost) == (T_NS, "/odometry", True)


def test_a_status_without_an_odometry_is_refused() -> None:
    with pytest.raises(ValueError, match=r"/status .* of no topic of odometry"):
        Decoder(Topics(zed_status=("/status",)))


def test_wrong_type_short_type_name_unknown_topic_and_nonsense_stamp() -> None:
    decode: Callable[..., Input | None] = Decoder(ALL).decode
    topic, schema, data = ENCODED[0]
    got = decode(topic, schemas.NAV_SAT_FIX, data, ARRIVED_NS)
    assert isinstance(got, Unusable)
    assert got.detail == "is sensor_msgs/msg/NavSatFix, not sensor_msgs/msg/Imu"
    assert isinstance(decode(topic, "sensor_msgs/Imu", data, ARRIVED_NS), ImuSample)
    assert decode("/elsewhere", schema, data, ARRIVED_NS) is None
    assert decode("/left/image", schemas.IMAGE, b"", ARRIVED_NS) is None
    bad_stamp = data[:8] + (2 * 10**9).to_bytes(4, "little") + data[12:]
    got = decode(topic, schema, bad_stamp, ARRIVED_NS)
    assert isinstance(got, Unusable)
    assert "nanosec" in got.detail


def test_topics_from_the_configuration() -> None:
    topics = Topics.of({"imu": "/a", "pose_fix": ["/b", "/c"]})
    assert topics.imu == ("/a",)
    assert topics.pose_fix == ("/b", "/c")
    assert topics.gnss == ("/gnss",)
    decoder = Decoder(topics)
    _, schema, data = encode_input(PoseFix(T_NS, ARRIVED_NS, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6)))
    got = decoder.decode("/c", schema, data, ARRIVED_NS)
    assert isinstance(got, PoseFix)
    assert got.topic == "/c"
    assert decoder.decode("/pose_fix", schema, data, ARRIVED_NS) is None
    with pytest.raises(ValueError, match=r"topic /gnss cannot feed two inputs"):
        Decoder(Topics.of({"imu": "/gnss"}))
