"""Pose fixes, external or of our landmarks: position and attitude, whole or in part."""

import math
from functools import cache, lru_cache
from itertools import compress
from typing import Annotated, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from estimator.sources.base.aid import FALSE_ATTITUDE_RAD, FALSE_POSITION_M, Aid, Refusal, SlowError, log_false, order
from estimator.sources.base.covariance import covariance_refusal, with_default
from estimator.sources.base.rules import RULES
from models import so3
from models.measurements import Measurement, Pose
from models.messages import Array, LandmarkFix, PoseFix, Quat, Reason
from models.state import XYZ, X

_SIX = 6
_NOT_GIVEN_M2, _NOT_GIVEN_RAD2 = 9e4, 10.0
FARTHEST_M = 1e6
_MOST_LANDMARKS, _MOST_ERRORS = 8, 8  # in one fix, and of each
_LARGEST_ERROR = 300.0  # m or rad
_ROUNDING = 1e-9
_LASTS_S = 3.0  # what the next image shares with this one
_OF_UNIT = 1e-2  # a quaternion's length is within this of one
_NOTHING = np.zeros((6, 6))
_LEVEL = (1.0, 0.0, 0.0, 0.0)
_EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # no rotation from map to base_link, ENU and FLU
_BLANK = (_LEVEL, _EAST, (0.0, 0.0, 0.0, 0.0))
_NO_ACCURACY = "a fix without accuracy: position_sigma_m {:g}, attitude_sigma_deg {:g} taken"
_unit = cache(np.eye)
_ATTITUDES: dict[tuple[bool, ...], str] = {
    (True, True, True): "full",
    (True, True, False): "tilt",
    (False, False, True): "yaw",
    (False, False, False): "none",
}

_Tilt: TypeAlias = Annotated[
    float, Meta(ge=0, le=180, description="deg: how well the frame of the fixes is levelled, where they do not say; 0: exactly")
]
_Mount: TypeAlias = Annotated[
    float,
    Meta(
        ge=0, le=180, description="deg: how well the axes of fixes and IMU agree on the body, where they do not say; 0: exactly"
    ),
]

_PositionSigma: TypeAlias = Annotated[
    float, Meta(ge=1e-3, le=300, description="m: of a position whose variance is 0, which says that it is unknown")
]
_AttitudeSigma: TypeAlias = Annotated[
    float, Meta(ge=0.01, le=180, description="deg: of an attitude whose variance is 0, which says that it is unknown")
]
_Share: TypeAlias = Annotated[
    float,
    Meta(ge=0, lt=1, description="share of the variance that a fix claims for itself that the next still has; 0: found"),
]


class PoseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[pose_fix]: how pose fixes from outside are judged."""

    delay_s: Annotated[float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much")] = 0.0
    delay_sigma_s: Annotated[float, Meta(ge=0, le=1, description="s: sigma of delay_s until the motion shows it")] = 0.02
    position_sigma_m: _PositionSigma = 0.5
    attitude_sigma_deg: _AttitudeSigma = 3.0
    noise_scale: Annotated[float, Meta(ge=1e-3, le=1000, description="factor on the standard deviations that fixes claim")] = 1.0
    tilt_deg: _Tilt = 0.2
    mount_deg: _Mount = 0.17
    lasting_share: _Share = 0.0


class LandmarkFixConfig(PoseConfig, frozen=True, forbid_unknown_fields=True):
    """[landmark_fix]: fixes that report their repeating errors."""

    tilt_deg: _Tilt = 0.0
    mount_deg: _Mount = 0.0
    lasting_share: _Share = 0.6


class Given(NamedTuple):
    """Given components of a fix (x y z rx ry rz).

    mask: (6,); rows: (m,) where true; attitude: None for an unusable part; widths: m half widths of the box of false readings;
    place: whether the position is whole.
    """

    mask: NDArray[np.bool_]
    rows: NDArray[np.intp]
    attitude: str | None
    widths: tuple[float, ...]
    place: bool

    @property
    def whole(self) -> bool:
        """Whether the fix gives all six."""
        return len(self.widths) == _SIX


def given_components(cov: Array) -> Given:
    """Components given by a covariance (6, 6): variance NaN, negative, >= 9e4 m^2 or >= 10 rad^2 is not given."""
    return _given(_bits(cov, 0.0))


@njit(cache=True, error_model="numpy")
def _bits(cov: Array, least: float) -> int:
    """Bit i: variance i is neither below the least nor "not given"."""
    bits = 0
    for i in range(min(_SIX, cov.shape[0])):
        if least <= cov[i, i] < (_NOT_GIVEN_M2 if i < XYZ else _NOT_GIVEN_RAD2):
            bits |= 1 << i
    return bits


@cache
def _given(bits: int) -> Given:
    mask = tuple(bool(bits >> i & 1) for i in range(_SIX))
    widths = [FALSE_POSITION_M] * XYZ + [FALSE_ATTITUDE_RAD] * XYZ
    attitude, known = _ATTITUDES.get(mask[XYZ:]), tuple(compress(widths, mask))
    return Given(np.array(mask), np.flatnonzero(mask), attitude, known, all(mask[:XYZ]))


WHOLE = _given((1 << _SIX) - 1)


def pose_aid(fix: PoseFix | LandmarkFix, config: PoseConfig) -> Aid | Refusal:
    """A fix as a measurement of the components it gives."""
    covariance = np.array(fix.covariance, dtype=float, order="C")  # as compiled code requires it
    if covariance.shape != (6, 6):
        return Refusal(Reason.MALFORMED, "covariance is not 6 x 6")
    if _is_forgotten(fix.q_nb_wxyz, covariance):
        covariance[XYZ:, XYZ:] = np.nan
    given = given_components(covariance)
    if given.attitude is None or not given.widths:
        return Refusal(Reason.UNSUPPORTED, "attitude is given whole, as roll and pitch, as yaw, or not at all")
    noise, sigmas = covariance, _default_sigmas(config.position_sigma_m, config.attitude_sigma_deg)
    if not given.whole:
        noise, sigmas = covariance[np.ix_(given.rows, given.rows)], sigmas[given.rows]
    if config.noise_scale != 1.0:
        noise = noise * config.noise_scale**2
    noise, is_assumed = with_default(noise, sigmas)
    if refusal := covariance_refusal(noise):
        return refusal
    pose = pose_of(fix, given)
    if isinstance(pose, Refusal):
        return pose
    p_n, q = pose
    slow_errors = slow_errors_of(fix, given, config)
    if isinstance(slow_errors, Refusal):
        return slow_errors
    if config.lasting_share > 0 and given.whole:
        slow_errors = (*slow_errors, lasting(fix.topic, noise * config.lasting_share))
        noise = noise * (1.0 - config.lasting_share)
    z: Measurement = Pose(p_n, q, noise, given.rows, given.attitude)
    t_ns = fix.t_ns - round(config.delay_s * 1e9)
    return Aid(
        t_ns=t_ns,
        arrived_ns=fix.arrived_ns,
        topic=fix.topic,
        kind="pose",
        order=order(t_ns, "pose", fix.topic, p_n.tobytes(), q.tobytes(), covariance.tobytes()),
        rules=RULES["pose"],
        absolute=given.place,
        log_false=log_false(RULES["pose"], given.widths),
        measurement=lambda _: z,
        slow_errors=slow_errors,
        assumed=_NO_ACCURACY.format(config.position_sigma_m, config.attitude_sigma_deg) if is_assumed else "",
        delay_sigma_s=config.delay_sigma_s,
    )


def _is_forgotten(q: Quat, covariance: Array) -> bool:
    """An attitude without accuracy as in an unfilled message: none, or along n or map."""
    if covariance[XYZ, XYZ]:  # nearly every call
        return False
    return not covariance[XYZ:, XYZ:].any() and any(math.dist(q, blank) < _ROUNDING for blank in _BLANK)


@cache
def _default_sigmas(position_m: float, attitude_deg: float) -> Array:
    return np.array([position_m] * XYZ + [math.radians(attitude_deg)] * XYZ)


def pose_of(fix: PoseFix | LandmarkFix, given: Given) -> tuple[Array, Array] | Refusal:
    """Position and quaternion of a fix, zero and identity where not given."""
    q = fix.q_nb_wxyz if given.attitude != "none" else _LEVEL
    p_n: tuple[float, ...] = fix.p_n
    if not given.place:
        p_n = tuple(value if is_given else 0.0 for value, is_given in zip(p_n, given.mask.tolist()[:XYZ], strict=True))
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(norm) or not all(map(math.isfinite, p_n)):
        return Refusal(Reason.NOT_FINITE, "pose")
    if max(map(abs, p_n)) > FARTHEST_M:
        return Refusal(Reason.IMPLAUSIBLE, "more than 1000 km from the map's origin")
    if abs(norm - 1.0) > _OF_UNIT:
        return Refusal(Reason.IMPLAUSIBLE, f"quaternion of length {norm:.3g}")
    return np.array(p_n, float), np.array((w / norm, x / norm, y / norm, z / norm))


def slow_errors_of(fix: PoseFix | LandmarkFix, given: Given, config: PoseConfig) -> tuple[SlowError, ...] | Refusal:
    """Systematic errors: of each landmark and the rig, where separated; else all as the topic's own.

    Vectors s of variance 1 that last; the pose moves by L s, L L^T the reported covariance.
    """
    common = fix.covariance_common
    if common is None:
        return () if given.attitude == "none" else _misaligned(fix.topic, config.tilt_deg, config.mount_deg)
    apart = isinstance(fix, LandmarkFix) and fix.landmark_errors is not None and len(fix.landmarks) <= _MOST_LANDMARKS
    rest = fix.covariance_rig if apart and isinstance(fix, LandmarkFix) else common
    rest = _NOTHING if rest is None else np.array(rest, dtype=float, order="C")
    root, largest = symmetric_root(rest) if rest.shape == (6, 6) else (rest, math.nan)
    if math.isnan(largest):
        return Refusal(Reason.NOT_PSD, "common covariance")
    if not (rest_given := _given(_bits(rest, -math.inf))).whole:
        if (given.mask & ~rest_given.mask).any():
            return Refusal(Reason.IMPLAUSIBLE, "common covariance as large as that of what is not given")
        root, largest = symmetric_root(np.where(np.logical_and.outer(rest_given.mask, rest_given.mask), rest, 0.0))
    if not apart or not isinstance(fix, LandmarkFix) or fix.landmark_errors is None:
        return (_steady(fix.topic, root),) if largest > 0.0 else ()
    errors = np.array(fix.landmark_errors, dtype=float, order="C")
    fits = errors.ndim == 3 and errors.shape[:2] == (len(fix.landmarks), 6) and errors.shape[2] <= _MOST_ERRORS
    sizes = _largest(errors).tolist() if fits else [math.inf]
    if max(sizes, default=0.0) >= _LARGEST_ERROR:
        return Refusal(Reason.MALFORMED, "errors of the landmarks")
    each = zip(fix.landmarks, errors, sizes, strict=True)
    blocks = [_steady(f"{fix.topic}/{name}", moved) for name, moved, size in each if size > 0.0]
    if largest > 0.0:
        blocks.append(_on_the_body(f"{fix.topic}.rig", _turned_back(so3.normalise(np.array(fix.q_nb_wxyz)), root)))
    return tuple(blocks)


def _largest(errors: Array) -> Array:
    """Largest magnitude in each errors[j] of (m, 6, k), inf where not finite; (m,)."""
    largest = np.abs(errors).max(axis=(1, 2), initial=0.0)
    return np.where(np.isfinite(largest), largest, math.inf)


@lru_cache(maxsize=64)
def _misaligned(topic: str, tilt_deg: float, mount_deg: float) -> tuple[SlowError, ...]:
    turns = np.eye(6)[:, 3:]
    tilt = _steady(f"{topic}.tilt", turns[:, :2] * math.radians(tilt_deg))
    mount = _on_the_body(f"{topic}.mount", turns * math.radians(mount_deg))
    return (tilt,) * (tilt_deg > 0) + (mount,) * (mount_deg > 0)


def _steady(block: str, moved: Array) -> SlowError:
    return SlowError(block, _unit(moved.shape[1]), math.inf, moved)


def look(topic: str) -> str:
    """Block of the errors that the next fix shares."""
    return f"{topic}.look"


def lasting(topic: str, covariance: Array) -> SlowError:
    """Six errors that the next fix shares (light, texture), covariance (6, 6)."""
    return SlowError(look(topic), _unit(_SIX), _LASTS_S, symmetric_root(covariance)[0])


def _on_the_body(block: str, moved: Array) -> SlowError:
    """k body-fixed errors of variance 1: T moved (6, k), T = diag(R, R)."""
    return SlowError(block, _unit(moved.shape[1]), math.inf, lambda x: _turned(x[X.Q], moved))


def _turned_back(q: Array, root: Array) -> Array:
    """T^T L T (6, 6), T = diag(R, R), of a symmetric L reported at attitude R."""
    back = so3.conjugate(q)
    return _turned(back, _turned(back, root).T.copy())


@njit(cache=True, error_model="numpy")
def _turned(q: Array, m: Array) -> Array:
    """Position and rotation turned: diag(R, R) m, (6, k)."""
    r, out = so3.matrix(q), np.empty_like(m)
    for i in range(3):
        for j in range(m.shape[1]):
            out[i, j] = r[i, 0] * m[0, j] + r[i, 1] * m[1, j] + r[i, 2] * m[2, j]
            out[3 + i, j] = r[i, 0] * m[3, j] + r[i, 1] * m[4, j] + r[i, 2] * m[5, j]
    return out


def symmetric_root(covariance: Array) -> tuple[Array, float]:
    """L = V sqrt(D) V^T, L L^T = C = V D V^T (k, k), and the largest variance, nan for an invalid C.

    Unlike Cholesky's it is continuous in C, which may be singular.
    """
    if not np.isfinite(covariance).all():
        return np.zeros_like(covariance), math.nan
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < -_ROUNDING * max(float(np.trace(covariance)), 0.0):
        return np.zeros_like(covariance), math.nan
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T, dtype=np.float64), float(values[-1])
