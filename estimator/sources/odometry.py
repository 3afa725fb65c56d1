"""Odometry: motion of the body against a pose kept by the filter (docs/odometry.md).

    dp = (1 + s) R_0^T (p_1 - p_0) + |dp| l + R_0^T d dt + v_p,   dR = R_0^T R_1 exp(v_theta)

s: scale, estimated; l: considered, for lasting_s; d: drift; v: white. Poses become increments in the tracker, by validity,
without their covariance.
"""

import math
from collections.abc import Callable
from dataclasses import replace as widen
from typing import Annotated, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace
from numpy.typing import NDArray

from estimator.sources.base.aid import Aid, Refusal, SlowError, log_false, order
from estimator.sources.base.covariance import covariance_refusal, with_default
from estimator.sources.base.gating import cusum, gate
from estimator.sources.base.machine import CUSUM_SLACK, Phase, SourceState
from estimator.sources.base.rules import RULES, Rules
from models import so3
from models.messages import Array, OdometryDelta, OdometryPose, Reason
from models.relative_pose import RelativePose, between
from models.state import XYZ

_SIX = 6
_NOT_GIVEN_M2, _NOT_GIVEN_RAD2 = 9e4, 10.0
_FASTEST_M_S, _FARTHEST_M = 500.0, 1e7
_CUSUM_LIMIT = 8.0  # sigma
_MOST_ERRORS = 6  # that stay with a rig
_LARGEST_ERROR = 100.0  # m or rad
_FALSE_M, _FALSE_RAD = 1.0, 0.1  # half widths of the box in which a false increment is expected
_SCALE_HOLDS_S, _DRIFTS_S, FADES_S = 600.0, 120.0, 10.0
WRONG_SCALE = 0.3  # 1 sigma of a scale that positions have refuted
DRIFT, DRIFT_M_S = ".drift", 0.01  # of any odometry, and nothing shows it
_USUAL = 3.0  # ratio of the sigmas of two increments of one scene
_NOTHING = 1e-14  # m^2, rad^2: keeps a covariance positive definite
_DISPUTED, _DISPUTED_SIGMA = 3.5, 2.5  # of a sum: two such outliers alike; from then on nothing further off is fused
_CLIP = 3.0  # sigma: a single outlier counts no more in the cumulative sum
_JUMP_M, _JUMP_M_S2 = 0.15, 50.0  # poses that leave a straight line by more than this, or than any vehicle can, have jumped
_SAME_NS = 1_000_000  # stamps of one image, by two messages
WRONG = "its increments are off by more than noise: not used (scale, axes, stamps?)"
_NO_ERRORS: tuple[SlowError, ...] = ()

Row: TypeAlias = Literal["x", "y", "z", "roll", "pitch", "yaw"]
_NAMES: tuple[Row, ...] = ("x", "y", "z", "roll", "pitch", "yaw")
_Rows: TypeAlias = NDArray[np.intp]


class OdometryConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[odometry]: noise and judgement; poses are off without [inputs] odometry."""

    delay_s: Annotated[
        float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much; below 0: the IMU's are")
    ] = 0.0
    interval_s: Annotated[float, Meta(ge=0.02, le=10, description="s: an increment is made of poses at least this far apart")] = (
        0.5
    )
    longest_s: Annotated[float, Meta(ge=0.02, le=60, description="s: an increment over more time than this is not used")] = 3.0
    rows: Annotated[
        tuple[Row, ...],
        Meta(description="of poses, what is measured: x y z forward, right, down, and roll pitch yaw; wheels: x, y and yaw"),
    ] = _NAMES
    position_sigma_m: Annotated[float, Meta(ge=1e-4, le=100, description="m: white error of an increment, at least")] = 0.01
    attitude_sigma_deg: Annotated[float, Meta(ge=1e-3, le=90, description="deg: white error of an increment, at least")] = 0.2
    position_share: Annotated[
        float, Meta(ge=0, le=1, description="white error of an increment as a share of its length, where it reports none")
    ] = 0.025
    noise_scale: Annotated[float, Meta(ge=1e-3, le=1000, description="factor on the standard deviations in an increment")] = 1.0
    lasting_share: Annotated[float, Meta(ge=0, le=1, description="error that lasts, as a share of the length; 0: none")] = 0.008
    lasting_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: for so long it lasts")] = 5.0
    scale_sigma: Annotated[
        float, Meta(ge=0, le=1, description="of the scale, which is estimated; 0: it is right (increments may bring their own)")
    ] = 0.02


class Begins(NamedTuple):
    """Start of an increment `name`; no other of its topic may start before until_ns."""

    until_ns: int
    name: bytes
    epoch: str


class Increment(NamedTuple):
    """End of an increment; reported: covariance (6, 6) of cameras."""

    name: bytes
    z: RelativePose
    reported: Array | None = None


class Posed(NamedTuple):
    """A pose (7,) in the frame `epoch`; since: increment from an earlier pose."""

    pose: Array
    epoch: str
    since: Callable[[Array], tuple[RelativePose, tuple[SlowError, ...]]]
    config: OdometryConfig


class Lost(NamedTuple):
    """The odometry has no pose until until_ns; no increment spans it."""

    until_ns: int


class Kept(NamedTuple):
    """The pose kept for a topic since t_ns, for the increment `name` that ends at until_ns; None where it is lost until then.

    pose: in the odometry's frame; newest: last pose since, time, velocity, m/s.
    """

    t_ns: int
    until_ns: int
    name: bytes
    epoch: str
    pose: Array | None = None
    newest: tuple[int, Array, Array | None] | None = None


class OdometryAid(Aid, frozen=True, eq=False, kw_only=True):
    """An aid about the motion of the body."""

    motion: Begins | Increment | Posed | Lost

    @property
    def is_reported(self) -> bool:
        """See Aid: nothing is decided at an increment's start."""
        return not isinstance(self.motion, Begins)


