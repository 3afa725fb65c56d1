"""Estimates before the heading is known, and first headings (docs/estimator.md, section 6).

    P = sum_k w_k (P_k + d_k d_k^T),   d_k = x_k (-) x_lead                                      (Bar-Shalom 2001, eq. 1.4.16)

A wrong heading falsely gains information on tilt and accelerometer bias (Huang, Mourikis and Roumeliotis 2010): that bias is
published as unknown, tilt with the levelling variance added, heading sigma x 3, gyro bias sigma x 2.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from estimator.filter.alignment import initialise
from estimator.filter.alignment.initialise import InitialiseConfig, Level
from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Hypotheses, innovation
from estimator.filter.relinearise import Stretch
from estimator.sources.base.aid import Aid
from estimator.sources.base.gating import gate
from models import so3
from models.frames import GRAVITY
from models.measurements import Heading, Measurement, Pose, Position, Velocity
from models.messages import Array
from models.state import E, X, local

_WRONG_SENSORS = 0.02  # share of magnetometers and antennas whose heading is false
_MARGIN = 3.0  # ln: by which the headings without the sensor must be better
_KNOWN = math.radians(1.5)
_AGREE = 0.9999  # share of right sensors that agree with the motion
_LIKELY = -2.2  # ln: 1 in 10
_DIFFERING = 3  # readings in a row: no noise
_REFUTED = 3  # positions in a row that nobody at rest foresees
_SLOWEST_M_S = 1.0  # whoever is slower may be pushed in any direction
_SHARPEST = 0.35  # rad: a course that is less well known than this is none


def widen_unaligned(cov: Array, bank: Hypotheses, config: InitialiseConfig) -> None:
    """P (15, 15) of all headings together, in place, as published before alignment."""
    down_b = so3.matrix(bank.lead.x[X.Q])[2]
    heading = float(down_b @ cov[E.THETA, E.THETA] @ down_b)
    more = min(8.0 * heading, max(initialise.NO_HEADING**2 - heading, 0.0))
    _widen(cov, down_b, more, math.atan(config.accel_bias_sigma / GRAVITY) ** 2, config.accel_bias_sigma**2)


_T, _G, _A, _N = E.THETA.start, E.BG.start, E.BA.start, E.SIZE  # compiled code reads plain integers


@njit(cache=True, error_model="numpy")
def _widen(cov: Array, down_b: Array, heading: float, tilt: float, accel_bias: float) -> None:
    """P (15, 15), in place: heading and tilt variances added, gyro bias variance x 4, accel_bias replaced."""
    for i in range(3):
        for j in range(3):
            cov[_T + i, _T + j] += heading * (down_b[i] * down_b[j])
            cov[_G + i, _G + j] *= 4.0
        cov[_T + i, _T + i] += tilt
    for i in range(_A, _N):
        for j in range(_N):
            cov[i, j] = cov[j, i] = 0.0
        cov[i, i] = accel_bias


@dataclass(slots=True)
class Resting:
    """All headings of a vehicle at rest, equally likely: no reading distinguishes them."""

    bank: Hypotheses
    unforeseen: int = 0

    @property
    def is_refuted(self) -> bool:
        """Positions contradict it."""
        return self.unforeseen >= _REFUTED

    def copy(self) -> "Resting":
        """An independent one in the same state."""
        return Resting(self.bank.copy(), self.unforeseen)

    def take(self, aid: Aid, z: Measurement, gyro_b: Array) -> None:
        """Fuse a measurement."""
        seen = initialise.weigh(self.bank, aid, z, gyro_b)
        if aid.absolute:
            foreseen = seen.distance2 <= gate(aid.rules.gate_probability, len(seen.nu))
            self.unforeseen = 0 if foreseen else self.unforeseen + 1
        for member in self.bank.members:
            member.weight = 0.0


@dataclass(slots=True)
class WithoutSensor:
    """A bank without the heading sensor, until motion shows the sensor right.

    Wrong axes or steel cannot be detected at rest. odds: ln of P(without) / P(with), from the share e of wrong sensors:

        odds <- max(odds + ln p(z | without) - ln p(z | with), ln e)

    The bound: a new bank knows less of the velocity. Readings at rest do not count: GNSS noise would refute every sensor. since:
    position of the possible rest, or None.
    """

    bank: Hypotheses
    stretch: Stretch | None
    topic: str
    began_ns: int
    since: Position | Pose | None = None
    odds: float = math.log(_WRONG_SENSORS)
    differing: int = 0  # readings of another heading sensor in a row

    def copy(self) -> "WithoutSensor":
        """An independent one in the same state."""
        return replace(self, bank=self.bank.copy())

    def differs(self, aid: Aid, z: Heading, lead: Eskf) -> bool:
        """Whether another sensor has shown another heading than this one, with this reading."""
        apart = innovation(lead.copy(), aid, z, np.zeros(3)).distance2 > gate(aid.rules.gate_probability, len(z.rows))
        self.differing = self.differing + 1 if apart else 0
        return self.differing >= _DIFFERING

    def take(self, aid: Aid, z: Measurement, gyro_b: Array, trusting: Hypotheses, *, at_rest: bool) -> None:
        """Fuse another sensor's measurement, not yet fused by those who trust this one."""
        if not at_rest:
            gained = initialise.evidence(self.bank, aid, z, gyro_b) - initialise.evidence(trusting, aid, z, gyro_b)
            self.odds = max(self.odds + gained, math.log(_WRONG_SENSORS))
        initialise.weigh(self.bank, aid, z, gyro_b)
        if at_rest:
            for member in self.bank.members:
                member.weight = 0.0
        self.stretch = self.stretch.also(aid, z, gyro_b) if self.stretch is not None else None

    @property
    def is_shown(self) -> bool:
        """The sensor is wrong."""
        return self.odds > _MARGIN

    @property
    def knows_heading(self) -> bool:
        """Motion has shown the attitude as well as a good sensor shows the heading."""
        return float(self.bank.lead.cov.diagonal()[E.THETA].max()) < _KNOWN**2

    def disagrees(self, lead: Eskf) -> bool:
        """Whether its well-known attitude differs from that of the filter with the sensor."""
        without = self.bank.lead
        off = local(lead.x, without.x)[E.THETA]
        cov = lead.cov[E.THETA, E.THETA] + without.cov[E.THETA, E.THETA]
        return bool(off @ np.linalg.solve(cov, off) > gate(_AGREE, 3))

    def mixed(self, cov: Array, x: Array) -> Array:
        """Covariance (15, 15) of x, own covariance cov, where the sensor may be wrong:

        (1 - w) P + w (P_without + d d^T),   d = x_without (-) x,   w = 1 / (1 + exp(-odds)),   once w is larger than 0.1
        """
        if self.odds < _LIKELY:
            return cov
        share, off = 1.0 / (1.0 + math.exp(-self.odds)), local(x, self.bank.lead.x)
        return (1.0 - share) * cov + share * (self.bank.covariance() + np.outer(off, off))


