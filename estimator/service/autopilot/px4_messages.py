"""PX4's messages in XCDR1, little endian, fields as in the .msg file."""

import math
import struct
from functools import cache
from typing import Final

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.importers.sensors import navsat_status
from logs.wire.receiver import reception, reported
from models import so3
from models.messages import Array, Estimate, GnssFix, GnssVelocity, Vec3, vec3
from models.state import E, X

VEHICLE_ODOMETRY: Final = "px4_msgs/msg/VehicleOdometry"
AUX_GLOBAL_POSITION: Final = "px4_msgs/msg/AuxGlobalPosition"
VEHICLE_GLOBAL_POSITION: Final = "px4_msgs/msg/VehicleGlobalPosition"
VEHICLE_LOCAL_POSITION: Final = "px4_msgs/msg/VehicleLocalPosition"  # the same in 1.16 to 1.18

DEFINITIONS: Final = {
    VEHICLE_ODOMETRY: """\
# us since the start of PX4; of sending, and of validity
uint64 timestamp
uint64 timestamp_sample
# 1: NED
uint8 pose_frame
# m
float32[3] position
# wxyz, body FRD -> frame
float32[4] q
# 1: NED
uint8 velocity_frame
# m/s
float32[3] velocity
# rad/s, body FRD
float32[3] angular_velocity
# m^2, rad^2 about the body's axes, m^2/s^2
float32[3] position_variance
float32[3] orientation_variance
float32[3] velocity_variance
uint8 reset_counter
# -1: failed, 0: unknown, 1 to 100
int8 quality
""",
    AUX_GLOBAL_POSITION: """\
uint64 timestamp
uint64 timestamp_sample
# must be that of EKF2_AGPx_ID
uint8 id
# 2: vision
uint8 source
# deg
float64 lat
float64 lon
# m above mean sea level; sigmas in m
float32 alt
float32 eph
float32 epv
uint8 lat_lon_reset_counter
""",
    VEHICLE_GLOBAL_POSITION: """\
uint64 timestamp
uint64 timestamp_sample
# deg
float64 lat
float64 lon
# m above mean sea level, above the ellipsoid
float32 alt
float32 alt_ellipsoid
bool lat_lon_valid
bool alt_valid
float32 delta_alt
float32 delta_terrain
uint8 lat_lon_reset_counter
uint8 alt_reset_counter
uint8 terrain_reset_counter
# m, sigma
float32 eph
float32 epv
float32 terrain_alt
bool terrain_alt_valid
bool dead_reckoning
""",
    VEHICLE_LOCAL_POSITION: """\
uint64 timestamp
uint64 timestamp_sample
bool xy_valid
bool z_valid
bool v_xy_valid
bool v_z_valid
# m, NED; the last reset, and how many there were
float32 x
float32 y
float32 z
float32[2] delta_xy
uint8 xy_reset_counter
float32 delta_z
uint8 z_reset_counter
# m/s
float32 vx
float32 vy
float32 vz
float32 z_deriv
float32[2] delta_vxy
uint8 vxy_reset_counter
float32 delta_vz
uint8 vz_reset_counter
float32 ax
float32 ay
float32 az
float32 heading
float32 heading_var
float32 unaided_heading
float32 delta_heading
uint8 heading_reset_counter
bool heading_good_for_control
float32 tilt_var
# whether the frame has a place on Earth; deg, m above mean sea level
bool xy_global
bool z_global
uint64 ref_timestamp
float64 ref_lat
float64 ref_lon
float32 ref_alt
bool dist_bottom_valid
float32 dist_bottom
float32 dist_bottom_var
float32 delta_dist_bottom
uint8 dist_bottom_reset_counter
uint8 dist_bottom_sensor_bitfield
float32 eph
float32 epv
float32 evh
float32 evv
bool dead_reckoning
float32 vxy_max
float32 vz_max
float32 hagl_min
float32 hagl_max_z
float32 hagl_max_xy
""",
}

_HEAD: Final = b"\x00\x01\x00\x00"
_ODOMETRY: Final = struct.Struct("<4sQQB3x3f4fB3x3f3f3f3f3fBb")
_AUX: Final = struct.Struct("<4sQQBB6xddfffB")
_GLOBAL: Final = struct.Struct("<4sQQddff??2xffBBBxfff??")
_REFERENCE: Final = struct.Struct("<4x124x??2x8xddf")  # of VehicleLocalPosition, from xy_global to ref_alt
_GPS: Final = struct.Struct("<4xQQ8x4df4xB3xff8xiHBxiBB6x3f4x?")  # of SensorGps, to vel_ned_valid
_NED, _VISION = 1, 2
_NOT_GIVEN: Final = None, None, None
_BYTE: Final = 256
_IS_LANDED, _GROUND, _AIR = 15, 1, 2  # behind encapsulation, timestamp, freefall, ground_contact and maybe_landed


