"""Records to wire: outputs, and simulated or imported inputs."""

from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from logs.wire import axes, cdr_fast, integrity, schemas
from logs.wire.axes import ImuMounting
from logs.wire.schemas import LOST_VARIANCE, STORE
from logs.wire.sensors import SENSORS
from models.frames import Origin
from models.messages import (
    AidStatus,
    Array,
    AttitudePrior,
    Checkpoint,
    Estimate,
    GnssFix,
    GnssVelocity,
    Health,
    ImageName,
    ImuSample,
    Input,
    Integrity,
    LandmarkFix,
    Mode,
    OdometryDelta,
    OdometryPose,
    OdometryRequest,
    Output,
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
from models.state import E, X

VISION_REQUEST_TOPIC: Final = "/landfix/vision_request"
ODOMETRY_REQUEST_TOPIC: Final = "/landfix/odometry_request"

_MAP: Final = "map"
_BODY: Final = "base_link"
_BODY_FRD: Final = "base_link_frd"
_COVARIANCE_UNKNOWN, _COVARIANCE_KNOWN = 0, 3  # sensor_msgs/msg/NavSatFix
_NOT_GIVEN_M2: Final = 1e6
_OK, _WARN, _ERROR = 0, 1, 2  # diagnostic_msgs/msg/DiagnosticStatus
_LEVEL: Final = {
    Mode.STARTING: _WARN,
    Mode.ALIGNING: _WARN,
    Mode.ALIGNING_HEADING: _WARN,
    Mode.AIDED: _OK,
    Mode.ODOMETRY: _WARN,
    Mode.DEAD_RECKONING: _WARN,
    Mode.COASTING: _ERROR,
}


class Encoded(NamedTuple):
    """A message ready to be sent or logged."""

    topic: str
    schema: str
    data: bytes


def encode(output: Output) -> list[Encoded]:
    """The estimator's outputs, on its fixed topics."""
    if isinstance(output, Estimate):
        values = cdr_fast.odometry_values(output.nav, output.covariance, *output.gyro_b)
        return [Encoded("/landfix/odometry", schemas.ODOMETRY, cdr_fast.odometry(output.t_ns, values))]
    if isinstance(output, AidStatus):
        return [packed("/landfix/aid_status", schemas.AID_STATUS, **_aid_status(output))]
    if isinstance(output, Health):
        return [packed("/landfix/health", schemas.DIAGNOSTICS, header=header_of(output.t_ns, ""), status=[_diagnostic(output)])]
    if isinstance(output, Integrity):
        header = header_of(output.t_ns, _MAP)
        return [packed(integrity.INTEGRITY_TOPIC, schemas.INTEGRITY, header=header, **integrity.fields(output))]
    if isinstance(output, VisionReport):
        return [packed("/landfix/vision", schemas.VISION_REPORT, **_vision_report(output))]
    if isinstance(output, VisionRequest):
        return [packed(VISION_REQUEST_TOPIC, schemas.VISION_REQUEST, **_vision_request(output))]
    if isinstance(output, OdometryRequest):
        return [packed(ODOMETRY_REQUEST_TOPIC, schemas.ODOMETRY_REQUEST, **_odometry_request(output))]
    return [packed("/landfix/reset", schemas.RESET, **_reset(output))]


def encode_slow(estimate: Estimate) -> list[Encoded]:
    """For viewers: PoseStamped, TF, and NavSatFix with an origin; at most 30 Hz, by the caller."""
    p_n, q = vec3(estimate.nav[X.P]), estimate.nav[X.Q]
    if origin := Origin.of(estimate.origin):
        lla = origin.to_geodetic(p_n)
        slow = [_nav_sat_fix("/landfix/global", estimate.t_ns, _BODY, lla, estimate.covariance[E.P, E.P], 0)]
    else:
        slow = []
    if estimate.mode is Mode.ALIGNING_HEADING:  # these two types cannot say that the heading is unknown
        return slow
    header = header_of(estimate.t_ns, _MAP)
    pose = _pose(p_n, (float(q[0]), float(q[1]), float(q[2]), float(q[3])))
    stamped = _transform(header, _BODY, axes.world(p_n), pose.orientation)
    return [
        packed("/landfix/pose", schemas.POSE, header=header, pose=pose),
        packed("/tf", schemas.TF, transforms=[stamped]),
        *slow,
    ]


def static_transform(t_ns: int, child: str, translation: Vec3, q_wxyz: Quat) -> Any:
    """TransformStamped base_link -> child, FLU or the child's axes."""
    return _transform(header_of(t_ns, _BODY), child, translation, _quaternion(q_wxyz))


def encode_truth(t_ns: int, p_n: Array | Vec3, v_n: Array | Vec3, q_nb_wxyz: Array | Quat) -> Encoded:
    """True pose and velocity on /truth, zero covariances; never read by the estimator."""
    nav = np.zeros(X.SIZE)
    nav[X.P], nav[X.V], nav[X.Q] = p_n, v_n, q_nb_wxyz
    values = cdr_fast.odometry_values(nav, np.zeros((E.SIZE, E.SIZE)), 0.0, 0.0, 0.0)
    return Encoded("/truth", schemas.ODOMETRY, cdr_fast.odometry(t_ns, values))


def encode_input(message: Input, mounting: ImuMounting | None = None) -> Encoded:
    """A measurement as its sensor sends it. Raises ValueError."""
    match message:
        case ImuSample():
            return packed(message.topic, schemas.IMU, **_imu(message, (mounting or ImuMounting()).of(message.topic)))
        case GnssFix():
            lla = message.lat_deg, message.lon_deg, message.alt_m
            return _nav_sat_fix(message.topic, message.t_ns, "gnss", lla, message.covariance_n, message.status, message.state)
        case GnssVelocity():
            return packed(message.topic, schemas.TWIST, **_gnss_velocity(message))
        case PoseFix():
            common = message.covariance_common
            total = message.covariance if common is None else message.covariance + common
            pose = _pose_with_covariance(message.p_n, message.q_nb_wxyz, total)
            return packed(message.topic, schemas.POSE_FIX, header=header_of(message.t_ns, _MAP), pose=pose)
        case LandmarkFix():
            return packed(message.topic, schemas.LANDMARK_FIX, **_landmark_fix(message))
        case Reading():
            sensor = SENSORS[message.kind]
            return packed(message.topic, sensor.schema, header=header_of(message.t_ns, _BODY), **sensor.fields(message))
        case OdometryDelta():
            return packed(message.topic, schemas.ODOMETRY_DELTA, **_odometry_delta(message))
        case OdometryPose():
            return packed(message.topic, schemas.ODOMETRY, **_odometry_pose(message))
        case AttitudePrior():
            covariance = np.diag([_NOT_GIVEN_M2] * 3 + [0.0] * 3)
            covariance[3:, 3:] = message.covariance
            pose = _pose_with_covariance((0.0, 0.0, 0.0), message.q_nb_wxyz, covariance)
            return packed(message.topic, schemas.POSE_FIX, header=header_of(message.t_ns, _MAP), pose=pose)
        case Tick():
            return packed(message.topic, schemas.HEADER, stamp=_time(message.t_ns), frame_id="")
        case Checkpoint():
            return packed(message.topic, schemas.CHECKPOINT, **_checkpoint(message))
        case Unusable():
            raise ValueError(f"{message.topic}: a message that could not be read ({message.detail}) cannot be written")


def _aid_status(status: AidStatus) -> dict[str, Any]:
    return {
        "header": header_of(status.t_ns, ""),
        "arrived": _time(status.arrived_ns),
        "topic": status.topic,
        "kind": status.kind,
        "reason": str(status.reason),
        "revision": status.revision,
        "innovation": np.array(status.innovation, dtype=np.float64),
        "innovation_sigma": np.array(status.innovation_sigma, dtype=np.float64),
        "test_ratio": status.test_ratio,
        "delay_s": status.delay_s,
        "replayed": status.replayed,
        "detail": status.detail,
    }


def _diagnostic(health: Health) -> Any:
    values: list[Any] = []
    for field, value in msgspec.structs.asdict(health).items():
        if field in {"t_ns", "arrived_ns"}:
            continue  # the stamp says it
        entries = msgspec.structs.asdict(value) if isinstance(value, msgspec.Struct) else value
        pairs = {f"{field} {key}": entry for key, entry in entries.items()} if isinstance(entries, dict) else {field: entries}
        values += [_new("diagnostic_msgs/msg/KeyValue", key=key, value=str(entry)) for key, entry in pairs.items()]
    message = f"{health.mode}: {health.detail}" if health.detail else str(health.mode)
    return _new(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_ERROR if health.counts.get(Reason.INTERNAL) else _LEVEL[health.mode],
        name="landfix",
        message=message,
        hardware_id="",
        values=values,
    )


def _reset(reset: Reset) -> dict[str, Any]:
    return {
        "header": header_of(reset.t_ns, _MAP),
        "counter": reset.counter,
        "delta_position": _vector(axes.world(reset.delta_p_n)),
        "delta_velocity": _vector(axes.world(reset.delta_v_n)),
        "delta_rotation": _vector(axes.world(reset.delta_theta_n)),
    }


def _vision_report(report: VisionReport) -> dict[str, Any]:
    return {
        "header": header_of(report.t_ns, "camera"),
        "outcome": report.outcome,
        "detail": report.detail,
        "regions": report.regions,
        "candidates": report.candidates,
        "landmarks": list(report.landmarks),
        "similarities": np.array(report.similarities, dtype=np.float64),
        "residual_px": report.residual_px,
        "processing_s": report.processing_s,
    }


def _vision_request(request: VisionRequest) -> dict[str, Any]:
    left, right = request.left or ImageName("", 0), request.right or ImageName("", 0)
    return {
        "header": header_of(request.t_ns, _MAP),
        "pose": _pose_with_covariance(request.p_n, request.q_nb_wxyz, request.covariance),
        "left_topic": left.topic,
        "left_stamp": _time(left.t_ns),
        "right_topic": right.topic,
        "right_stamp": _time(right.t_ns),
        "run": request.run,
    }


def _imu(sample: ImuSample, mounting: ImuMounting) -> dict[str, Any]:
    """No orientation: -1 (sensor_msgs/msg/Imu)."""
    not_measured = np.zeros(9)
    not_measured[0] = -1.0
    R_ib = mounting.matrix().T
    with np.errstate(invalid="ignore"):  # infinity is sent as it came: the estimator refuses it with the reason
        gyro, accel = vec3(R_ib @ sample.gyro_b), vec3(R_ib @ sample.accel_b)
    return {
        "header": header_of(sample.t_ns, _BODY if mounting.axes == "flu" else _BODY_FRD),
        "orientation": _quaternion((1.0, 0.0, 0.0, 0.0)),
        "orientation_covariance": not_measured,
        "angular_velocity": _vector(gyro),
        "angular_velocity_covariance": np.zeros(9),
        "linear_acceleration": _vector(accel),
        "linear_acceleration_covariance": np.zeros(9),
    }


def _gnss_velocity(velocity: GnssVelocity) -> dict[str, Any]:
    covariance = np.zeros((6, 6))
    if velocity.covariance_n is not None:
        covariance[:3, :3] = axes.world_covariance(velocity.covariance_n)
    twist = _new("geometry_msgs/msg/Twist", linear=_vector(axes.world(velocity.v_n)), angular=_vector((0.0, 0.0, 0.0)))
    with_covariance = _new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel())
    return {"header": header_of(velocity.t_ns, _MAP), "twist": with_covariance}


