"""Optional sensors on the wire: topic, ROS 2 type, fields; SI, FLU <-> FRD.

A sensor is a line in SensorTopics and one in SENSORS.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from logs.wire import axes, schemas
from models.messages import Array, Reading

_NOT_GIVEN: Final = 1e6
_Topics: TypeAlias = tuple[str, ...]
_Values: TypeAlias = tuple[tuple[float, ...], Array | None]


class SensorTopics(msgspec.Struct, frozen=True):
    """[inputs] of the optional sensors: off until a topic is named."""

    baro: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/FluidPressure; none: no barometer is used")] = ()
    velocity_body: Annotated[
        _Topics, Meta(description="topics of geometry_msgs/msg/TwistWithCovarianceStamped, FLU; none: none is used")
    ] = ()
    airspeed: Annotated[
        _Topics, Meta(description="topics of TwistWithCovarianceStamped, through the air, FLU, linear.x; none: none is used")
    ] = ()
    range: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/Range, downwards; none: none is used")] = ()
    beacon: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/Range, one for each beacon; none: none is used")] = ()
    heading: Annotated[
        _Topics, Meta(description="topics of sensor_msgs/msg/Imu whose orientation is that of two antennas; none: none is used")
    ] = ()
    magnetometer: Annotated[
        _Topics, Meta(description="topics of sensor_msgs/msg/MagneticField; none: no magnetometer is used")
    ] = ()
    rest: Annotated[
        _Topics, Meta(description="topics of mavros_msgs/msg/ExtendedState: landed, and so perhaps at rest; not of a boat")
    ] = ("/landed",)


class Sensor(NamedTuple):
    """topic: of importers and simulation; values: of a message, with covariance; fields: of a reading's message."""

    topic: str
    schema: str
    values: Callable[[Any], _Values]
    fields: Callable[[Reading], dict[str, Any]]


def _known(covariance: Any, size: int) -> Array | None:
    """Leading (size, size) of a ROS covariance; None: all zero, or -1 first."""
    full = np.asarray(covariance).reshape(math.isqrt(len(covariance)), -1)[:size, :size]
    return full if full.any() and full[0, 0] != -1.0 else None


def vector(v: tuple[float, ...]) -> Any:
    """A geometry_msgs/msg/Vector3."""
    make: Any = schemas.STORE.types["geometry_msgs/msg/Vector3"]
    return make(x=v[0], y=v[1], z=v[2])


def _field(message: Any) -> _Values:
    m, covariance = message.magnetic_field, _known(message.magnetic_field_covariance, 3)
    return axes.body((m.x, m.y, m.z)), None if covariance is None else axes.body_covariance(covariance)


def _field_message(reading: Reading) -> dict[str, Any]:
    x, y, z = reading.values
    covariance = np.zeros((3, 3)) if reading.covariance is None else axes.body_covariance(reading.covariance)
    return {"magnetic_field": vector(axes.body((x, y, z))), "magnetic_field_covariance": covariance.ravel()}


def _azimuth(message: Any) -> _Values:
    q, covariance = message.orientation, _known(message.orientation_covariance, 3)
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return (math.remainder(0.5 * math.pi - yaw, 2.0 * math.pi),), None if covariance is None else covariance[2:, 2:]


def _azimuth_message(reading: Reading) -> dict[str, Any]:
    half = 0.5 * (0.5 * math.pi - reading.values[0])
    covariance = np.diag([_NOT_GIVEN, _NOT_GIVEN, 0.0 if reading.covariance is None else float(reading.covariance[0, 0])])
    make: Any = schemas.STORE.types["geometry_msgs/msg/Quaternion"]
    nothing = np.zeros(9)
    return {
        "orientation": make(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
        "orientation_covariance": covariance.ravel() if reading.covariance is not None else nothing,
        "angular_velocity": vector((0.0, 0.0, 0.0)),
        "angular_velocity_covariance": nothing,
        "linear_acceleration": vector((0.0, 0.0, 0.0)),
        "linear_acceleration_covariance": nothing,
    }


def _velocity(message: Any) -> _Values:
    v = message.twist.twist.linear
    covariance = _known(message.twist.covariance, 3)
    return axes.body((v.x, v.y, v.z)), None if covariance is None else axes.body_covariance(covariance)


def _velocity_message(reading: Reading) -> dict[str, Any]:
    x, y, z = reading.values
    return _twist((x, y, z), np.zeros((3, 3)) if reading.covariance is None else reading.covariance)


def _twist(v_b: tuple[float, float, float], covariance_b: Array) -> dict[str, Any]:
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = axes.body_covariance(covariance_b)
    make: Any = schemas.STORE.types
    twist = make["geometry_msgs/msg/Twist"](linear=vector(axes.body(v_b)), angular=vector((0.0, 0.0, 0.0)))
    return {"twist": make["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance.ravel())}


def _airspeed(message: Any) -> _Values:
    return (message.twist.twist.linear.x,), _known(message.twist.covariance, 1)


def _airspeed_message(reading: Reading) -> dict[str, Any]:
    known = np.zeros((3, 3)) if reading.covariance is None else np.diag([float(reading.covariance[0, 0]), _NOT_GIVEN, _NOT_GIVEN])
    return _twist((reading.values[0], 0.0, 0.0), known)


def _range(message: Any) -> _Values:
    """Infinite (REP 117) or beyond the limits: out of range."""
    is_within = message.min_range <= message.range <= message.max_range
    return (message.range if is_within else math.inf,), None


def _range_message(reading: Reading) -> dict[str, Any]:
    return {"radiation_type": 1, "field_of_view": 0.0, "min_range": 0.0, "max_range": 1e4, "range": reading.values[0]}


def _pressure(reading: Reading) -> dict[str, Any]:
    variance = 0.0 if reading.covariance is None else float(reading.covariance[0, 0])
    return {"fluid_pressure": reading.values[0], "variance": variance}


def _landed(message: Any) -> _Values:
    return (float(message.landed_state),), None


def _landed_message(reading: Reading) -> dict[str, Any]:
    return {"vtol_state": 0, "landed_state": int(reading.values[0])}


SENSORS: Final = {  # kind -> its message
    "baro": Sensor("/baro", schemas.PRESSURE, lambda m: ((m.fluid_pressure,), np.array([[m.variance]])), _pressure),
    "velocity_body": Sensor("/velocity_body", schemas.TWIST, _velocity, _velocity_message),  # m/s
    "airspeed": Sensor("/airspeed", schemas.TWIST, _airspeed, _airspeed_message),  # m/s along the nose
    "range": Sensor("/range", schemas.RANGE, _range, _range_message),  # m; infinite without an echo
    "beacon": Sensor("/beacon/1", schemas.RANGE, _range, _range_message),  # m
    "heading": Sensor("/heading", schemas.IMU, _azimuth, _azimuth_message),  # rad, clockwise from north
    "magnetometer": Sensor("/mag", schemas.MAGNETIC_FIELD, _field, _field_message),  # tesla
    "rest": Sensor("/landed", schemas.EXTENDED_STATE, _landed, _landed_message),  # MAV_LANDED_STATE
}
