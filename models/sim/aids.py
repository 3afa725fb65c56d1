"""GNSS and pose fixes with noise, delays, outages, false measurements.

    GNSS:      z = p_n + R_nb l_b + s + n,   v_z = v_n + R_nb (omega_b x l_b) + n_v,   s' = -s/tau + w
    pose fix:  z = p_n + c_p + n_p,          R_z = exp(-c_theta - n_theta) R_nb        (errors about the axes of n)

c: constant for a run (map, rig).
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.frames import Origin
from models.messages import Array, GnssFix, GnssVelocity, PoseFix, Vec3, vec3
from models.sim.ranges import Delay, Interval, NotNegative, Positive, Rate, Share, Sigma3, ascending, between
from models.sim.trajectory import Trajectory

Seconds = NDArray[np.float64]
Stamps = NDArray[np.int64]


class Gnss(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A GNSS receiver; triples: NED.

    slow_sigma_m, slow_tau_s: Gauss-Markov; delay_s: a number or [least, most]; stamp_lag_s: lateness of stamps.
    """

    rate_hz: Rate = 5.0
    sigma_m: Sigma3 = (1.0, 1.0, 1.5)
    velocity_sigma_m_s: Sigma3 = (0.1, 0.1, 0.15)
    slow_sigma_m: NotNegative = 0.0
    slow_tau_s: Positive = 300.0
    delay_s: Delay = 0.0
    stamp_lag_s: NotNegative = 0.0
    antenna_b_m: Vec3 = (0.0, 0.0, 0.0)
    outages_s: tuple[Interval, ...] = ()

    def __post_init__(self) -> None:
        ascending("delay_s", self.delay_s)
        ascending("outages_s", *self.outages_s)