def _landmark_fix(fix: LandmarkFix) -> dict[str, Any]:
    common = np.zeros((6, 6)) if fix.covariance_common is None else axes.world_covariance(fix.covariance_common)
    return {
        "header": header_of(fix.t_ns, _MAP),
        "pose": _pose_with_covariance(fix.p_n, fix.q_nb_wxyz, fix.covariance),
        "covariance_common": common.ravel(),
        "landmarks": list(fix.landmarks),
        "similarity": fix.similarity,
        "residual_px": fix.residual_px,
        "landmark_errors": np.zeros(0) if fix.landmark_errors is None else axes.world_rows(fix.landmark_errors).ravel(),
        "covariance_rig": (np.zeros((6, 6)) if fix.covariance_rig is None else axes.world_covariance(fix.covariance_rig)).ravel(),
        "directions": np.zeros(0) if fix.directions is None else axes.world_columns(fix.directions).ravel(),
        "readings": np.zeros(0) if fix.readings is None else fix.readings,
    }


def _motion(message: OdometryDelta | OdometryRequest) -> dict[str, Any]:
    p, q = axes.body(message.dp_b), axes.body_attitude(message.dq_wxyz)
    position = _new("geometry_msgs/msg/Point", x=p[0], y=p[1], z=p[2])
    pose = _new("geometry_msgs/msg/Pose", position=position, orientation=_quaternion(q))
    covariance = axes.body_covariance(message.covariance).ravel()
    return {
        "header": header_of(message.t_ns, _BODY),
        "begin": _time(message.t0_ns),
        "motion": _new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
    }