@cache
def type_hash(schema: str) -> str:
    """RIHS01 hash of one of DEFINITIONS."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(DEFINITIONS[schema], schema))
    return store.hash_rihs01(schema)


def local_reference(data: bytes) -> Vec3 | None:
    """Origin of a VehicleLocalPosition, degrees, m above the sea, or None."""
    if len(data) < _REFERENCE.size:
        return None
    xy_global, z_global, lat, lon, alt = _REFERENCE.unpack_from(data)
    return (lat, lon, alt) if xy_global and z_global else None


def receiver(data: bytes, geoid_m: float, topic: str) -> tuple[GnssFix, GnssVelocity | None, str] | None:
    """Of a SensorGps (1.15 to 1.18), stamps PX4's, and its reception in words; None: too short.

    Sigma 0: not given.
    """
    if len(data) < _GPS.size:
        return None
    now_us, sampled_us, lat, lon, sea_m, height_m, v_sigma, fix_type, eph, epv, *signal, n, e, d, valid = _GPS.unpack_from(data)
    noise, gain, jamming, indicator, spoofing, authentication = signal
    t_ns, given = 1_000 * (sampled_us or now_us), height_m not in {0.0, sea_m}
    status, state = navsat_status(np.array(fix_type)), reported(jamming, spoofing)
    covariance = np.diag([eph**2, eph**2, epv**2]) if eph > 0.0 and epv > 0.0 else None
    v_covariance = np.eye(3) * v_sigma**2 if v_sigma > 0.0 else None
    height = height_m if given else sea_m + geoid_m
    fix = GnssFix(t_ns, t_ns, lat, lon, height, covariance, int(status), topic, state)
    velocity = GnssVelocity(t_ns, t_ns, (n, e, d), v_covariance, f"{topic}/velocity")
    return fix, velocity if valid and fix.is_on_earth else None, reception(noise, gain, indicator, authentication)


def landed(data: bytes) -> float | None:
    """MAV_LANDED_STATE of a VehicleLandDetected (1.15 to 1.18); None: too short."""
    return None if len(data) <= _IS_LANDED else float(_GROUND if data[_IS_LANDED] else _AIR)


def vehicle_odometry(
    e: Estimate, pose: tuple[Vec3 | None, Array], sent_us: int, sample_us: int, counter: int, quality: int
) -> bytes | None:
    """The estimate in NED; None: a number does not fit.

    pose: position (None: not to be used, sent as nan) and q_nb in PX4's frame; v = R_pose R_nb^T v_n.
    """
    p_local, q_local = pose
    v_local = so3.matrix(q_local) @ so3.matrix(so3.normalise(e.nav[X.Q])).T @ e.nav[X.V]
    v = np.diag(e.covariance)
    p, (w, x, y, z), velocity = p_local or _NOT_GIVEN, q_local.tolist(), vec3(v_local)
    var_p, var_theta, var_v = (vec3(v[part]) for part in (E.P, E.THETA, E.V))
    return _packed(
        _ODOMETRY,
        sent_us,
        sample_us,
        _NED,
        *p,
        w,
        x,
        y,
        z,
        _NED,
        *velocity,
        *e.gyro_b,
        *var_p,
        *var_theta,
        *var_v,
        counter,
        quality,
    )


def aux_global_position(
    e: Estimate, lla: tuple[float, float, float], geoid_m: float, sent_us: int, sample_us: int, slot: int
) -> bytes | None:
    """PX4 1.18 and newer. slot: EKF2_AGPx_ID."""
    eph, epv = position_sigmas(e.covariance)
    lat, lon, alt = lla
    return _packed(_AUX, sent_us, sample_us, slot, _VISION, lat, lon, alt - geoid_m, eph, epv, e.reset_counter % _BYTE)


def vehicle_global_position(e: Estimate, lla: Vec3, geoid_m: float, sent_us: int, sample_us: int) -> bytes | None:
    """PX4 1.16 and 1.17, under the key of the auxiliary position."""
    eph, epv = position_sigmas(e.covariance)
    lat, lon, alt = lla
    counter = e.reset_counter % _BYTE
    heights, nothing = (alt - geoid_m, alt), (0.0, 0.0)
    return _packed(
        _GLOBAL, sent_us, sample_us, lat, lon, *heights, True, True, *nothing, counter, 0, 0, eph, epv, 0.0, False, False
    )


def _packed(layout: struct.Struct, *fields: float | None) -> bytes | None:
    if not all(x is None or math.isfinite(x) for x in fields):
        return None
    try:
        return layout.pack(_HEAD, *(math.nan if x is None else x for x in fields))
    except (struct.error, OverflowError):
        return None


def position_sigmas(covariance: Array) -> tuple[float, float]:
    """Horizontal (longest axis) and vertical sigma of the position, m."""
    position = covariance[E.P, E.P]
    return float(np.sqrt(np.linalg.eigvalsh(position[:2, :2])[-1])), float(np.sqrt(position[2, 2]))
