"""Pose fixes, from outside or from our own landmarks: position and attitude of the body on the map, whole or in part."""

import math
from functools import cache
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from estimator.sources.source import (
    FALSE_ATTITUDE_RAD,
    FALSE_POSITION_M,
    Aid,
    Refusal,
    SlowError,
    SourceRules,
    covariance_refusal,
    log_false,
    order,
)
from models import so3
from models.measurements import Measurement, Pose
from models.messages import Array, LandmarkFix, PoseFix, Reason
from models.state import X

_NOT_GIVEN = np.array([9e4] * 3 + [10.0] * 3)  # m^2, rad^2
FARTHEST_M = 1e6
_MOST_LANDMARKS, _MOST_ERRORS = 8, 8  # in one fix, and of each
_LARGEST_ERROR = 300.0  # m or rad
_ROUNDING = 1e-9
_ATTITUDES = {(True, True, True): "full", (True, True, False): "tilt", (False, False, True): "yaw", (False, False, False): "none"}

_Tilt: TypeAlias = Annotated[
    float, Meta(ge=0, description="deg: how well the frame of the fixes is levelled, where they do not say; 0: exactly")
]


_Share: TypeAlias = Annotated[
    float, Meta(ge=0, lt=1, description="share of the variance that a fix claims for itself that the next one still has")
]


class PoseConfig(SourceRules, frozen=True, forbid_unknown_fields=True):
    """[pose_fix]: how pose fixes from outside are judged."""

    noise_scale: Annotated[float, Meta(gt=0, description="factor on the standard deviations that fixes claim")] = 1.0
    tilt_deg: _Tilt = 0.2
    lasting_share: _Share = 0.0
    lasting_s: Annotated[float, Meta(gt=0, description="s: for so long it lasts")] = 3.0


class LandmarkFixConfig(PoseConfig, frozen=True, forbid_unknown_fields=True):
    """[landmark_fix]: our own fixes say which of their errors repeat."""

    tilt_deg: _Tilt = 0.0
    lasting_share: _Share = 0.6


def given_components(cov: Array) -> NDArray[np.bool_]:
    """Which of (x y z rx ry rz) a fix gives: a variance that is NaN, negative, >= 9e4 m^2 or >= 10 rad^2 says "not given"."""
    variance = np.diag(cov)
    given: NDArray[np.bool_] = (variance >= 0) & (variance < _NOT_GIVEN)
    return given


def pose_aid(fix: PoseFix | LandmarkFix, config: PoseConfig) -> Aid | Refusal:
    """A fix as a measurement of the components it gives."""
    covariance = np.asarray(fix.covariance, dtype=float)
    if covariance.shape != (6, 6):
        return Refusal(Reason.MALFORMED, "covariance is not 6 x 6")
    given = given_components(covariance)
    attitude = _ATTITUDES.get(tuple(given.tolist()[3:]))
    rows = np.flatnonzero(given)
    if attitude is None or not len(rows):
        return Refusal(Reason.UNSUPPORTED, "attitude is given whole, as roll and pitch, as yaw, or not at all")
    noise = (covariance if given.all() else covariance[np.ix_(rows, rows)]) * config.noise_scale**2
    if refusal := covariance_refusal(noise):
        return refusal
    pose = pose_of(fix, given, with_attitude=attitude != "none")
    if isinstance(pose, Refusal):
        return pose
    p_n, q = pose
    slow_errors = slow_errors_of(fix, given, config)
    if isinstance(slow_errors, Refusal):
        return slow_errors
    if config.lasting_share > 0 and given.all():
        slow_errors = (*slow_errors, lasting(fix.topic, noise, config))
        noise = noise * (1.0 - config.lasting_share)
    z: Measurement = Pose(p_n, q, noise, rows, attitude)
    widths = [FALSE_POSITION_M if row < 3 else FALSE_ATTITUDE_RAD for row in rows]
    return Aid(
        t_ns=fix.t_ns,
        arrived_ns=fix.arrived_ns,
        topic=fix.topic,
        kind="pose",
        order=order(fix.t_ns, "pose", fix.topic, p_n.tobytes(), q.tobytes(), covariance.tobytes()),
        rules=config,
        absolute=bool(given[:3].all()),
        log_false=log_false(config, widths),
        measurement=lambda _: z,
        slow_errors=slow_errors,
    )


