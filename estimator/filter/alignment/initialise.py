"""The first estimate.

A pose fix with attitude starts the filter; a position after levelling by the last second,

      roll = atan2(-f_y, -f_z),  pitch = atan2(f_x, sqrt(f_y^2 + f_z^2))                              (Groves 2013, eq. 5.101)

with eight headings (Gaussian sum; Sorenson and Alspach 1971), not at rest.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import Hypotheses, Hypothesis, innovation, ln_sum
from estimator.sources.base.aid import Aid
from estimator.sources.base.gating import gate
from models import so3
from models.frames import GRAVITY
from models.measurements import Heading, Measurement, Pose, Position
from models.messages import Array
from models.state import E, NavState, X

_HEADINGS = 8
_LEVEL_GATE = 0.9999  # share of true attitudes that pass as level
NO_HEADING = math.pi / math.sqrt(3.0)  # rad: sigma of a heading that may be any
_ANY_HEADING_DEG = 60.0  # a sigma beyond this (104 is that of no knowledge at all) says nothing
LEVEL_NS: Final = 1_000_000_000  # of specific force, used to level
_STILL_ACCEL, _STILL_RATE = 0.3, 0.15  # m/s^2 (deviation), rad/s (mean) below which the vehicle may be at rest
MOVING_TILT: Final = math.radians(12.0)  # sigma of roll and pitch levelled in motion
_TURNED, _SIGMAS = math.radians(30.0), 3.0  # a larger error of a fix' attitude is no noise, nor one of its mounting
_UNKNOWN_SLOW = 9.0  # c: nine tenths of P_ss are left in the end
_BROAD = 1e6  # on the covariance of a pose: it says next to nothing
_HOPELESS = 12.0  # ln: a heading so far behind is dropped


class InitialiseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[initialise]: assumptions and conditions for the first estimate."""

    velocity_sigma_m_s: Annotated[float, Meta(ge=1e-3, le=1000, description="m/s: of the unknown velocity at the start")] = 10.0
    gyro_bias_sigma: Annotated[float, Meta(ge=1e-6, le=10, description="rad/s: of the gyro bias at the start")] = 0.05
    accel_bias_sigma: Annotated[float, Meta(ge=1e-6, le=100, description="m/s^2: of the accelerometer bias at the start")] = 0.3
    still_gyro: Annotated[float, Meta(ge=1e-6, le=10, description="rad/s: deviation below which the vehicle may be at rest")] = (
        0.02
    )
    heading_deg: Annotated[
        float, Meta(ge=0.01, le=180, description="deg: attitude sigma below which the estimate is aligned")
    ] = 5.0
    sensed_heading_deg: Annotated[
        float, Meta(ge=0.01, le=180, description="deg: the same of a heading that a magnetometer or two antennas measure")
    ] = 15.0
    velocity_m_s: Annotated[
        float, Meta(ge=1e-3, le=1000, description="m/s: velocity sigma below which the estimate is aligned")
    ] = 3.0
    publish_after_s: Annotated[
        float, Meta(ge=0, le=1e6, description="s: so long after the first position an estimate is published without a heading")
    ] = 3.0
    course_sigma_deg: Annotated[
        float,
        Meta(
            ge=0, le=60, description="deg: of the nose against the course over ground, to begin the alignment with; 0: not used"
        ),
    ] = 0.0


@dataclass(frozen=True, slots=True)
class Level:
    """Roll, pitch [rad] and sigma, gyro bias and sigma, from a stretch of IMU; still: at rest."""

    t_ns: int
    roll: float
    pitch: float
    tilt_sigma: float
    gyro_bias: Array
    gyro_bias_sigma: float
    still: bool


def level(t_ns: int, u: Array, config: InitialiseConfig, *, may_rest: bool = True) -> Level:
    """Level from samples u (k, 6), gyro then accel, that end at t_ns.

    may_rest: nothing else shows motion.
    """
    gyro, force = u[:, :3], u[:, 3:]
    f = force.mean(axis=0)
    still = may_rest and bool(
        gyro.std(axis=0).max() < config.still_gyro
        and force.std(axis=0).max() < _STILL_ACCEL
        and np.linalg.norm(gyro.mean(axis=0)) < _STILL_RATE
        and abs(np.linalg.norm(f) - GRAVITY) < 3.0 * config.accel_bias_sigma
    )
    tilt_sigma = math.atan(config.accel_bias_sigma / GRAVITY) if still else MOVING_TILT
    # At rest the mean rate is the bias, but a hovering vehicle can look at rest while it turns slowly.
    return Level(
        t_ns=t_ns,
        roll=math.atan2(-f[1], -f[2]),
        pitch=math.atan2(f[0], math.hypot(f[1], f[2])),
        tilt_sigma=tilt_sigma,
        gyro_bias=gyro.mean(axis=0) if still else np.zeros(3),
        gyro_bias_sigma=0.2 * config.gyro_bias_sigma if still else config.gyro_bias_sigma,
        still=still,
    )