def _odometry_request(request: OdometryRequest) -> dict[str, Any]:
    names = [name or ImageName("", 0) for name in (*request.first, *request.second)]
    return {
        **_motion(request),
        "topics": [name.topic for name in names],
        "stamps": [_time(name.t_ns) for name in names],
        "down": _vector(axes.body(request.down_b)),
        "height": request.height_m,
        "height_sigma": request.height_sigma_m,
    }


def _odometry_delta(delta: OdometryDelta) -> dict[str, Any]:
    return {
        **_motion(delta),
        "systematic": np.zeros(0) if delta.systematic is None else axes.body_rows(delta.systematic).ravel(),
        "epoch": delta.epoch,
    }


def _odometry_pose(reading: OdometryPose) -> dict[str, Any]:
    """Without velocity and covariance (useless for differences); lost: as RTAB-Map says it."""
    covariance = np.diag([LOST_VARIANCE * reading.is_lost] * 6)
    twist = _new("geometry_msgs/msg/Twist", linear=_vector((0.0, 0.0, 0.0)), angular=_vector((0.0, 0.0, 0.0)))
    return {
        "header": header_of(reading.t_ns, reading.frame),
        "child_frame_id": _BODY,
        "pose": _pose_with_covariance(reading.p_o, reading.q_ob_wxyz, covariance),
        "twist": _new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    }