def increment_aid(delta: OdometryDelta, config: OdometryConfig) -> Aid | Refusal:
    """An increment as a measurement, and its start."""
    dp, q = np.array(delta.dp_b, dtype=float), np.array(delta.dq_wxyz, dtype=float)
    seconds = (delta.t_ns - delta.t0_ns) * 1e-9
    if refusal := _motion_refusal(dp, q, seconds, config):
        return refusal
    q /= np.linalg.norm(q)
    covariance = np.array(delta.covariance, dtype=float, order="C")
    if covariance.shape != (_SIX, _SIX):
        return Refusal(Reason.MALFORMED, "covariance is not 6 x 6")
    rows = _given(covariance)
    if not len(rows):
        return Refusal(Reason.UNSUPPORTED, "no component is given")
    sigmas = _sigmas(config, float(np.linalg.norm(dp)))[rows]
    given, _ = with_default(covariance[np.ix_(rows, rows)] * config.noise_scale**2, sigmas)
    noise = given + np.diag(_sigmas(config, 0.0)[rows] ** 2)
    if refusal := covariance_refusal(noise):
        return refusal
    errors = _rig_errors(delta, config)
    if isinstance(errors, Refusal):
        return errors
    delay_ns = round(config.delay_s * 1e9)
    t0_ns, t_ns, epoch = delta.t0_ns - delay_ns, delta.t_ns - delay_ns, str(delta.epoch)
    place = order(t_ns, "odometry", delta.topic, f"{t0_ns} {epoch}".encode(), dp.tobytes(), q.tobytes(), covariance.tobytes())
    name = place[-1]
    of_cameras = delta.systematic is not None and len(rows) == _SIX
    reported = covariance * config.noise_scale**2 if of_cameras and np.trace(covariance[:XYZ, :XYZ]) > 0.0 else None
    end = Increment(name, RelativePose(dp, q, noise, rows), reported)
    begin = _aid(t0_ns, delta, (t0_ns, "odometry_begin", delta.topic, name), Begins(t_ns, name, epoch), "odometry_begin")
    return _aid(t_ns, delta, place, end, "odometry", (*_lasting(delta.topic, dp, config), *errors), begin, rows)


def odometry_pose_aid(reading: OdometryPose, config: OdometryConfig) -> Aid | Refusal:
    """A pose in the odometry's frame, for increments, or that there is none."""
    t_ns = reading.t_ns - round(config.delay_s * 1e9)
    if reading.is_lost:
        since_ns, lost = t_ns - _SAME_NS, Lost(t_ns + _SAME_NS)
        return _aid(since_ns, reading, order(since_ns, "odometry", reading.topic, b"lost"), lost, "odometry")
    pose = np.array((*reading.p_o, *reading.q_ob_wxyz), dtype=float)
    if refusal := _motion_refusal(pose[:XYZ], pose[XYZ:], None, config):
        return refusal
    pose[XYZ:] /= np.linalg.norm(pose[XYZ:])
    rows = np.array([k for k, name in enumerate(_NAMES) if name in config.rows])

    def since(before: Array) -> tuple[RelativePose, tuple[SlowError, ...]]:
        step = between(before, pose)
        dp = step[:XYZ]
        noise = np.diag(_sigmas(config, float(np.linalg.norm(dp)))[rows] ** 2)
        return RelativePose(dp, step[XYZ:], noise, rows), (
            *_lasting(reading.topic, dp, config),
            *_scale(reading.topic, dp, config),
        )

    place = order(t_ns, "odometry", reading.topic, pose.tobytes(), reading.frame.encode())
    return _aid(t_ns, reading, place, Posed(pose, reading.frame, since, config), "odometry", rows=rows)