def start_from_pose(t_ns: int, z: Pose, constants: Array, config: InitialiseConfig, aid: Aid | None = None) -> Hypotheses:
    """One filter at a pose fix with full attitude, moving or not.

    Where most of the fix's error repeats, a filter whose pose is hardly known fuses it, for the correlations.
    """
    x, cov = _unknown(None, config)
    x[X.P], x[X.Q] = z.z_n, z.q_nb_wxyz
    r_nb = so3.matrix(z.q_nb_wxyz)
    turn = np.eye(6)
    turn[3:, 3:] = r_nb.T  # the fix's attitude error is about n's axes, ours about the body's
    noise = _symmetric(turn @ z.noise @ turn.T)
    cov[E.P, E.P], cov[E.THETA, E.THETA] = noise[:3, :3], noise[3:, 3:]
    cov[E.P, E.THETA], cov[E.THETA, E.P] = noise[:3, 3:], noise[3:, :3]
    begun = Eskf(t_ns, x, cov, constants)
    if aid is not None and _repeats(aid, z, x):
        pose = np.r_[E.P, E.THETA]
        begun.cov[np.ix_(pose, pose)] *= _BROAD
        begun.update(innovation(begun, aid, z, np.zeros(3)))
    return Hypotheses([Hypothesis(begun, fused_ns=t_ns, run=1, run_ns=t_ns)])


def _repeats(aid: Aid, z: Pose, x: Array) -> bool:
    """Whether the errors of position that the next fixes share are larger than those that are new, in any component."""
    moves = [(slow.moves(x), slow.covariance) for slow in aid.slow_errors]
    repeated = [(cov if moved is None else moved @ cov @ moved.T).diagonal() for moved, cov in moves]
    return any(bool((own[:3] > z.noise.diagonal()[:3]).any()) for own in repeated)


def start_from_position(t_ns: int, z: Position | Pose, at: Level, constants: Array, config: InitialiseConfig) -> Hypotheses:
    """Eight levelled filters at a position fix."""
    headings = [2.0 * math.pi * k / _HEADINGS for k in range(_HEADINGS)]
    filters = [_levelled(t_ns, z, at, heading, math.pi / _HEADINGS, constants, config) for heading in headings]
    return Hypotheses([Hypothesis(f, fused_ns=t_ns, run=1, run_ns=t_ns) for f in filters])


def start_from_attitude(
    t_ns: int, z: Position | Pose, at: Level, prior: Pose, constants: Array, config: InitialiseConfig
) -> Hypotheses | None:
    """One filter at a position fix with an outside attitude; None: gravity contradicts."""
    levelled = so3.from_euler(at.roll, at.pitch, so3.to_euler(prior.q_nb_wxyz)[2])
    off = so3.quat_log(so3.multiply(levelled, so3.conjugate(prior.q_nb_wxyz)))[:2]
    tilt = prior.noise[:2, :2] + np.eye(2) * at.tilt_sigma**2
    if off @ np.linalg.solve(tilt, off) > gate(_LEVEL_GATE, 2):
        return None
    antenna_n = so3.matrix(prior.q_nb_wxyz) @ _lever(z)
    moved, noise = np.cross(np.eye(3), antenna_n), np.zeros((6, 6))  # [antenna]x
    noise[:3, 3:], noise[3:, 3:] = moved @ prior.noise, prior.noise
    noise[3:, :3], noise[:3, :3] = noise[:3, 3:].T, z.noise[:3, :3] + moved @ prior.noise @ moved.T
    return start_from_pose(t_ns, Pose(z.z_n - antenna_n, prior.q_nb_wxyz, noise, np.arange(6)), constants, config)


