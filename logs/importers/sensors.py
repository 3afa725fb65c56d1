"""Common forms of sensors."""

import numpy as np

from logs.importers.recording import Stream, Times
from logs.store.reader import LogError
from logs.wire import receiver
from models.frames import GRAVITY, Origin
from models.messages import Array, Vec3

GAUSS_T = 1e-4
UERE_M = 3.0  # user equivalent range error: gives the 2.5 m CEP of consumer receivers at HDOP 1 (CEP = 1.18 UERE / sqrt 2)
VDOP_OVER_HDOP = 1.5  # typical, where a log has no VDOP
_TRUTH_GAP_NS = 1_500_000_000  # a truth with larger gaps is not interpolated
_SEA_LEVEL_KG_M3 = 1.225  # density of the standard atmosphere
_NO_FIELD_GAUSS = 1e3  # Earth's is below 0.7
_AXES_LEAN = 0.7  # of the mean specific force that must point up if the axes are right


def check_imu(gyro_b: Array, accel_b: Array, where: str) -> list[str]:
    """Notes; gyro_b, accel_b (n, 3), FRD. Raises LogError."""
    force = np.linalg.norm(accel_b, axis=1)
    rate = np.linalg.norm(gyro_b, axis=1)
    if not np.isfinite(force).any() or not np.isfinite(rate).any():
        raise LogError(f"{where}: no finite IMU sample in it")
    median = float(np.nanmedian(force))
    if 0.8 < median < 1.3:
        raise LogError(f"{where}: the accelerometer reads {median:.2f} in the median: that is g; needed: m/s^2 (x {GRAVITY})")
    if median < 2.0:
        raise LogError(f"{where}: the accelerometer reads {median:.2f} in the median: gravity is missing; needed: specific force")
    if median > 30.0:
        raise LogError(f"{where}: the accelerometer reads {median:.1f} in the median, which is not m/s^2 (raw counts?)")
    fast = float(np.nanpercentile(rate, 95))
    if fast > 20.0:
        raise LogError(f"{where}: one gyro sample in twenty is above {fast:.0f}, that is deg/s; needed: rad/s (x 0.0174533)")
    mean = np.nanmean(accel_b, axis=0)
    if -mean[2] < _AXES_LEAN * np.linalg.norm(mean):
        force_b = ", ".join(f"{x:.1f}" for x in mean)
        return [f"{where}: the mean specific force in FRD is ({force_b}) m/s^2, far from (0, 0, -9.8): wrong axes?"]
    return []


def check_rate(t_ns: Times, where: str) -> list[str]:
    """A note where the IMU is too slow."""
    period_s = float(np.median(np.diff(t_ns))) * 1e-9 if len(t_ns) > 1 else 0.0
    if period_s > 0.05:
        return [f"{where}: {1.0 / period_s:.1f} IMU samples a second are too few to navigate by: log 50 or more"]
    return []


def check_place(lla: Array, where: str) -> None:
    """Raise LogError unless degrees; lla (n, 3)."""
    known = np.abs(lla[np.isfinite(lla).all(axis=1), :2])
    usual = float(np.median(known, axis=0).max()) if len(known) else 0.0
    if usual > 360.0:
        unit = "1e-7 deg" if usual > 1e5 else "degrees and minutes"
        raise LogError(f"{where}: latitude or longitude {usual:.0f} is not degrees ({unit}?)")


def reception(topic: str, noise: Array, gain: Array, indicator: Array) -> list[str]:
    """A note on the medians and the largest values of a receiver's MON-HW."""
    if not len(noise):
        return []
    usual, most = (receiver.reception(float(f(noise)), float(f(gain)), float(f(indicator))) for f in (np.median, np.max))
    return [f"{topic}: {usual}; at most: {most}"] if most else []


def authentication(topic: str, state: Array) -> list[str]:
    """A note on GPS_AUTHENTICATION_STATE (n,)."""
    counts = zip(*np.unique(state.astype(int), return_counts=True), strict=True)
    return [f"{topic}: {words} in {n} of {len(state)}" for k, n in counts if (words := receiver.reception(0, 0, 0, int(k)))]


