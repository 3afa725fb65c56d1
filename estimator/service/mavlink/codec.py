"""MAVLink messages <-> records, both NED and FRD. ODOMETRY differs:

PX4        LOCAL_NED, BODY_FRD; covariances are covariances
           a position not to be used is nan, the velocity may be used
ArduPilot  LOCAL_FRD, BODY_FRD, numbers NED; of three numbers c of the pose's diagonal it makes
           sigma = (c_1^2 + c_2^2 + c_3^2)^(1/3), so that c_i = sqrt(sigma_i^3 / 3) gives it sigma;
           position and attitude: autopilot/local_frame.py
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from estimator.service.autopilot.px4_messages import position_sigmas
from logs.importers.sensors import highres_field, indicated_airspeed, navsat_status, variance_from_dop
from logs.wire.receiver import reception, reported
from models import so3
from models.frames import GRAVITY
from models.messages import (
    Alert,
    Array,
    AttitudePrior,
    Estimate,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Integrity,
    ReceiverState,
    Vec3,
    vec3,
)
from models.state import E, X

PX4: Final = mavlink.MAV_AUTOPILOT_PX4
ARDUPILOT: Final = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
COARSE: Final = frozenset({"RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"})

_US_NS, _MS_NS = 1_000, 1_000_000
_MILLI_G: Final = GRAVITY * 1e-3
_ACCEL_AND_GYRO: Final = 0b111111  # of HIGHRES_IMU.fields_updated
_PRESSURE: Final[int] = mavlink.HIGHRES_IMU_UPDATED_ABS_PRESSURE
_DIFF_PRESSURE: Final[int] = mavlink.HIGHRES_IMU_UPDATED_DIFF_PRESSURE
_HPA_PA: Final = 100.0
_FIELD: Final[int] = mavlink.HIGHRES_IMU_UPDATED_XMAG | mavlink.HIGHRES_IMU_UPDATED_YMAG | mavlink.HIGHRES_IMU_UPDATED_ZMAG
_GAUSS_T: Final = 1e-4
_UNKNOWN: Final = 65535
_SPEED_SIGMA_M_S: Final = 0.5  # where the receiver reports none
_NO_VERTICAL_VARIANCE: Final = 100.0**2  # m^2/s^2: there is no vertical speed; 0 with this says nothing
_FIX_3D: Final = 3
_GPS_EPOCH_NS: Final = 315_964_800_000_000_000  # 1980-01-06
_LEAP_NS: Final = 18_000_000_000  # GPS time is ahead of UTC by this much, since 2017
_WEEK_MS: Final = 604_800_000
_DATES_NS: Final = (1_483_228_800_000_000_000, 4_102_444_800_000_000_000)  # 2017 to 2100: whoever is outside has no date
_TURN: Final = 2.0 * math.pi
_SAME_HEIGHT_MM: Final = 10  # two heights closer than this are one: ArduPilot counts in cm
_NOT_USABLE: Final = np.repeat([100.0, 1.5], 3)  # m, rad: ArduPilot's largest sigmas
_POSE: Final = np.r_[0:3, 6:9]  # position and attitude in the error state
_UPPER: Final = np.triu_indices(6)
_DIAGONAL: Final = np.flatnonzero(_UPPER[0] == _UPPER[1])  # of the 21 numbers of a 6x6 upper triangle
_IGNORED: Final = (
    mavlink.GPS_INPUT_IGNORE_FLAG_HDOP
    | mavlink.GPS_INPUT_IGNORE_FLAG_VDOP
    | mavlink.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ
    | mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT
    | mavlink.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY
)
_SEVERITY: Final = {
    Alert.NOT_JUDGED: mavlink.MAV_SEVERITY_INFO,
    Alert.USABLE: mavlink.MAV_SEVERITY_INFO,
    Alert.CAUTION: mavlink.MAV_SEVERITY_WARNING,
    Alert.DO_NOT_USE: mavlink.MAV_SEVERITY_CRITICAL,
}
_TEXT_BYTES: Final = 50
_NOT_COUNTED: Final = 255  # satellites: there are none

Pose = tuple[Vec3 | None, Array]  # position, m (None: not to be used), and attitude (w, x, y, z)
_NOT_GIVEN: Final = math.nan, math.nan, math.nan


class Place(NamedTuple):
    """Position on Earth: degrees, metres above ellipsoid and sea."""

    lat_deg: float
    lon_deg: float
    ellipsoid_m: float
    sea_m: float


def is_of_now(message: Any) -> bool:
    """Whether its time is its own: ArduPilot gives a receiver without a fix the time of its last one, or 0."""
    return bool(getattr(message, "fix_type", _FIX_3D) > mavlink.GPS_FIX_TYPE_NO_FIX)


def stamp_ns(message: Any) -> int:
    """The message's own time; 0 without."""
    if hasattr(message, "time_usec"):
        return int(message.time_usec) * _US_NS
    return int(getattr(message, "time_boot_ms", 0)) * _MS_NS