def _checkpoint(checkpoint: Checkpoint) -> dict[str, Any]:
    return {
        "header": header_of(checkpoint.t_ns, _MAP),
        "nav": checkpoint.nav,
        "covariance": checkpoint.covariance.ravel(),
        "last_absolute_ns": checkpoint.last_absolute_ns,
        "reset_counter": checkpoint.reset_counter,
        "origin": np.array(checkpoint.origin or (), dtype=np.float64),
        "last_gnss": np.array(msgspec.structs.astuple(checkpoint.last_gnss) if checkpoint.last_gnss else (), dtype=np.float64),
    }


def _nav_sat_fix(
    topic: str, t_ns: int, frame: str, lla: Vec3, covariance_n: Array | None, status: int, state: int = 0
) -> Encoded:
    """state: ReceiverState, in service's top four bits."""
    covariance = np.zeros((3, 3)) if covariance_n is None else axes.world_covariance(covariance_n)
    return packed(
        topic,
        schemas.NAV_SAT_FIX,
        header=header_of(t_ns, frame),
        status=_new("sensor_msgs/msg/NavSatStatus", status=status, service=state << 12),
        latitude=lla[0],
        longitude=lla[1],
        altitude=lla[2],
        position_covariance=covariance.ravel(),
        position_covariance_type=_COVARIANCE_UNKNOWN if covariance_n is None else _COVARIANCE_KNOWN,
    )


def _pose_with_covariance(p_n: Vec3, q_nb_wxyz: Quat, covariance: Array) -> Any:
    return _new(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=_pose(p_n, q_nb_wxyz),
        covariance=axes.world_covariance(covariance).ravel(),
    )


def _pose(p_n: Vec3, q_nb_wxyz: Quat) -> Any:
    x, y, z = axes.world(p_n)
    position = _new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return _new("geometry_msgs/msg/Pose", position=position, orientation=_quaternion(axes.attitude(q_nb_wxyz)))


def _quaternion(q_wxyz: Quat) -> Any:
    w, x, y, z = q_wxyz
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _transform(header: Any, child: str, translation: Vec3, rotation: Any) -> Any:
    transform = _new("geometry_msgs/msg/Transform", translation=_vector(translation), rotation=rotation)
    return _new("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)


def whole_image() -> Any:
    """A sensor_msgs/msg/RegionOfInterest of the whole image."""
    return _new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)


def _vector(v: Vec3) -> Any:
    return _new("geometry_msgs/msg/Vector3", x=v[0], y=v[1], z=v[2])


def header_of(t_ns: int, frame: str) -> Any:
    """A std_msgs/msg/Header."""
    return _new(schemas.HEADER, stamp=_time(t_ns), frame_id=frame)


def _time(t_ns: int) -> Any:
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return _new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def _new(name: str, /, **fields: Any) -> Any:
    make: Any = STORE.types[name]
    return make(**fields)


def packed(topic: str, schema: str, /, **fields: Any) -> Encoded:
    """A message of these fields in CDR."""
    return Encoded(topic, schema, bytes(STORE.serialize_cdr(_new(schema, **fields), schema, little_endian=True)))