def pose_of(fix: PoseFix | LandmarkFix, given: NDArray[np.bool_], *, with_attitude: bool) -> tuple[Array, Array] | Refusal:
    """Position and unit quaternion of a fix, zero and identity where they are not given."""
    p_n, q = np.where(given[:3], fix.p_n, 0.0), fix.q_nb_wxyz if with_attitude else (1.0, 0.0, 0.0, 0.0)
    norm = math.hypot(*q)
    if not np.isfinite(p_n).all() or not math.isfinite(norm):
        return Refusal(Reason.NOT_FINITE, "pose")
    if np.abs(p_n).max() > FARTHEST_M:
        return Refusal(Reason.IMPLAUSIBLE, "more than 1000 km from the map's origin")
    if not math.isclose(norm, 1.0, abs_tol=1e-2):
        return Refusal(Reason.IMPLAUSIBLE, f"quaternion of length {norm:.3g}")
    return p_n, np.array(q) / norm


def slow_errors_of(fix: PoseFix | LandmarkFix, given: NDArray[np.bool_], config: PoseConfig) -> tuple[SlowError, ...] | Refusal:
    """What repeats: errors of each landmark and of the rig, where a fix tells them apart; else all of it as one, the topic's own.

    Each is a vector of variance 1 that stays, and the fix says how it is moved by it: L s, L L^T the covariance that it tells.
    """
    common = fix.covariance_common
    if common is None:
        return _tilted(fix.topic, config.tilt_deg) if config.tilt_deg > 0 else ()
    apart = isinstance(fix, LandmarkFix) and fix.landmark_errors is not None and len(fix.landmarks) <= _MOST_LANDMARKS
    rest = fix.covariance_rig if apart and isinstance(fix, LandmarkFix) else common
    rest = np.zeros((6, 6)) if rest is None else np.asarray(rest, dtype=float)
    if rest.shape != (6, 6) or not np.isfinite(rest).all() or np.linalg.eigvalsh(rest)[0] < -_ROUNDING * max(np.trace(rest), 0.0):
        return Refusal(Reason.NOT_PSD, "common covariance")
    unknown = np.diag(rest) >= _NOT_GIVEN
    if (unknown & given).any():
        return Refusal(Reason.IMPLAUSIBLE, "common covariance as large as that of what is not given")
    rest = np.where(unknown[:, None] | unknown, 0.0, rest)
    if not apart or not isinstance(fix, LandmarkFix) or fix.landmark_errors is None:
        return (_steady(fix.topic, _root(rest)),) if rest.any() else ()
    errors = fix.landmark_errors
    fits = errors.ndim == 3 and errors.shape[:2] == (len(fix.landmarks), 6) and errors.shape[2] <= _MOST_ERRORS
    if not fits or not np.abs(errors).max(initial=0.0) < _LARGEST_ERROR:
        return Refusal(Reason.MALFORMED, "errors of the landmarks")
    blocks = [_steady(f"{fix.topic}/{name}", moved) for name, moved in zip(fix.landmarks, errors, strict=True) if moved.any()]
    if rest.any():
        blocks.append(_on_the_body(f"{fix.topic}.rig", rest, np.array(fix.q_nb_wxyz)))
    return tuple(blocks)


@cache
def _tilted(topic: str, tilt_deg: float) -> tuple[SlowError, ...]:
    """The frame of the fixes is level but for this, about both horizontal axes."""
    return (_steady(f"{topic}.tilt", np.eye(6)[:, 3:5] * math.radians(tilt_deg)),)


def _steady(block: str, moved: Array) -> SlowError:
    """k errors of variance 1 that move the pose by `moved` (6, k)."""
    return SlowError(block, np.eye(moved.shape[1]), math.inf, moved)


def lasting(topic: str, covariance: Array, config: PoseConfig) -> SlowError:
    """Six errors that the next fix still has: light and texture of the same edges; covariance (6, 6): the fix's own."""
    root = _root(covariance * config.lasting_share)
    return SlowError(f"{topic}.look", np.eye(6), config.lasting_s, root)


def _on_the_body(block: str, covariance: Array, q_nb: Array) -> SlowError:
    """Six errors of what is mounted on the body: they turn with it."""
    still = _turn(so3.matrix(so3.normalise(q_nb))).T
    root = _root(still @ covariance @ still.T)
    return SlowError(block, np.eye(6), math.inf, lambda x: _turn(so3.matrix(x[X.Q])) @ root)


def _turn(R: Array) -> Array:
    """Position and rotation turned, (6, 6)."""
    turned = np.zeros((6, 6))
    turned[:3, :3], turned[3:, 3:] = R, R
    return turned


def _root(covariance: Array) -> Array:
    """The symmetric L with L L^T = C: unlike Cholesky's it changes little when C does, and C may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T, dtype=np.float64)