def level_again(lead: Eskf, at: Level, config: InitialiseConfig) -> None:
    """Level again: at rest only the sum of tilt and accelerometer bias is observable.

        P <- M P M^T + N,   M_theta = M_ba = d d^T,   N = blockdiag(.., sigma_tilt^2 (I - d d^T), .., sigma_ba^2 (I - d d^T))

    d: down in the body. In place: tilt levelled, bias across d zero.
    """
    lead.x[X.Q] = so3.from_euler(at.roll, at.pitch, so3.to_euler(lead.x[X.Q])[2])
    down_b = so3.matrix(lead.x[X.Q])[2]
    along = np.outer(down_b, down_b)
    across = np.eye(3) - along
    lead.x[X.BA] = along @ lead.x[X.BA]
    for part, sigma in ((E.THETA, at.tilt_sigma), (E.BA, config.accel_bias_sigma)):
        lead.cov[part] = along @ lead.cov[part]
        lead.cov[:, part] = lead.cov[:, part] @ along
        lead.cov[part, part] += sigma**2 * across


def from_course(z: Velocity, at: Level, config: InitialiseConfig) -> Pose | None:
    """Attitude of a vehicle that moves along its nose; None where it does not.

    psi = atan2(v_e, v_n),   sigma_psi^2 = sigma_course^2 + sigma_v^2 / v^2;  roll and pitch as levelled.
    """
    north, east = z.z_n[:2].tolist()
    speed, sigma_m_s = math.hypot(north, east), math.sqrt(float(z.noise.diagonal()[:2].max()))
    if not config.course_sigma_deg or speed < _SLOWEST_M_S or sigma_m_s > _SHARPEST * speed:
        return None
    yaw_sigma = math.hypot(math.radians(config.course_sigma_deg), sigma_m_s / speed)
    noise = np.diag([at.tilt_sigma**2, at.tilt_sigma**2, yaw_sigma**2])
    return Pose(np.zeros(3), so3.from_euler(at.roll, at.pitch, math.atan2(east, north)), noise, np.arange(3, 6))