class FalseSpan(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An interval whose pose fixes share one error."""

    start_s: NotNegative
    end_s: NotNegative
    offset_n_m: Vec3 = (0.0, 0.0, 0.0)
    rotation_n_deg: Vec3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        ascending("start_s, end_s", (self.start_s, self.end_s))


class PoseFixes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A source of 6-DoF fixes; triples along n.

    outlier_share: with an extra error within outlier_m, outlier_deg; common_sigma_*: drawn once a run.
    """

    rate_hz: Rate = 2.0
    sigma_m: Sigma3 = (0.15, 0.15, 0.15)
    sigma_deg: Sigma3 = (1.0, 1.0, 1.0)
    delay_s: Delay = 0.0
    outages_s: tuple[Interval, ...] = ()
    outlier_share: Share = 0.0
    outlier_m: Interval = (2.0, 30.0)
    outlier_deg: Interval = (5.0, 60.0)
    common_sigma_m: NotNegative = 0.0
    common_sigma_deg: NotNegative = 0.0
    common_reported: bool = True
    false_spans: tuple[FalseSpan, ...] = ()

    def __post_init__(self) -> None:
        ascending("delay_s", self.delay_s)
        ascending("outages_s", *self.outages_s)
        ascending("outlier_m", self.outlier_m)
        ascending("outlier_deg", self.outlier_deg)


def receive_gnss(
    gnss: Gnss, trajectory: Trajectory, origin: Origin, epoch_ns: int, rng: np.random.Generator
) -> list[GnssFix | GnssVelocity]:
    """Positions and velocities of the receiver, in order of validity."""
    t_s, t_ns = _instants(gnss.rate_hz, trajectory.duration_s, epoch_ns, rng)
    motion = trajectory.at(t_s)
    n, lever_b = len(t_s), np.array(gnss.antenna_b_m)
    p_n = motion.p_n + motion.R_nb @ lever_b + _slow_error(gnss, n, rng) + gnss.sigma_m * rng.standard_normal((n, 3))
    lever_rate_b = np.cross(motion.omega_b, lever_b)
    v_n = motion.v_n + np.einsum("kij,kj->ki", motion.R_nb, lever_rate_b)
    v_n += gnss.velocity_sigma_m_s * rng.standard_normal((n, 3))
    position_covariance = np.diag(np.square(gnss.sigma_m) + gnss.slow_sigma_m**2)
    velocity_covariance = np.diag(np.square(gnss.velocity_sigma_m_s))
    arrived_ns = _arrivals(t_ns, gnss.delay_s, epoch_ns, trajectory.duration_s, rng)
    stamps_ns = t_ns + round(gnss.stamp_lag_s * 1e9)
    messages: list[GnssFix | GnssVelocity] = []
    for k in np.flatnonzero(_received(t_s, gnss.outages_s)):
        stamp, arrived = int(stamps_ns[k]), int(arrived_ns[k])
        messages.append(GnssFix(stamp, arrived, *origin.to_geodetic(p_n[k]), position_covariance))
        messages.append(GnssVelocity(stamp, arrived, vec3(v_n[k]), velocity_covariance))
    return messages


def make_pose_fixes(
    source: PoseFixes, trajectory: Trajectory, epoch_ns: int, rng: np.random.Generator
) -> tuple[list[PoseFix], frozenset[int]]:
    """Fixes in order of validity, and t_ns of the false ones."""
    t_s, t_ns = _instants(source.rate_hz, trajectory.duration_s, epoch_ns, rng)
    motion, n = trajectory.at(t_s), len(t_s)
    common_p = source.common_sigma_m * rng.standard_normal(3)
    common_theta = math.radians(source.common_sigma_deg) * rng.standard_normal(3)
    p_n = motion.p_n + common_p + source.sigma_m * rng.standard_normal((n, 3))
    theta_n = common_theta + np.radians(source.sigma_deg) * rng.standard_normal((n, 3))
    false = _falsify(source, t_s, p_n, theta_n, rng)
    covariance = _pose_covariance(source.sigma_m, source.sigma_deg)
    common = None
    if source.common_reported and (source.common_sigma_m or source.common_sigma_deg):
        common = _pose_covariance((source.common_sigma_m,) * 3, (source.common_sigma_deg,) * 3)
    arrived_ns = _arrivals(t_ns, source.delay_s, epoch_ns, trajectory.duration_s, rng)
    received = np.flatnonzero(_received(t_s, source.outages_s))
    fixes = []
    for k in received:
        w, x, y, z = so3.multiply(so3.quat_exp(-theta_n[k]), motion.q_nb_wxyz[k]).tolist()
        fixes.append(PoseFix(int(t_ns[k]), int(arrived_ns[k]), vec3(p_n[k]), (w, x, y, z), covariance, common))
    return fixes, frozenset(int(t_ns[k]) for k in received if false[k])


def _falsify(source: PoseFixes, t_s: Seconds, p_n: Array, theta_n: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    n = len(t_s)
    false = rng.random(n) < source.outlier_share
    for error, (least, most) in ((p_n, source.outlier_m), (theta_n, np.radians(source.outlier_deg))):
        direction = rng.standard_normal((n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        error[false] += (direction * rng.uniform(least, most, (n, 1)))[false]
    for span in source.false_spans:
        within = (t_s >= span.start_s) & (t_s < span.end_s)
        p_n[within] += span.offset_n_m
        theta_n[within] += np.radians(span.rotation_n_deg)
        false |= within
    return false


def _slow_error(gnss: Gnss, n: int, rng: np.random.Generator) -> Array:
    """A stationary first-order Gauss-Markov sequence at the receiver's rate, (n, 3)."""
    kept = math.exp(-1.0 / (gnss.rate_hz * gnss.slow_tau_s))
    draws = gnss.slow_sigma_m * rng.standard_normal((n, 3))
    draws[1:] *= math.sqrt(1.0 - kept**2)
    for k in range(1, n):
        draws[k] += kept * draws[k - 1]
    return draws


def _pose_covariance(sigma_m: Sigma3, sigma_deg: Sigma3) -> Array:
    return np.diag(np.square([*sigma_m, *np.radians(sigma_deg)]))


def _instants(rate_hz: float, duration_s: float, epoch_ns: int, rng: np.random.Generator) -> tuple[Seconds, Stamps]:
    period_ns = round(1e9 / rate_hz)
    since_ns = np.arange(rng.integers(period_ns), round(duration_s * 1e9), period_ns, dtype=np.int64)
    return np.asarray(since_ns * 1e-9, dtype=np.float64), epoch_ns + since_ns


def _received(t_s: Seconds, outages_s: tuple[Interval, ...]) -> NDArray[np.bool_]:
    lost = np.zeros(len(t_s), dtype=np.bool_)
    for start, end in outages_s:
        lost |= (t_s >= start) & (t_s < end)
    return ~lost


def _arrivals(t_ns: Stamps, delay_s: Delay, epoch_ns: int, duration_s: float, rng: np.random.Generator) -> Stamps:
    delay_ns = np.rint(rng.uniform(*between(delay_s), len(t_ns)) * 1e9).astype(np.int64)
    arrived_ns: Stamps = np.minimum(t_ns + delay_ns, epoch_ns + round(duration_s * 1e9))
    return arrived_ns