def imu(message: Any, t_ns: int, topic: str) -> ImuSample | None:
    """HIGHRES_IMU (SI), ArduPilot's RAW_IMU, SCALED_IMU, 2, 3 (mG, mrad/s); None: incomplete."""
    gyro = message.xgyro, message.ygyro, message.zgyro
    accel = message.xacc, message.yacc, message.zacc
    if "id" in message.fieldnames and message.id != 0:  # SCALED_IMU has none: its id is that of the message
        return None
    if message.get_type() in COARSE:
        return ImuSample(t_ns, t_ns, vec3([1e-3 * x for x in gyro]), vec3([_MILLI_G * x for x in accel]), topic)
    if message.fields_updated & _ACCEL_AND_GYRO != _ACCEL_AND_GYRO:
        return None
    return ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel), topic)


def attitude(message: Any, t_ns: int, sigma_deg: tuple[float, float], topic: str) -> AttitudePrior:
    """ATTITUDE [rad]; sigma_deg: of tilt and heading, not in the message. Raises ValueError."""
    angles = message.roll, message.pitch, message.yaw
    if not all(abs(angle) <= _TURN for angle in angles):
        raise ValueError("roll, pitch, yaw = {:g}, {:g}, {:g} rad: are no angles".format(*angles))
    tilt, heading = (math.radians(sigma) ** 2 for sigma in sigma_deg)
    w, x, y, z = so3.from_euler(*angles).tolist()
    return AttitudePrior(t_ns, t_ns, (w, x, y, z), np.diag([tilt, tilt, heading]), topic)


def receiver_state(message: Any) -> ReceiverState:
    """Of GNSS_INTEGRITY."""
    return reported(message.jamming_state, message.spoofing_state)


def authentication(message: Any) -> str:
    """Of GNSS_INTEGRITY, in words."""
    return reception(0, 0, 0, message.authentication_state)


def gnss_fix(message: Any, t_ns: int, geoid_m: float, topic: str, state: ReceiverState = ReceiverState.UNKNOWN) -> GnssFix:
    """GPS_RAW_INT, GPS2_RAW; geoid_m where alt_ellipsoid is 0 or equals alt."""
    has_ellipsoid = message.alt_ellipsoid and abs(message.alt_ellipsoid - message.alt) > _SAME_HEIGHT_MM
    height_m = 1e-3 * message.alt_ellipsoid if has_ellipsoid else 1e-3 * message.alt + geoid_m
    status = int(navsat_status(np.array(message.fix_type)))
    lat_deg, lon_deg = 1e-7 * message.lat, 1e-7 * message.lon
    return GnssFix(t_ns, t_ns, lat_deg, lon_deg, height_m, _position_covariance(message), status, topic, state)


def gnss_velocity(message: Any, t_ns: int, topic: str) -> GnssVelocity | None:
    """Speed and course over ground; None: not given, or its position is no place on Earth."""
    if (
        message.fix_type < _FIX_3D
        or _UNKNOWN in {message.vel, message.cog}
        or not gnss_fix(message, t_ns, 0.0, topic).is_on_earth
    ):
        return None
    speed, course = 1e-2 * message.vel, math.radians(1e-2 * message.cog)
    variance = (1e-3 * message.vel_acc or _SPEED_SIGMA_M_S) ** 2
    v_n = speed * math.cos(course), speed * math.sin(course), 0.0
    return GnssVelocity(t_ns, t_ns, v_n, np.diag([variance, variance, _NO_VERTICAL_VARIANCE]), topic)