def navsat_status(fix_type: Array) -> Array:
    """NavSatStatus: < 3 -> -1, 3D -> 0, DGPS -> 1, RTK -> 2."""
    return np.select([fix_type < 3, fix_type == 3, fix_type == 4], [-1.0, 0.0, 1.0], 2.0)


def variance_from_dop(hdop: Array, vdop: Array) -> Array:
    """Variances (n, 3) NED, m^2, of HDOP and VDOP (n,).

    HDOP^2 UERE^2 = sigma_n^2 + sigma_e^2, VDOP UERE = sigma_d                                      (Groves 2013, eq. 9.144)
    """
    horizontal = 0.5 * (hdop * UERE_M) ** 2
    vertical = (np.where(np.isnan(vdop), VDOP_OVER_HDOP * hdop, vdop) * UERE_M) ** 2
    return np.stack([horizontal, horizontal, vertical], axis=1)


def highres_field(field_b: Array) -> Array:
    """Tesla (n, 3) of HIGHRES_IMU: gauss, microgauss from ArduPilot (4.7.0-dev)."""
    is_micro = np.linalg.norm(field_b, axis=1, keepdims=True) > _NO_FIELD_GAUSS
    return GAUSS_T * np.where(is_micro, 1e-6, 1.0) * field_b


def indicated_airspeed(pressure_pa: Array) -> Array:
    """v = sqrt(2 q / rho_0) [m/s] of dynamic pressure q [Pa], (n,), signed."""
    return np.asarray(np.copysign(np.sqrt(2.0 * np.abs(pressure_pa) / _SEA_LEVEL_KG_M3), pressure_pa))


def standard_pressure(height_m: Array) -> Array:
    """p = 101325 (1 - 2.25577e-5 h)^5.25588 Pa, (n,): standard atmosphere."""
    return np.asarray(101325.0 * np.maximum(1.0 - 2.25577e-5 * height_m, 0.0) ** 5.25588)


def origin_of_truth(gnss: Stream, truth: Stream, delay_s: float, known: Vec3 | None = None) -> Vec3 | None:
    """Latitude, longitude [deg], height [m] of the truth's origin: median over fixes of

    origin = place of the fix (-) p_n, of the truth at its stamp less delay_s

    `known`: taken where it agrees to 2 m, or without overlap.
    """
    lla, status = gnss.columns[0], gnss.columns[2]
    p_n = _position_at(gnss.t_ns - round(delay_s * 1e9), truth)
    fixes = np.flatnonzero((status >= 0) & np.isfinite(lla).all(axis=1) & np.isfinite(p_n).all(axis=1))
    if len(fixes) == 0:
        return known
    fixes = fixes[:: max(1, len(fixes) // 300)]  # a median needs no more
    lla, p_n = lla[fixes], p_n[fixes]
    if known is not None and np.abs(_offset(Origin(*known), lla, p_n)).max() < 2.0:
        return known
    lat, lon, alt = lla[0].tolist()
    origin = Origin(lat, lon, alt)
    for _ in range(3):  # n turns a little with its origin
        origin = Origin(*origin.to_geodetic(_offset(origin, lla, p_n)))
    return origin.lat_deg, origin.lon_deg, origin.alt_m


def _offset(origin: Origin, lla: Array, p_n: Array) -> Array:
    places = np.array([origin.to_ned(*place) for place in lla.tolist()])
    return np.asarray(np.median(places - p_n, axis=0))


def _position_at(t_ns: Times, truth: Stream) -> Array:
    p_n = np.full((len(t_ns), 3), np.nan)
    if len(truth) < 2:
        return p_n
    after = np.clip(np.searchsorted(truth.t_ns, t_ns), 1, len(truth) - 1)
    before = after - 1
    span = truth.t_ns[after] - truth.t_ns[before]
    share = (t_ns - truth.t_ns[before]) / np.maximum(span, 1)
    between = (share >= 0.0) & (share <= 1.0) & (span < _TRUTH_GAP_NS)
    line = truth.columns[0]
    return np.where(between[:, np.newaxis], line[before] + share[:, np.newaxis] * (line[after] - line[before]), p_n)