def is_turned(z: Pose, at: Level) -> bool:
    """Whether gravity contradicts the attitude of a fix by more than noise or a mounting error: angle of the two downs."""
    down_fix, down = so3.matrix(z.q_nb_wxyz)[2], so3.matrix(so3.from_euler(at.roll, at.pitch, 0.0))[2]
    return bool(down_fix @ down < math.cos(_TURNED + _SIGMAS * at.tilt_sigma))


def start_from_heading(
    t_ns: int, z: Position | Pose, at: Level, aid: Aid, seen: Heading, constants: Array, config: InitialiseConfig
) -> Hypotheses | None:
    """One levelled filter at a position fix with the measured heading; None where gravity contradicts.

    The measurement is fused, for the correlations with tilt and repeated errors.
    """
    north, east = (so3.matrix(so3.from_euler(at.roll, at.pitch, 0.0)) @ seen.direction_b).tolist()[:2]
    begun = _levelled(t_ns, z, at, seen.azimuth - math.atan2(east, north), NO_HEADING, constants, config)
    if seen.objection(begun.x):
        return None
    begun.update(innovation(begun, aid, seen, np.zeros(3)))
    return Hypotheses([Hypothesis(begun, fused_ns=t_ns, run=1, run_ns=t_ns)])


def agrees(bank: Hypotheses, prior: Pose) -> bool:
    """Whether an outside attitude is near a likely remaining heading."""
    for member in bank.members:
        r_nb = so3.matrix(member.filter.x[X.Q])
        off = so3.quat_log(so3.multiply(so3.conjugate(member.filter.x[X.Q]), prior.q_nb_wxyz))
        cov = member.filter.cov[E.THETA, E.THETA] + r_nb.T @ prior.noise @ r_nb
        if off @ np.linalg.solve(cov, off) - 2.0 * member.weight <= gate(_LEVEL_GATE, 3):
            return True
    return False


def with_slow_errors(aid: Aid, z: Position | Pose) -> Position | Pose:
    """A receiver's position with R + 9 P_ss: its next readings share the slow error s.

    Of prior variance c P_ss, readings leave c / (c + 1) P_ss.
    """
    if isinstance(z, Pose):
        return z
    slow = [e.covariance for e in aid.slow_errors if e.jacobian is None and e.walk is None and len(e.covariance) == len(z.noise)]
    return replace(z, noise=sum((_UNKNOWN_SLOW * covariance for covariance in slow), z.noise))


def heading_unknown(t_ns: int, z: Position | Pose, at: Level, constants: Array, config: InitialiseConfig) -> Eskf:
    """State at a position fix, heading unknown."""
    return _levelled(t_ns, z, at, 0.0, 2.0 * math.pi, constants, config)


def _levelled(
    t_ns: int, z: Position | Pose, at: Level, heading: float, sigma: float, constants: Array, config: InitialiseConfig
) -> Eskf:
    x, cov = _unknown(at, config)
    x[X.Q] = so3.from_euler(at.roll, at.pitch, heading)
    r_nb, lever_b = so3.matrix(x[X.Q]), _lever(z)
    x[X.P], moved = z.z_n - r_nb @ lever_b, np.cross(r_nb, lever_b)  # R [l]x
    about_n = np.diag([at.tilt_sigma**2, at.tilt_sigma**2, sigma**2])
    cov[E.THETA, E.THETA] = _symmetric(r_nb.T @ about_n @ r_nb)
    cov[E.P, E.THETA] = moved @ cov[E.THETA, E.THETA]
    cov[E.THETA, E.P] = cov[E.P, E.THETA].T
    cov[E.P, E.P] = z.noise[:3, :3] + _symmetric(moved @ cov[E.P, E.THETA].T)
    return Eskf(t_ns, x, cov, constants)


def _lever(z: Position | Pose) -> Array:
    """Of what is measured (3,), from the IMU: p = z - R l, dp = R [l]x dtheta."""
    return z.lever_b if isinstance(z, Position) else np.zeros(3)


def _symmetric(cov: Array) -> Array:
    return 0.5 * (cov + cov.T)


def _unknown(at: Level | None, config: InitialiseConfig) -> tuple[Array, Array]:
    bias, sigma = (at.gyro_bias, at.gyro_bias_sigma) if at else (np.zeros(3), config.gyro_bias_sigma)
    zero = np.zeros(3)
    x = NavState(zero, zero, np.array([1.0, 0.0, 0.0, 0.0]), bias, zero).pack()
    cov = np.zeros((E.SIZE, E.SIZE))
    cov[E.V, E.V] = np.eye(3) * config.velocity_sigma_m_s**2
    cov[E.BG, E.BG] = np.eye(3) * sigma**2
    cov[E.BA, E.BA] = np.eye(3) * config.accel_bias_sigma**2
    return x, cov


