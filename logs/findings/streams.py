"""Streams for the causes: stamps, arrivals, values by topic."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.messages import (
    Array,
    AttitudePrior,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Input,
    LandmarkFix,
    OdometryPose,
    PoseFix,
    Reading,
)

IMU, FIX, VELOCITY, POSE, ODOMETRY, ATTITUDE = "imu", "gnss", "gnss_velocity", "pose_fix", "odometry", "attitude"
TURNING: tuple[str, ...] = (POSE, ODOMETRY, ATTITUDE)  # their last four values are a quaternion q_nb or q_ob

_NOT_GIVEN_RAD2, _NO_TURN = 10.0, (0.0, 0.0, 0.0, 0.0)  # a variance of so much or more gives nothing


class Cause(NamedTuple):
    """A stream's fault; since_s: arrival clock; advice: remedy; unfit: useless as IMU."""

    what: str
    since_s: float
    advice: str
    unfit: bool = False


class Finding(msgspec.Struct, frozen=True):
    """who: topic at fault; since_s: after the first arrival; advice: remedy; unfit: no navigation possible."""

    who: str
    what: str
    since_s: float
    advice: str
    unfit: bool = False

    def __str__(self) -> str:
        return f"{self.who} since {self.since_s:.1f} s: {self.what}; {self.advice}"


def together(findings: Iterable[Finding]) -> list[Finding]:
    """Those of several topics with one cause at one time are one, such as of an autopilot's three IMUs."""
    found: dict[tuple[str, str, str], Finding] = {}
    for finding in findings:
        key = finding.what, f"{finding.since_s:.1f}", finding.advice
        before = found.get(key)
        found[key] = msgspec.structs.replace(before, who=f"{before.who}, {finding.who}") if before else finding
    return list(found.values())


class Stream(NamedTuple):
    """A topic's messages by arrival: stamps, arrivals (n,) [s], values (n, k) by `row`."""

    kind: str
    t_s: Array
    arrived_s: Array
    values: Array

    def in_order(self) -> "Stream":
        """Rows with finite values by distinct stamps."""
        rows = np.flatnonzero(np.isfinite(self.values).all(axis=1))
        t_s, first = np.unique(self.t_s[rows], return_index=True)
        rows = rows[first]
        return Stream(self.kind, t_s, self.arrived_s[rows], self.values[rows])

    def arrival_at(self, t_s: float) -> float:
        """Arrival of the message stamped nearest to t_s."""
        return float(self.arrived_s[int(np.argmin(np.abs(self.t_s - t_s)))])


Streams: TypeAlias = Mapping[str, Stream]


def row(message: Input) -> tuple[str, tuple[float, ...]] | None:
    """Kind and values: gyro, accel; lat, lon, alt, sigma; v_n; p, q (0: not given); q; a reading's."""
    match message:
        case ImuSample():
            return IMU, (*message.gyro_b, *message.accel_b)
        case GnssFix() if message.status >= 0:
            variance = 0.0 if message.covariance_n is None else float(message.covariance_n[0, 0] + message.covariance_n[1, 1])
            return FIX, (message.lat_deg, message.lon_deg, message.alt_m, variance**0.5 if variance > 0.0 else 0.0)
        case GnssVelocity():
            return VELOCITY, message.v_n
        case PoseFix() | LandmarkFix():
            given = bool((np.diagonal(message.covariance)[3:] < _NOT_GIVEN_RAD2).all())
            return POSE, (*message.p_n, *(message.q_nb_wxyz if given else _NO_TURN))
        case OdometryPose() if not message.is_lost:
            return ODOMETRY, (*message.p_o, *message.q_ob_wxyz)
        case AttitudePrior():
            return ATTITUDE, message.q_nb_wxyz
        case Reading():
            return message.kind, message.values
    return None


def runs(same: NDArray[np.bool_]) -> NDArray[np.intp]:
    """First and last row (m, 2) of runs equal to the row before; same (n - 1,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    return edges.reshape(-1, 2)
