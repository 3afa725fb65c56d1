"""Wire to records: messages of configured topics, in NED / FRD."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Self, TypeAlias

import msgspec
import numpy as np

from logs.wire import axes, cdr_fast, schemas
from logs.wire.axes import ImuMounting
from logs.wire.schemas import LOST_VARIANCE, STORE
from logs.wire.sensors import SENSORS, Sensor, SensorTopics
from models import so3
from models.messages import (
    ATTITUDE_TOPIC,
    ODOMETRY_DELTA_TOPIC,
    AidStatus,
    Array,
    AttitudePrior,
    Checkpoint,
    GnssFix,
    GnssVelocity,
    ImageName,
    ImuSample,
    Input,
    LandmarkFix,
    LastGnss,
    OdometryDelta,
    OdometryPose,
    OdometryRequest,
    PoseFix,
    Quat,
    Reading,
    Reason,
    ReceiverState,
    Tick,
    Unusable,
    Vec3,
    VisionRequest,
    vec3,
)
from models.state import E
from models.untrusted.toml_text import one_line

LANDMARK_FIX_TOPIC: Final = "/landfix/fix"
CHECKPOINT_TOPIC: Final = "/landfix/checkpoint"
TICK_TOPIC: Final = "/landfix/tick"  # a std_msgs/msg/Header: its stamp is the time

_COVARIANCE_UNKNOWN: Final = 0  # sensor_msgs/msg/NavSatFix
_STATES: Final = {state.value: state for state in ReceiverState}  # all bits of service set (15) is none of them
_SECOND_NS: Final = 1_000_000_000
_LOST_STATES: Final = {  # of an odometry's status: field, and where there is no pose
    schemas.ISAAC_STATUS: ("vo_state", {2, 3}),  # failed, refuted by the IMU
    schemas.ZED_STATUS: ("odometry_status", {1, 2}),  # unavailable, too few features
}


class Topics(SensorTopics, frozen=True):
    """Topics of each input; optional sensors: SensorTopics."""

    imu: tuple[str, ...] = ("/imu",)
    gnss: tuple[str, ...] = ("/gnss",)
    gnss_velocity: tuple[str, ...] = ("/gnss/velocity",)
    odometry: tuple[str, ...] = ()  # off until configured
    isaac_status: tuple[str, ...] = ()
    zed_status: tuple[str, ...] = ()
    odometry_delta: tuple[str, ...] = ()
    optical_flow: tuple[str, ...] = ()
    attitude: tuple[str, ...] = (ATTITUDE_TOPIC,)
    pose_fix: tuple[str, ...] = ("/pose_fix",)
    left_image: tuple[str, ...] = ("/left/image",)
    right_image: tuple[str, ...] = ("/right/image",)

    @classmethod
    def of(cls, inputs: Mapping[str, str | Sequence[str]]) -> Self:
        """From [inputs]: a topic or list each, defaults elsewhere."""
        return cls(**{name: (given,) if isinstance(given, str) else tuple(given) for name, given in inputs.items()})


class Odometry(msgspec.Struct, frozen=True, eq=False):
    """nav_msgs/msg/Odometry: pose, velocity in n, rate in b; covariances (6, 6) along n and b."""

    t_ns: int
    p_n: Vec3
    v_n: Vec3
    q_nb_wxyz: Quat
    gyro_b: Vec3
    pose_covariance: Array
    twist_covariance: Array


_Convert: TypeAlias = Callable[[str, Any, int], Input | None]


class Decoder:
    """Messages to inputs. Raises ValueError where a topic feeds two inputs, or a status is of no odometry."""

    def __init__(self, topics: Topics | None = None, mounting: ImuMounting | None = None) -> None:
        topics, mounting = topics or Topics(), mounting or ImuMounting()
        mountings = {topic: mounting.of(topic) for topic in topics.imu}
        self._turned = {topic: each.matrix() for topic, each in mountings.items() if each.is_turned}
        self._yz_sign = -1.0 if mounting.axes == "flu" else 1.0
        self._known: dict[str, tuple[str, _Convert]] = {}
        self._newest_ns: dict[str, int] = {}  # stamp of each odometry's newest pose
        self._route(topics.imu, schemas.IMU, self._general_imu)
        self._route(topics.gnss, schemas.NAV_SAT_FIX, _gnss)
        self._route(topics.gnss_velocity, schemas.TWIST, _gnss_velocity)
        for kind, sensor in SENSORS.items():
            self._route(getattr(topics, kind), sensor.schema, partial(_reading, kind, sensor))
        self._route(topics.odometry, schemas.ODOMETRY, self._odometry_pose)
        for schema, statuses in ((schemas.ISAAC_STATUS, topics.isaac_status), (schemas.ZED_STATUS, topics.zed_status)):
            if len(statuses) > len(topics.odometry):
                raise ValueError(f"{statuses[-1]} ({schema}) is the status of no topic of odometry")
            for status, of in zip(statuses, topics.odometry, strict=False):
                self._route((status,), schema, partial(self._tracking, of, *_LOST_STATES[schema]))
        increments = ODOMETRY_DELTA_TOPIC, *topics.odometry_delta, *topics.optical_flow
        self._route(increments, schemas.ODOMETRY_DELTA, _odometry_delta)
        self._route(topics.attitude, schemas.POSE_FIX, _attitude)
        self._route(topics.pose_fix, schemas.POSE_FIX, _pose_fix)
        self._route((LANDMARK_FIX_TOPIC,), schemas.LANDMARK_FIX, _landmark_fix)
        self._route((TICK_TOPIC,), schemas.HEADER, _tick)
        self._route((CHECKPOINT_TOPIC,), schemas.CHECKPOINT, _checkpoint)

    def decode(self, topic: str, schema: str, data: bytes, arrived_ns: int) -> Input | None:
        """The input; None for a topic that feeds none; Unusable for torn or foreign bytes. Never raises."""
        known = self._known.get(topic)
        if known is None:
            return None
        expected, convert = known
        if schema != expected and schema.replace("/", "/msg/", 1) != expected:
            return Unusable(arrived_ns, arrived_ns, topic, f"is {schema}, not {expected}")
        try:
            if convert == self._general_imu and (fast := cdr_fast.imu(data)) is not None:
                return self._imu(topic, arrived_ns, *fast)
            return convert(topic, STORE.deserialize_cdr(data, expected), arrived_ns)
        except Exception as error:  # bytes from outside: whatever they trip over, the flight goes on
            return Unusable(arrived_ns, arrived_ns, topic, f"{type(error).__name__}: {error}")

    @property
    def types(self) -> dict[str, str]:
        """topic -> type of all inputs."""
        return {topic: schema for topic, (schema, _) in self._known.items()}

    def _route(self, topics: tuple[str, ...], schema: str, convert: _Convert) -> None:
        for topic in topics:
            if topic in self._known:
                raise ValueError(f"topic {topic} cannot feed two inputs ({self._known[topic][0]} and {schema})")
            self._known[topic] = schema, convert

    def _imu(self, topic: str, arrived_ns: int, t_ns: int, gyro: Vec3, accel: Vec3) -> ImuSample:
        if (turned := self._turned.get(topic)) is not None:
            return ImuSample(t_ns, arrived_ns, vec3(turned @ gyro), vec3(turned @ accel), topic)
        s = self._yz_sign
        gyro_b, accel_b = (gyro[0], s * gyro[1], s * gyro[2]), (accel[0], s * accel[1], s * accel[2])
        return ImuSample(t_ns, arrived_ns, gyro_b, accel_b, topic)

    def _general_imu(self, topic: str, message: Any, arrived_ns: int) -> ImuSample:
        gyro, accel = _vector(message.angular_velocity), _vector(message.linear_acceleration)
        return self._imu(topic, arrived_ns, _t_ns(message.header.stamp), gyro, accel)

    def _odometry_pose(self, topic: str, message: Any, arrived_ns: int) -> OdometryPose:
        """The pose; its covariance is of all its past, the velocity redundant. All variances of either that large: it is lost."""
        is_lost = any(given.covariance.reshape(6, 6).diagonal().min() >= LOST_VARIANCE for given in (message.pose, message.twist))
        p_o, q_ob_wxyz, _ = _pose(message.pose)
        t_ns = self._newest_ns[topic] = _t_ns(message.header.stamp)
        return OdometryPose(t_ns, arrived_ns, p_o, q_ob_wxyz, one_line(message.header.frame_id), topic, is_lost)

    def _tracking(self, of: str, field: str, lost: set[int], _: str, message: Any, arrived_ns: int) -> OdometryPose | None:
        """Odometry `of` is lost at the status' time, or where it has none at that of the newest pose; else None."""
        t_ns = _t_ns(message.header.stamp) if hasattr(message, "header") else self._newest_ns.get(of)
        if t_ns is None or getattr(message, field) not in lost:
            return None
        return OdometryPose(t_ns, arrived_ns, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), topic=of, is_lost=True)