def evidence(bank: Hypotheses, aid: Aid, z: Measurement, gyro_b: Array) -> float:
    """ln density of a reading: sum of w_k max(N(nu_k; 0, S_k), e u) / sum of w_k."""
    weights = [m.weight for m in bank.members]
    found = [max(innovation(m.filter, aid, z, gyro_b).log_likelihood, aid.log_false) for m in bank.members]
    return ln_sum([w + ll for w, ll in zip(weights, found, strict=True)]) - ln_sum(weights)


def weigh(bank: Hypotheses, aid: Aid, z: Measurement, gyro_b: Array) -> Innovation:
    """Fuse in every heading and weigh it; the innovation of the best."""
    best_seen: Innovation | None = None
    for member in bank.members:
        seen = innovation(member.filter, aid, z, gyro_b)
        # A single wild measurement must not decide the heading.
        member.weight += max(seen.log_likelihood, aid.log_false)
        passed = seen.distance2 <= gate(aid.rules.gate_probability, len(seen.nu))
        if best_seen is None or seen.distance2 < best_seen.distance2:
            best_seen = seen
        if passed or seen.log_likelihood > aid.log_false:
            member.filter.update(seen)
    best = max(m.weight for m in bank.members)
    bank.members = sorted((m for m in bank.members if m.weight > best - _HOPELESS), key=lambda m: -m.weight)
    for member in bank.members:
        member.weight -= best
    assert best_seen is not None
    return best_seen


def aligned(bank: Hypotheses, config: InitialiseConfig, *, sensed: bool = False) -> bool:
    """Attitude (sigma, spread of headings) and velocity are known well enough.

    sensed: the sensor's sigma counts.
    """
    attitude, velocity = _sigmas(bank)
    known = attitude < math.radians(config.heading_deg)
    if sensed and not known:
        tilt, heading = _tilt_and_heading(bank)
        known = tilt < math.radians(config.heading_deg) and heading < math.radians(config.sensed_heading_deg)
    return known and velocity < config.velocity_m_s


def lacks_attitude_alone(bank: Hypotheses, config: InitialiseConfig) -> bool:
    """The velocity is known well enough, the attitude is not."""
    attitude, velocity = _sigmas(bank)
    return attitude >= math.radians(config.heading_deg) and velocity < config.velocity_m_s


def lacks(bank: Hypotheses, config: InitialiseConfig) -> str:
    """What it lacks for alignment, in words."""
    attitude, velocity = _sigmas(bank)
    missing = []
    if attitude > math.radians(_ANY_HEADING_DEG):
        missing.append("heading unknown")
    elif attitude >= math.radians(config.heading_deg):
        missing.append(f"attitude known to {math.degrees(attitude):.1f} deg, {config.heading_deg:g} wanted")
    if velocity >= config.velocity_m_s:
        missing.append(f"velocity known to {velocity:.2f} m/s, {config.velocity_m_s:g} wanted")
    if not missing:
        return "attitude and velocity known, being confirmed"
    return "; ".join(missing) + ": shown by a pose fix with attitude, or by positions while the vehicle accelerates"


def _sigmas(bank: Hypotheses) -> tuple[float, float]:
    cov = np.diag(bank.lead.cov)
    attitude = math.sqrt(float(cov[E.THETA].max()) + _heading_spread(bank) ** 2)
    return attitude, math.sqrt(float(cov[E.V].max()))


def _tilt_and_heading(bank: Hypotheses) -> tuple[float, float]:
    r_nb = so3.matrix(bank.lead.x[X.Q])
    about_n = np.diag(r_nb @ bank.lead.cov[E.THETA, E.THETA] @ r_nb.T)
    return math.sqrt(float(about_n[:2].max())), math.sqrt(float(about_n[2]) + _heading_spread(bank) ** 2)


def _heading_spread(bank: Hypotheses) -> float:
    weights = np.exp([m.weight for m in bank.members])
    yaw = np.array([so3.to_euler(m.filter.x[X.Q])[2] for m in bank.members])
    off = np.angle(np.exp(1j * (yaw - yaw[0])))
    return float(np.sqrt(weights @ off**2 / weights.sum()))