def _aid(
    t_ns: int,
    message: OdometryDelta | OdometryPose,
    place: tuple[int, str, str, bytes],
    motion: Begins | Increment | Posed | Lost,
    kind: str,
    errors: tuple[SlowError, ...] = _NO_ERRORS,
    begin: Aid | None = None,
    rows: _Rows | None = None,
) -> OdometryAid:
    z = motion.z if isinstance(motion, Increment) else None
    given = range(_SIX) if rows is None else rows.tolist()
    return OdometryAid(
        t_ns=t_ns,
        arrived_ns=message.arrived_ns,
        topic=message.topic,
        kind=kind,
        order=place,
        rules=RULES["odometry"],
        absolute=False,
        log_false=log_false(RULES["odometry"], [_FALSE_M if k < XYZ else _FALSE_RAD for k in given]),
        measurement=lambda _: z,
        slow_errors=errors,
        begin=begin,
        motion=motion,
    )


def _motion_refusal(p: Array, q: Array, seconds: float | None, config: OdometryConfig) -> Refusal | None:
    if not (np.isfinite(p).all() and np.isfinite(q).all()):
        return Refusal(Reason.NOT_FINITE, "pose")
    norm, length = float(np.linalg.norm(q)), float(np.linalg.norm(p))
    if not math.isclose(norm, 1.0, abs_tol=1e-2):
        return Refusal(Reason.IMPLAUSIBLE, f"quaternion of length {norm:.3g}")
    if seconds is not None and not 0.0 < seconds <= config.longest_s:
        return Refusal(Reason.UNSUPPORTED, f"an increment over {seconds:.3g} s: [odometry] longest_s is {config.longest_s:g}")
    if length > (_FARTHEST_M if seconds is None else _FASTEST_M_S * seconds):
        return Refusal(Reason.IMPLAUSIBLE, f"{length:.3g} m: metres are expected")
    return None


def _given(covariance: Array) -> _Rows:
    variances, largest = covariance.diagonal(), np.repeat((_NOT_GIVEN_M2, _NOT_GIVEN_RAD2), XYZ)
    return np.flatnonzero((variances >= 0.0) & (variances < largest))


def _sigmas(config: OdometryConfig, length_m: float) -> Array:
    position = math.hypot(config.position_sigma_m, config.position_share * length_m)
    return np.repeat((position, math.radians(config.attitude_sigma_deg)), XYZ)


def _lasting(topic: str, dp: Array, config: OdometryConfig) -> tuple[SlowError, ...]:
    if not config.lasting_share:
        return ()
    moved = np.repeat((config.lasting_share * float(np.linalg.norm(dp)), 0.0), XYZ)
    return (SlowError(f"{topic}.lasting", np.eye(_SIX), config.lasting_s, np.diag(moved)),)


def _scale(topic: str, dp: Array, config: OdometryConfig) -> tuple[SlowError, ...]:
    """The estimated scale: dp_measured = (1 + s) dp."""
    if not config.scale_sigma:
        return ()
    variance = np.array([[config.scale_sigma**2]])
    jacobian = np.concatenate((dp, np.zeros(XYZ)))[:, None]
    return (SlowError(scale_block(topic), variance, math.inf, jacobian, variance[0] / _SCALE_HOLDS_S, starts_at_zero=True),)


def _rig_errors(delta: OdometryDelta, config: OdometryConfig) -> tuple[SlowError, ...] | Refusal:
    if delta.systematic is None:
        return _scale(delta.topic, np.array(delta.dp_b), config)
    moved = np.array(delta.systematic, dtype=float, order="C")
    fits = moved.ndim == 2 and moved.shape[0] == _SIX and 1 <= moved.shape[1] <= _MOST_ERRORS
    if not fits or not (np.abs(moved) < _LARGEST_ERROR).all():
        return Refusal(Reason.MALFORMED, "systematic errors")
    one = np.eye(moved.shape[1])
    return (SlowError(f"{delta.topic}.rig", one, math.inf, moved, one.diagonal() / _SCALE_HOLDS_S, starts_at_zero=True),)


def widened(
    aid: OdometryAid, z: RelativePose, reported: Array, spread_m: tuple[float, float]
) -> tuple[OdometryAid, RelativePose, tuple[float, float]]:
    """An increment of cameras, no more certain than recent ones.

    sigma^2 = tr C_p; a, b: smallest and largest recent sigma (spread_m; returned updated):

        C <- f C,   f = (b / sigma)^2,   J_l J_l^T <- J_l J_l^T + f C  where b > 3 a
    """
    sigma_m = math.sqrt(float(np.trace(reported[:XYZ, :XYZ])))
    least_m, most_m = min(spread_m[0], sigma_m), max(spread_m[1], sigma_m)
    factor = (most_m / sigma_m) ** 2
    shared = (factor if most_m > _USUAL * least_m else 0.0) * reported + np.eye(_SIX) * _NOTHING

    def lasting(error: SlowError) -> SlowError:
        if error.block != f"{aid.topic}.lasting":
            return error
        moved = np.asarray(error.jacobian)
        return replace(error, jacobian=np.linalg.cholesky(moved @ moved.T + shared))

    errors = tuple(lasting(error) for error in aid.slow_errors)
    return replace(aid, slow_errors=errors), widen(z, noise=factor * z.noise), (least_m, most_m)