def odometry(e: Estimate, pose: Pose, time_usec: int, counter: int, quality: int, autopilot: int) -> Any:
    """ODOMETRY: body velocity, attitude variances about the body's axes.

    pose: position [m] and q_nb in its frame. At quality -1 ArduPilot gets its largest sigmas.
    """
    R_bn = so3.matrix(so3.normalise(e.nav[X.Q])).T
    p_n, q_nb = pose
    covariance = e.covariance[np.ix_(_POSE, _POSE)][_UPPER]
    frame = mavlink.MAV_FRAME_LOCAL_NED
    if autopilot == ARDUPILOT:
        frame, sigmas = mavlink.MAV_FRAME_LOCAL_FRD, np.sqrt(covariance[_DIAGONAL])
        sigmas = np.maximum(sigmas, _NOT_USABLE) if quality < 0 else sigmas
        covariance = np.zeros(len(covariance))
        covariance[_DIAGONAL] = np.sqrt(sigmas**3 / 3.0)
    velocity = np.zeros((6, 6))
    velocity[:3, :3] = R_bn @ e.covariance[E.V, E.V] @ R_bn.T
    return mavlink.MAVLink_odometry_message(
        time_usec,
        frame,
        mavlink.MAV_FRAME_BODY_FRD,
        *(p_n or _NOT_GIVEN),
        q_nb.tolist(),
        *vec3(R_bn @ e.nav[X.V]),
        *e.gyro_b,
        covariance.tolist(),
        velocity[_UPPER].tolist(),
        reset_counter=counter,
        estimator_type=mavlink.MAV_ESTIMATOR_TYPE_VISION,
        quality=quality,
    )


def place(lla: Vec3, geoid_m: float) -> Place:
    """lla: degrees, m above the ellipsoid; geoid_m: geoid above it."""
    return Place(*lla, lla[2] - geoid_m)


def global_position(e: Estimate, at: Place, time_usec: int, slot: int, system: int) -> Any:
    """GLOBAL_POSITION_SENSOR, for PX4's auxiliary global position."""
    eph, epv = position_sigmas(e.covariance)
    return mavlink.MAVLink_global_position_sensor_message(
        system,
        mavlink.MAV_COMP_ID_AUTOPILOT1,
        slot,
        time_usec,
        0,
        mavlink.GLOBAL_POSITION_SRC_VISION,
        0,
        *_degrees_e7(at),
        at.ellipsoid_m,
        at.sea_m,
        eph,
        epv,
    )


def set_origin(at: Place, system: int) -> Any:
    """SET_GPS_GLOBAL_ORIGIN. ArduPilot takes it if it has none; the barometer's zero is there."""
    return mavlink.MAVLink_set_gps_global_origin_message(system, *_degrees_e7(at), round(1e3 * at.sea_m))