def decode_odometry(data: bytes) -> Odometry:
    """Our output or a truth in NED / FRD. Raises ValueError."""
    message = _deserialize(data, schemas.ODOMETRY)
    p_n, q_nb_wxyz, pose_covariance = _pose(message.pose)
    v_b = axes.body(_vector(message.twist.twist.linear))
    return Odometry(
        t_ns=_t_ns(message.header.stamp),
        p_n=p_n,
        v_n=vec3(so3.matrix(np.array(q_nb_wxyz)) @ v_b),
        q_nb_wxyz=q_nb_wxyz,
        gyro_b=axes.body(_vector(message.twist.twist.angular)),
        pose_covariance=pose_covariance,
        twist_covariance=axes.body_covariance(message.twist.covariance.reshape(6, 6)),
    )


def decode_aid_status(data: bytes) -> AidStatus:
    """Our /landfix/aid_status. Raises ValueError."""
    message = _deserialize(data, schemas.AID_STATUS)
    return AidStatus(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=_t_ns(message.arrived),
        topic=one_line(message.topic),
        kind=one_line(message.kind),
        reason=Reason(message.reason),
        revision=message.revision,
        innovation=tuple(message.innovation.tolist()),
        innovation_sigma=tuple(message.innovation_sigma.tolist()),
        test_ratio=message.test_ratio,
        delay_s=message.delay_s,
        replayed=message.replayed,
        detail=one_line(message.detail),
    )


