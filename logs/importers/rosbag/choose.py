"""Topics of a bag for each input; doubtful ones are not used."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from logs.importers import sensors
from logs.importers.rosbag.survey import TWIST_STAMPED, Survey
from logs.importers.summary import TopicRow
from logs.store.reader import LogError
from logs.wire import schemas
from logs.wire.receiver import FLAGS
from models.messages import Array

_FUSED: Final = re.compile(r"filter|fused|global_position/global|estimat|ekf|/landfix/")  # NavSatFix that is no receiver's
_RECEIVER: Final = re.compile(r"gps|gnss|fix|navsat|ublox|novatel|septentrio|(^|/)vel$")
_LEFT, _RIGHT = re.compile(r"left|cam_?0|infra1"), re.compile(r"right|cam_?1|infra2")
_POSES: Final = (schemas.ODOMETRY, schemas.POSE_FIX, schemas.POSE)
_LEAN: Final = 0.85  # share of the mean specific force along an axis: within 32 degrees
_FEW_HZ: Final = 45.0
_FRD: Final = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Choice:
    """rows: of all topics; axes: "flu" or "frd"; mounting_deg: roll, pitch; notes."""

    rows: list[TopicRow]
    axes: str
    mounting_deg: tuple[float, float]
    notes: list[str]

    @property
    def inputs(self) -> dict[str, list[str]]:
        """[inputs]: key -> topics."""
        keys: dict[str, list[str]] = {}
        for row in self.rows:
            if row.use:
                keys.setdefault(row.use, []).append(row.topic)
        return keys

    @property
    def offered(self) -> list[str]:
        """Comment lines for the configuration: unused topics, with their key where one may take them."""
        lines = []
        for row in (row for row in self.rows if row.copied and not row.use):
            before, _, after = row.remark.removeprefix("in the log; ").partition("[inputs] ")
            key, _, where = after.partition(" ")
            lines.append(f'# {key} = "{row.topic}"  # {before.rstrip(": ")}{where}' if key else f"# {row.topic}: {before}")
        return lines


def choose(found: Mapping[str, Survey], others: Mapping[str, str], wanted_imu: str = "") -> Choice:
    """found: surveyed; others: unread. Raises LogError without an IMU."""
    notes: list[str] = []
    uses: dict[str, tuple[str, str]] = {}  # topic -> input, remark
    imu, mean_frd = _imu(found, wanted_imu, uses, notes)
    axes, mounting_deg = _mounting(imu, mean_frd, notes)
    _gnss(found, uses)
    for topic, s in found.items():
        if topic not in uses:
            uses[topic] = _other(topic, s)
    rows = [_row(topic, s, imu, *uses[topic]) for topic, s in found.items()]
    rows += [TopicRow(topic, schema, 0, 0.0, remark="not read: its type is unknown here") for topic, schema in others.items()]
    return Choice(sorted(rows, key=lambda row: (not row.use, not row.copied, row.topic)), axes, mounting_deg, notes)


def _row(topic: str, s: Survey, imu: str, use: str, remark: str) -> TopicRow:
    copied = bool(use) or s.schema in _POSES or (s.schema == schemas.IMU and topic != imu) or remark.startswith("in the log")
    return TopicRow(topic, s.schema, s.messages, s.rate_hz, use, remark, copied)


def _imu(found: Mapping[str, Survey], wanted: str, uses: dict[str, tuple[str, str]], notes: list[str]) -> tuple[str, Array]:
    usable: dict[str, Array] = {}
    for topic, s in found.items():
        if s.schema != schemas.IMU:
            continue
        rows = s.rows
        try:
            sensors.check_imu(rows[:, :3] * _FRD, rows[:, 3:6] * _FRD, topic)
        except LogError as error:
            uses[topic] = "", str(error).removeprefix(f"{topic}: ")
            continue
        usable[topic] = rows[np.isfinite(rows).all(axis=1)]
        uses[topic] = "", "in the log; another IMU is used: choose with --imu"
    if wanted and wanted not in usable:
        raise LogError(f"--imu {wanted}: {uses.get(wanted, ('', 'no topic of sensor_msgs/msg/Imu'))[1]}")
    if not usable:
        why = "; ".join(f"{topic}: {remark}" for topic, (_, remark) in uses.items()) or "no topic of type sensor_msgs/msg/Imu"
        raise LogError(f"no IMU in it ({why}); record the IMU driver's topic with rates and accelerations")
    imu = wanted or max(usable, key=lambda topic: found[topic].rate_hz)
    uses[imu] = "imu", ""
    if found[imu].rate_hz < _FEW_HZ:
        notes.append(f"{imu}: {found[imu].rate_hz:.1f} samples a second are few: record 50 or more")
    return imu, usable[imu][:, 3:6].mean(axis=0)


def _mounting(imu: str, mean: Array, notes: list[str]) -> tuple[str, tuple[float, float]]:
    """Axes, roll and pitch [deg] of the IMU from mean specific force f in FLU, to right angles.

    down d = -f / |f| in FRD:  roll = atan2(d_y, d_z),  pitch = atan2(-d_x, sqrt(d_y^2 + d_z^2))
    """
    share = mean / float(np.linalg.norm(mean))
    if share[2] > _LEAN:
        return "flu", (0.0, 0.0)
    if share[2] < -_LEAN:
        notes.append(f'{imu}: z points down: axes = "frd"')
        return "frd", (0.0, 0.0)
    force = ", ".join(f"{x:.1f}" for x in mean)
    if np.abs(share).max() < _LEAN:
        notes.append(f"{imu}: the mean specific force is ({force}) m/s^2, along no axis: set [imu] mounting_rpy_deg")
        return "flu", (0.0, 0.0)
    x, y, z = -share * _FRD
    roll, pitch = np.rad2deg([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))])
    mounting = (90.0 * round(roll / 90.0) if abs(x) < _LEAN else 0.0, 90.0 * round(pitch / 90.0))
    notes.append(
        f"{imu}: the mean specific force is ({force}) m/s^2: mounting_rpy_deg = [{mounting[0]:g}, {mounting[1]:g}, 0] stands it "
        "upright; its yaw in the body does not show, set it; leave it out with poses of the IMU's own axes, as of most VIOs"
    )
    return "flu", mounting


def _gnss(found: Mapping[str, Survey], uses: dict[str, tuple[str, str]]) -> None:
    places: dict[str, set[tuple[float, float]]] = {}
    candidates = [topic for topic, s in found.items() if s.schema == schemas.NAV_SAT_FIX]
    for topic in sorted(candidates, key=lambda t: -found[t].messages):
        rows = found[topic].rows
        fixes = {(lat, lon) for status, lat, lon, _ in rows if status >= 0 and np.isfinite(lat + lon) and (lat or lon)}
        twin = next((t for t, known in places.items() if len(fixes & known) > 0.5 * len(fixes)), "")
        if not fixes:
            uses[topic] = "", "no message of it has a fix"
        elif _FUSED.search(topic.lower()):
            uses[topic] = "", "in the log; by its name the output of a filter, no receiver"
        elif twin:
            uses[topic] = "", f"in the log; repeats the fixes of {twin}"
        else:
            uses[topic], places[topic] = ("gnss", ""), fixes


def _other(topic: str, s: Survey) -> tuple[str, str]:
    values = np.linalg.norm(s.rows, axis=1) if s.values and s.values[0] else np.empty(0)
    usual = float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else np.nan
    match s.schema:
        case schemas.TWIST | "geometry_msgs/msg/TwistStamped":
            if _RECEIVER.search(topic.lower()):
                return "gnss_velocity", "east, north, up" + (", without covariance" if s.schema == TWIST_STAMPED else "")
            if s.schema == TWIST_STAMPED:
                return "", "not copied: no receiver's by its name"
            return "", "in the log; if it is along the body's axes: [inputs] velocity_body"
        case schemas.PRESSURE:
            return ("baro", "") if 3e4 < usual < 1.1e5 else ("", f"in the log; {usual:.4g} is no pressure of the air in Pa")
        case schemas.MAGNETIC_FIELD:
            return ("magnetometer", "") if 15e-6 < usual < 90e-6 else ("", f"in the log; {usual:.3g} T is not the Earth's field")
        case schemas.RANGE:
            return "", "in the log; if it points down: [inputs] range"
        case schemas.ODOMETRY:
            return "", "in the log; [inputs] odometry where it is wheels or VIO, or a reference: evaluate --truth"
        case schemas.ISAAC_STATUS | schemas.ZED_STATUS:
            key = "isaac_status" if s.schema == schemas.ISAAC_STATUS else "zed_status"
            return "", f"in the log; [inputs] {key} where its odometry is used"
        case schemas.POSE_FIX:
            return "", "in the log; [inputs] pose_fix where it is absolute, or a reference: evaluate --truth"
        case schemas.POSE:
            return "", "in the log; a reference: evaluate --truth"
        case schemas.IMAGE | schemas.COMPRESSED_IMAGE:
            if _LEFT.search(topic.lower()):
                return "left_image", ""
            return ("right_image", "") if _RIGHT.search(topic.lower()) else ("", "not copied: neither left nor right by its name")
        case schema if schema in FLAGS.values():
            return "", "its flags are in the fixes of its namespace"
        case _:
            return "", "not copied"