def gps_input(e: Estimate, at: Place, time_usec: int, gps_id: int, utc_ns: int | None) -> Any:
    """GPS_INPUT without velocity; utc_ns: date if known, else week 0."""
    eph, epv = position_sigmas(e.covariance)
    week, week_ms = 0, 0
    if utc_ns is not None and is_date(utc_ns):
        week, week_ms = divmod((utc_ns + _LEAP_NS - _GPS_EPOCH_NS) // _MS_NS, _WEEK_MS)
    nothing = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # hdop, vdop, three of velocity and its accuracy: flagged as not given
    return mavlink.MAVLink_gps_input_message(
        time_usec, gps_id, _IGNORED, week_ms, week, _FIX_3D, *_degrees_e7(at), at.sea_m, *nothing, eph, epv, _NOT_COUNTED
    )


def alert(integrity: Integrity, number: int) -> list[Any]:
    """STATUSTEXT of state and reason, in chunks of 50 bytes; number: 1 to 65535 per text."""
    state = integrity.state
    words = f"landfix: {state}, {integrity.reason}" if integrity.reason else f"landfix: {state}, HPL {integrity.hpl_m:.1f} m"
    text = words.encode("ascii", "replace")
    if len(text) <= _TEXT_BYTES:
        return [mavlink.MAVLink_statustext_message(_SEVERITY[state], text)]
    return [
        mavlink.MAVLink_statustext_message(_SEVERITY[state], text[first : first + _TEXT_BYTES], number, first // _TEXT_BYTES)
        for first in range(0, len(text) + 1, _TEXT_BYTES)
    ]


def is_date(utc_ns: int) -> bool:
    """Whether the time is plausible for a set clock."""
    first, end = _DATES_NS
    return first <= utc_ns < end


def _degrees_e7(at: Place) -> tuple[int, int]:
    return round(at.lat_deg * 1e7), round(at.lon_deg * 1e7)


def _position_covariance(message: Any) -> Array | None:
    if message.h_acc and message.v_acc:
        h, v = 1e-3 * message.h_acc, 1e-3 * message.v_acc
        return np.diag([h * h, h * h, v * v])
    hdop, vdop = (math.nan if x == _UNKNOWN else 1e-2 * x for x in (message.eph, message.epv))
    variance = variance_from_dop(np.array([hdop]), np.array([vdop]))[0]
    return np.diag(variance) if np.isfinite(variance).all() and (variance > 0.0).all() else None


def _pressure(message: Any) -> tuple[float, ...] | None:
    if message.id != 0 or not message.fields_updated & _PRESSURE:
        return None
    return (_HPA_PA * message.abs_pressure,)


def _field(message: Any) -> tuple[float, ...] | None:
    if message.id != 0 or message.fields_updated & _FIELD != _FIELD:
        return None
    return vec3(highres_field(np.array([[message.xmag, message.ymag, message.zmag]]))[0])


def has_field(message: Any) -> bool | None:
    """Whether the magnetometer measures anything; None: unknown."""
    if message.get_type() == "HIGHRES_IMU" and (message.id != 0 or message.fields_updated & _FIELD != _FIELD):
        return None
    return any((message.xmag, message.ymag, message.zmag))


def _coarse_field(message: Any) -> tuple[float, ...] | None:
    """Milligauss; all zero: no magnetometer."""
    field = message.xmag, message.ymag, message.zmag
    return tuple(1e-3 * _GAUSS_T * m for m in field) if any(field) else None


def _azimuth(message: Any) -> tuple[float, ...] | None:
    """Centidegrees; 0: not available, 65535: not now, 36000: north."""
    return None if message.yaw in {0, _UNKNOWN} else (math.radians(1e-2 * message.yaw),)


def _range(message: Any) -> tuple[float, ...] | None:
    if message.orientation != mavlink.MAV_SENSOR_ROTATION_PITCH_270:
        return None
    is_within = message.min_distance <= message.current_distance <= message.max_distance
    return (1e-2 * message.current_distance if is_within else math.inf,)


def _indicated(hectopascal: float) -> tuple[float, ...]:
    return (float(indicated_airspeed(np.array(_HPA_PA * hectopascal))),)


def _airspeed(message: Any) -> tuple[float, ...] | None:
    """PX4's; ArduPilot sends another pressure there."""
    return _indicated(message.diff_pressure) if message.id == 0 and message.fields_updated & _DIFF_PRESSURE else None


def _scaled_airspeed(message: Any) -> tuple[float, ...] | None:
    return _indicated(message.press_diff) if message.press_diff else None


# Message -> the sensors whose readings it carries: kind, and values as logs/wire/sensors.py has them, None where there are none.
SENSORS: Final[dict[str, dict[str, Callable[[Any], tuple[float, ...] | None]]]] = {
    "HIGHRES_IMU": {"baro": _pressure, "magnetometer": _field, "airspeed": _airspeed},
    "RAW_IMU": {"magnetometer": _coarse_field},
    "SCALED_IMU": {"magnetometer": _coarse_field},
    "SCALED_PRESSURE": {"airspeed": _scaled_airspeed},
    "DISTANCE_SENSOR": {"range": _range},
    "GPS_RAW_INT": {"heading": _azimuth},
    "GPS2_RAW": {"heading": _azimuth},
}