def decode_diagnostics(data: bytes) -> dict[str, str]:
    """Keys and values of a DiagnosticArray. Raises ValueError."""
    message = _deserialize(data, schemas.DIAGNOSTICS)
    return {one_line(pair.key): one_line(pair.value) for status in message.status for pair in status.values}


def decode_vision_request(data: bytes, arrived_ns: int) -> VisionRequest:
    """Read back. Raises ValueError."""
    message = _deserialize(data, schemas.VISION_REQUEST)
    p_n, q_nb_wxyz, covariance = _pose(message.pose)
    named = ((message.left_topic, message.left_stamp), (message.right_topic, message.right_stamp))
    left, right = (ImageName(topic, _t_ns(stamp)) if topic else None for topic, stamp in named)
    return VisionRequest(_t_ns(message.header.stamp), arrived_ns, p_n, q_nb_wxyz, covariance, left, right, int(message.run))


def decode_odometry_request(data: bytes, arrived_ns: int) -> OdometryRequest:
    """Read back. Raises ValueError."""
    message = _deserialize(data, schemas.ODOMETRY_REQUEST)
    if not len(message.topics) == len(message.stamps) == 4:
        raise ValueError(f"an odometry request of {len(message.topics)} topics and {len(message.stamps)} stamps, not of four")
    motion = _odometry_motion(message)
    names = [ImageName(t, _t_ns(s)) if t else None for t, s in zip(message.topics, message.stamps, strict=True)]
    return OdometryRequest(
        _t_ns(message.header.stamp), arrived_ns, *motion, (names[0], names[1]), (names[2], names[3]),
        axes.body(_vector(message.down)), float(message.height), float(message.height_sigma),
    )  # fmt: skip