def as_learnt(aid: OdometryAid, z: RelativePose, roots: Array) -> tuple[OdometryAid, RelativePose]:
    """With D R D, and the error that lasts times D; roots: diagonal of D (6,)."""
    block = f"{aid.topic}.lasting"
    errors = tuple(
        replace(e, jacobian=roots[:, None] * np.asarray(e.jacobian)) if e.block == block else e for e in aid.slow_errors
    )
    own = roots[z.rows]
    return replace(aid, slow_errors=errors), widen(z, noise=own[:, None] * z.noise * own)


def spread_at(state: SourceState, t_ns: int) -> tuple[float, float]:
    """spread_m left at t_ns: both fade."""
    faded = math.exp(-max(t_ns - state.last_ns, 0) * 1e-9 / FADES_S)
    least_m, most_m = state.spread_m
    return least_m / faded if faded > 0.0 else math.inf, most_m * faded


def drifting(aid: OdometryAid, origin: Array, seconds: float) -> OdometryAid:
    """With a velocity error d in n (considered); origin: kept pose (7,).

    dp_measured = dp + R_0^T d dt,   sigma_d = DRIFT_M_S in each axis
    """
    moved = np.zeros((_SIX, XYZ))
    moved[:XYZ] = so3.matrix(origin[XYZ:]).T * seconds
    drift = SlowError(drift_block(aid.topic), np.eye(XYZ) * DRIFT_M_S**2, _DRIFTS_S, moved)
    return replace(aid, slow_errors=(*aid.slow_errors, drift))


def drift_block(topic: str) -> str:
    """Name of the block of d."""
    return f"{topic}{DRIFT}"


def scale_block(topic: str) -> str:
    """Name of the block of s."""
    return f"{topic}.scale"


def slow_blocks(topic: str) -> tuple[str, ...]:
    """Error blocks constant within an epoch."""
    return f"{topic}.lasting", scale_block(topic), f"{topic}.rig", drift_block(topic)


def jumped(kept: Kept, t_ns: int, pose: Array) -> tuple[float, Array | None]:
    """Distance from the line through the last two poses [m], 0 if plausible; velocity, m/s."""
    if kept.newest is None or t_ns <= kept.newest[0]:
        return 0.0, None
    since_ns, before, velocity = kept.newest
    dt = (t_ns - since_ns) * 1e-9
    moved = pose[:XYZ] - before[:XYZ]
    off = 0.0 if velocity is None else float(np.linalg.norm(moved - velocity * dt))
    return off if off > _JUMP_M + _JUMP_M_S2 * dt * dt else 0.0, moved / dt


def arrived(state: SourceState, rules: Rules, t_ns: int, *, alone: bool) -> SourceState:
    """An increment arrives; how many a refuted odometry has to agree with follows from how often they come."""
    spread_m, spacing_s = spread_at(state, t_ns), min((t_ns - state.last_ns) * 1e-9, rules.timeout_s)
    return replace(state.arrive(replace(rules, spacing_s=spacing_s), t_ns, alone=alone), spread_m=spread_m)


def may_be_scale(state: SourceState, *, alone: bool) -> bool:
    """For the first time positions refute it, or its translations are no noise, but its rotations are: the scale may be wrong."""
    return not alone and (state.is_refuted or not state.noise.is_noise) and state.noise.may_be_scale


def is_disputed(state: SourceState) -> bool:
    """Increments contradict the estimate alike: no noise."""
    return max(state.sums, default=0.0) > _DISPUTED


def widest(state: SourceState, rules: Rules) -> float:
    """Allowed deviation per component, sigma; less while increments contradict alike."""
    return _DISPUTED_SIGMA if is_disputed(state) else math.sqrt(gate(rules.gate_probability, 1))


def judged(state: SourceState, *, alone: bool, passed: bool, off: Array) -> tuple[SourceState, bool]:
    """off (k,): innovations in sigma. Also whether their sum exceeds its limit."""
    if state.phase is Phase.STARTING:
        return replace(state, passed=state.passed + 1 if passed and not alone else 0), False
    sums = cusum(state.sums, np.clip(off, -_CLIP, _CLIP), np.ones(len(off)), CUSUM_SLACK)
    is_found = max(sums) > _CUSUM_LIMIT
    return replace(state, sums=() if is_found else sums), is_found
