"""Check the autopilot's parameters over its link."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from estimator.config import Config
from estimator.service.mavlink import codec
from estimator.service.mavlink.questions import Answers, ask
from estimator.strict_toml import ConfigError
from estimator.tools.doctor.machine import Check, judge
from models.frames import Origin

_SETS: Final = (1, 2, 3)
_SOURCES: Final = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
_SWITCHES: Final = tuple(f"RC{k}_OPTION" for k in range(1, 17))
_RECEIVERS: Final = ("GPS1_TYPE", "GPS2_TYPE", "GPS_TYPE", "GPS_TYPE2")  # the last two: before 4.6
_NAMES: Final = {
    codec.ARDUPILOT: (
        *("AHRS_EKF_TYPE", "EK3_ENABLE", "EK3_SRC_OPTIONS", "FS_EKF_ACTION", "FS_EKF_THRESH"),
        *(f"VISO_{name}" for name in ("TYPE", "QUAL_MIN", "VEL_M_NSE", "DELAY_MS", "POS_X", "POS_Y", "POS_Z", "ORIENT", "SCALE")),
        *(f"EK3_SRC{k}_{name}" for k in _SETS for name in _SOURCES),
        *_SWITCHES,
        *_RECEIVERS,
        *("GPS_AUTO_SWITCH", "INS_GYRO_FILTER", "INS_ACCEL_FILTER"),
    ),
    codec.PX4: (
        *(f"EKF2_{name}" for name in ("EV_CTRL", "EV_QMIN", "EV_DELAY", "EV_NOISE_MD", "EVA_NOISE", "AGP0_CTRL", "AGP0_ID")),
    ),
}
_YAW: Final = 8  # of EKF2_EV_CTRL, its highest bit
_EVA_NOISE: Final = 0.01  # of EKF2_EVA_NOISE, "rad": EKF2 takes it for the variance below which no yaw is, so 0.1 are 18 degrees
_GPS, _EXTERNAL, _MAVLINK = 3, 6, 14  # of EK3_SRCn_POSXY and VELXY; GPSn_TYPE
_IF_LOST: Final = 4  # of GPS_AUTO_SWITCH: the second receiver only where the first has no fix
_SWITCH: Final = 90
_SOFT_M_S: Final = 0.5
_SLOW_MS: Final = 60.0
_LOWPASS_MS: Final = 1e3 * 2**0.5 / (2.0 * np.pi)  # delay of a second-order Butterworth filter at low frequencies, times its Hz
_LATE_IMU_MS: Final = 25.0


def autopilot(config: Config, folder: Path) -> list[Check]:
    """All checks; folder: base of files. Sets nothing."""
    if not config.mavlink.endpoint:
        return [judge("autopilot", "no [mavlink] endpoint", fail=True, advice="the parameters are read over MAVLink: give one")]
    try:
        answers = ask(config.mavlink, folder, _NAMES)
    except ConfigError as error:
        return [judge("autopilot", str(error), fail=True, advice="end `landfix run` first: one program has the link")]
    if answers is None:
        advice = f"does it send to {config.mavlink.endpoint}, as system {config.mavlink.system}, signed or unsigned like this?"
        return [judge("autopilot", "no HEARTBEAT within 10 s", fail=True, advice=advice)]
    kinds = {codec.ARDUPILOT: ("ArduPilot", _ardupilot), codec.PX4: ("PX4", _px4)}
    if answers.autopilot not in kinds:
        return [judge("autopilot", f"MAV_AUTOPILOT {answers.autopilot}", fail=True, advice="PX4 and ArduPilot are spoken to")]
    name, checks = kinds[answers.autopilot]
    return [judge("autopilot", f"{name} {answers.version}".rstrip()), *checks(answers, config)]


class _Parameters:
    def __init__(self, values: dict[str, float]) -> None:
        self._values = values

    def get(self, name: str) -> float:
        """NaN for an unknown name: no comparison is true."""
        return self._values.get(name, float("nan"))

    def check(self, name: str, good: bool, advice: str, *, warn: bool = False) -> Check:
        has = name in self._values
        found = f"{self._values[name]:g}" if has else "no such parameter"
        return judge(name, found, fail=not good and not warn, warn=not good and warn, advice=advice)


def _ardupilot(answers: Answers, config: Config) -> Iterator[Check]:
    p = _Parameters(answers.parameters)
    yield p.check("AHRS_EKF_TYPE", p.get("AHRS_EKF_TYPE") == 3, "set 3: only EKF3 takes external navigation")
    yield p.check("EK3_ENABLE", p.get("EK3_ENABLE") == 1, "set 1, and reboot")
    if config.mavlink.odometry:
        yield from _visual_odometry(p, config)
    yield from _source_sets(p, config)
    if config.mavlink.fixes:
        yield from _receiver(p, config)
    yield from _imu(p)
    advice = "set 1 or 3: with 0 the vehicle flies on when its position is lost"
    yield p.check("FS_EKF_ACTION", p.get("FS_EKF_ACTION") != 0, advice, warn=True)
    yield p.check("FS_EKF_THRESH", not p.get("FS_EKF_THRESH") <= 0, "set 0.8: 0 disables the failsafe", warn=True)
    yield _origin(answers, config)


def _receiver(p: _Parameters, config: Config) -> Iterator[Check]:
    has = any(p.get(name) == _MAVLINK for name in _RECEIVERS)
    advice = "set GPS2_TYPE 14 (before 4.6: GPS_TYPE2), and reboot: GPS_INPUT is taken by such a receiver only"
    yield judge("receiver for GPS_INPUT", "yes" if has else "none of type 14", fail=not has, advice=advice)
    name, advice = "GPS_AUTO_SWITCH", "set 4: 1 takes the receiver with the most satellites, ours says 255, and 2 blends both"
    yield p.check(name, p.get(name) == _IF_LOST, advice)
    if config.autopilot.own_gnss:
        advice = 'set [autopilot] own_gnss = false: while GNSS is good no fix is sent, and "PreArm: GPS 2: Bad fix"'
        yield judge("fixes while GNSS is good", "none", warn=True, advice=advice)
    if config.mavlink.odometry:
        advice = "set [mavlink] odometry or fixes to false: they are the same information"
        yield judge("ways in", "odometry and fixes", warn=True, advice=advice)


def _visual_odometry(p: _Parameters, config: Config) -> Iterator[Check]:
    yield p.check("VISO_TYPE", p.get("VISO_TYPE") in {1, 3}, "set 1, and reboot: without it ODOMETRY is not listened to")
    least = p.get("VISO_QUAL_MIN")
    radius_m = config.autopilot.most_radius_m * (1.0 - max(least, 0.0) / 100.0)
    advice = "set 0 or more: -1 uses odometry that says of itself that it is not to be used"
    yield p.check("VISO_QUAL_MIN", least >= 0, advice)
    if least > 0:
        yield judge("odometry is used", f"up to a 95 % radius of {radius_m:.1f} m")
    advice = "set 1: with 0.1 the velocity after a blackout fails EKF3's gate, EKF variance, and the vehicle lands"
    yield p.check("VISO_VEL_M_NSE", p.get("VISO_VEL_M_NSE") >= _SOFT_M_S, advice)
    advice = "set 10: ODOMETRY is propagated to now, and stamped"
    yield p.check("VISO_DELAY_MS", p.get("VISO_DELAY_MS") <= _SLOW_MS, advice, warn=True)
    for name in ("VISO_POS_X", "VISO_POS_Y", "VISO_POS_Z", "VISO_ORIENT"):
        yield p.check(name, p.get(name) == 0, "set 0: ODOMETRY is of the autopilot's IMU, not of a camera")
    yield p.check("VISO_SCALE", p.get("VISO_SCALE") == 1, "set 1: positions are in metres already")


def _source_sets(p: _Parameters, config: Config) -> Iterator[Check]:
    if config.mavlink.odometry:
        ours = [k for k in _SETS if p.get(f"EK3_SRC{k}_POSXY") == _EXTERNAL]
        way, advice = (
            "ODOMETRY",
            f"set EK3_SRC2_POSXY and EK3_SRC2_VELXY {_EXTERNAL}, or those of the set to fly with",
        )
    else:
        ours = [k for k in _SETS if p.get(f"EK3_SRC{k}_POSXY") == _GPS and p.get(f"EK3_SRC{k}_VELXY") == 0]
        way, advice = "GPS_INPUT", f"set EK3_SRC2_POSXY {_GPS} and EK3_SRC2_VELXY 0: fixes have no velocity, and 0 would be fused"
    sets = ", ".join(f"set {k}" for k in ours) or "no set"
    yield judge(f"horizontal position from {way}", sets, fail=not ours, advice=advice)
    for name in (f"EK3_SRC{k}_VELXY" for k in ours):
        yield p.check(name, p.get(name) != _GPS, f"set {_EXTERNAL}: the velocity of a receiver that may be spoofed is fused")
    name, advice = "EK3_SRC_OPTIONS", "set 0: 1 (FuseAllVelocities) fuses a receiver's velocity in every set, spoofed or none"
    yield p.check(name, p.get(name) % 2 == 0, advice)
    switches = [name.removesuffix("_OPTION") for name in _SWITCHES if p.get(name) == _SWITCH]
    advice = "set RCn_OPTION 90 for a channel of three positions, or switch with MAV_CMD_SET_EKF_SOURCE_SET"
    yield judge("switch of source sets", ", ".join(switches) or "none", warn=not switches, advice=advice)


def _imu(p: _Parameters) -> Iterator[Check]:
    """A low-passed IMU makes fixes seem early."""
    for name in ("INS_GYRO_FILTER", "INS_ACCEL_FILTER"):
        hz = p.get(name)
        delay_ms = _LOWPASS_MS / hz if hz > 0 else 0.0
        advice = f"set 20: at {hz:g} Hz its readings are {delay_ms:.0f} ms late, and stamps of fixes look early"
        yield p.check(name, not delay_ms > _LATE_IMU_MS, advice, warn=True)


def _origin(answers: Answers, config: Config) -> Check:
    name = "origin of EKF3"
    if answers.origin is None:
        advice = "wait for its GPS, or set it: before it is known ODOMETRY has quality -1"
        return judge(name, "none yet", warn=True, advice=advice)
    lat, lon, sea_m = answers.origin
    found = f"{lat:.7f}, {lon:.7f}, {sea_m:.1f} m above the sea"
    if config.map.origin is None:
        return judge(name, found)
    north, east, down = np.round(Origin(*config.map.origin).to_ned(lat, lon, sea_m + config.geoid_m)) + 0.0  # no -0
    away = f"; from [map] origin {north:.0f} m north, {east:.0f} m east, {0.0 - down:.0f} m up: ODOMETRY is shifted by that"
    return judge(name, found + away)


def _px4(answers: Answers, config: Config) -> Iterator[Check]:
    p = _Parameters(answers.parameters)
    if config.mavlink.odometry:
        yield p.check("EKF2_EV_CTRL", p.get("EKF2_EV_CTRL") >= 1, "set 15: position, velocity and yaw; 0 uses none of it")
        if config.autopilot.own_gnss and config.autopilot.own_gnss_quality != "radius":
            advice = "set 1: quality 0 is what rests on its own GNSS, and would count twice"
            yield p.check("EKF2_EV_QMIN", p.get("EKF2_EV_QMIN") >= 1, advice)
        yield p.check("EKF2_EV_DELAY", p.get("EKF2_EV_DELAY") <= _SLOW_MS, "set 0: ODOMETRY is propagated to now", warn=True)
        yield p.check("EKF2_EV_NOISE_MD", p.get("EKF2_EV_NOISE_MD") == 0, "set 0: our covariance is used", warn=True)
        if p.get("EKF2_EV_CTRL") >= _YAW:
            advice = "set 0.003: 0.1 is a sigma of 18 degrees, and steps of the velocity turn the heading by 20"
            yield p.check("EKF2_EVA_NOISE", p.get("EKF2_EVA_NOISE") <= _EVA_NOISE, advice, warn=True)
    if config.mavlink.fixes:
        yield p.check("EKF2_AGP0_CTRL", p.get("EKF2_AGP0_CTRL") >= 1, "set 1: fixes are not used otherwise", warn=True)
        good = p.get("EKF2_AGP0_ID") == config.mavlink.slot
        yield p.check("EKF2_AGP0_ID", good, f"set {config.mavlink.slot}, [mavlink] slot", warn=True)