def is_own_transform(data: bytes) -> bool:
    """Whether a /tf message is ours: map -> base_link alone."""
    try:
        (transform,) = _deserialize(data, schemas.TF).transforms
    except ValueError:  # no TFMessage, or not of one transform
        return False
    return (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")


def _deserialize(data: bytes, schema: str) -> Any:
    try:
        return STORE.deserialize_cdr(data, schema)
    except Exception as error:  # whatever bytes from outside trip over, they are not of this type
        raise ValueError(str(error)) from error


def _gnss(topic: str, message: Any, arrived_ns: int) -> GnssFix:
    known = message.position_covariance_type != _COVARIANCE_UNKNOWN
    return GnssFix(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=arrived_ns,
        lat_deg=message.latitude,
        lon_deg=message.longitude,
        alt_m=message.altitude,
        covariance_n=axes.world_covariance(message.position_covariance.reshape(3, 3)) if known else None,
        status=message.status.status,
        topic=topic,
        state=_STATES.get(message.status.service >> 12, ReceiverState.UNKNOWN),
    )


def _gnss_velocity(topic: str, message: Any, arrived_ns: int) -> GnssVelocity:
    """A covariance all zero, or with -1 first (REP-145), is not given."""
    covariance = message.twist.covariance.reshape(6, 6)[:3, :3]
    known = covariance.any() and covariance[0, 0] != -1.0
    return GnssVelocity(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=arrived_ns,
        v_n=axes.world(_vector(message.twist.twist.linear)),
        covariance_n=axes.world_covariance(covariance) if known else None,
        topic=topic,
    )


def _reading(kind: str, sensor: Sensor, topic: str, message: Any, arrived_ns: int) -> Reading:
    return Reading(_t_ns(message.header.stamp), arrived_ns, topic, kind, *sensor.values(message))


def _odometry_motion(message: Any) -> tuple[int, Vec3, Quat, Array]:
    q = message.motion.pose.orientation
    covariance = axes.body_covariance(message.motion.covariance.reshape(6, 6))
    dq_wxyz = axes.body_attitude((q.w, q.x, q.y, q.z))
    return _t_ns(message.begin), axes.body(_vector(message.motion.pose.position)), dq_wxyz, covariance


def _odometry_delta(topic: str, message: Any, arrived_ns: int) -> OdometryDelta:
    t0_ns, dp_b, dq_wxyz, covariance = _odometry_motion(message)
    systematic = message.systematic
    return OdometryDelta(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=arrived_ns,
        t0_ns=t0_ns,
        dp_b=dp_b,
        dq_wxyz=dq_wxyz,
        covariance=covariance,
        systematic=axes.body_rows(systematic.reshape(6, -1)) if len(systematic) else None,
        epoch=message.epoch,
        topic=topic,
    )


def _attitude(topic: str, message: Any, arrived_ns: int) -> AttitudePrior:
    _, q_nb_wxyz, covariance = _pose(message.pose)
    return AttitudePrior(_t_ns(message.header.stamp), arrived_ns, q_nb_wxyz, covariance[3:, 3:], topic)


def _pose_fix(topic: str, message: Any, arrived_ns: int) -> PoseFix:
    p_n, q_nb_wxyz, covariance = _pose(message.pose)
    return PoseFix(_t_ns(message.header.stamp), arrived_ns, p_n, q_nb_wxyz, covariance, topic=topic)


def _landmark_fix(topic: str, message: Any, arrived_ns: int) -> LandmarkFix:
    p_n, q_nb_wxyz, covariance = _pose(message.pose)
    common, rig = message.covariance_common.reshape(6, 6), message.covariance_rig.reshape(6, 6)
    errors, names, directions = message.landmark_errors, tuple(map(one_line, message.landmarks)), message.directions
    return LandmarkFix(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=arrived_ns,
        p_n=p_n,
        q_nb_wxyz=q_nb_wxyz,
        covariance=covariance,
        covariance_common=axes.world_covariance(common) if common.any() else None,
        landmarks=names,
        similarity=message.similarity,
        residual_px=message.residual_px,
        landmark_errors=axes.world_rows(errors.reshape(len(names), 6, -1)) if len(errors) and names else None,
        covariance_rig=axes.world_covariance(rig) if rig.any() else None,
        directions=axes.world_columns(directions.reshape(-1, 6)) if len(directions) else None,
        readings=message.readings if len(message.readings) else None,
        topic=topic,
    )


def _tick(topic: str, message: Any, arrived_ns: int) -> Tick:
    return Tick(_t_ns(message.stamp), arrived_ns, topic)


def _checkpoint(topic: str, message: Any, arrived_ns: int) -> Checkpoint:
    return Checkpoint(
        t_ns=_t_ns(message.header.stamp),
        arrived_ns=arrived_ns,
        nav=message.nav,
        covariance=message.covariance.reshape(E.SIZE, E.SIZE),
        last_absolute_ns=message.last_absolute_ns,
        reset_counter=message.reset_counter,
        origin=vec3(message.origin) if len(message.origin) else None,
        last_gnss=LastGnss(*message.last_gnss.tolist()) if len(message.last_gnss) else None,
        topic=topic,
    )


def _pose(message: Any) -> tuple[Vec3, Quat, Array]:
    q = message.pose.orientation
    covariance = axes.world_covariance(message.covariance.reshape(6, 6))
    return axes.world(_vector(message.pose.position)), axes.attitude((q.w, q.x, q.y, q.z)), covariance


def _vector(message: Any) -> Vec3:
    return message.x, message.y, message.z


def _t_ns(stamp: Any) -> int:
    if stamp.nanosec >= _SECOND_NS:
        raise ValueError(f"stamp.nanosec = {stamp.nanosec} is a second or more")
    return int(stamp.sec * _SECOND_NS + stamp.nanosec)
