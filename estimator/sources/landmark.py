"""Landmark fixes: the whole pose, or the observable combinations of position and attitude.

nu = D (z (-) x) + y,   R = D C D^T,   L <- D L      (C: covariance of the fix, L: how errors that repeat move its pose)
"""

import math

import numpy as np
from msgspec.structs import replace

from estimator.sources.base.aid import FALSE_POSITION_M, Aid, Refusal, SlowError, log_false, order
from estimator.sources.base.covariance import covariance_refusal
from estimator.sources.base.rules import RULES
from estimator.sources.pose import FARTHEST_M, WHOLE, PoseConfig, lasting, pose_aid, pose_of, slow_errors_of
from models.measurements import DIRECTION_SCALE, PartialPose
from models.messages import Array, LandmarkFix, Reason
from models.state import XYZ

_ROUNDING = 1e-6  # of the directions' products
_LARGEST = 1e12  # m^2 or rad^2: no variance is larger
_WHOLE_POSE = 6
_FIXES_PLACE = 0.05  # smallest gain from position to reading with which, the attitude known, the position is known


def landmark_aid(fix: LandmarkFix, config: PoseConfig) -> Aid | Refusal:
    """A fix as a measurement."""
    if fix.directions is None:
        return pose_aid(fix, config)
    directions = np.array(fix.directions, dtype=float, order="C")
    readings = np.zeros(directions.shape[:1]) if fix.readings is None else np.asarray(fix.readings, dtype=float)
    if refusal := _directions_refusal(directions, readings):
        return refusal
    return _partial_aid(fix, directions, readings, config)


def _partial_aid(fix: LandmarkFix, directions: Array, readings: Array, config: PoseConfig) -> Aid | Refusal:
    covariance = np.asarray(fix.covariance, dtype=float)
    if covariance.shape != (6, 6):
        return Refusal(Reason.MALFORMED, "covariance is not 6 x 6")
    if not (np.abs(covariance) < _LARGEST).all():
        return Refusal(Reason.NOT_FINITE, "covariance")
    covariance = covariance * config.noise_scale**2
    noise = directions @ covariance @ directions.T
    if refusal := covariance_refusal(noise):
        return refusal
    pose, slow_errors = pose_of(fix, WHOLE), slow_errors_of(fix, WHOLE, config)
    if isinstance(pose, Refusal):
        return pose
    if isinstance(slow_errors, Refusal):
        return slow_errors
    if config.lasting_share > 0:
        slow_errors = (*slow_errors, lasting(fix.topic, covariance * config.lasting_share))
        noise = noise * (1.0 - config.lasting_share)
    p_n, q = pose
    z = PartialPose(p_n, q, directions, readings, noise)
    content = (p_n.tobytes(), q.tobytes(), covariance.tobytes(), directions.tobytes(), readings.tobytes())
    t_ns = fix.t_ns - round(config.delay_s * 1e9)
    return Aid(
        t_ns=t_ns,
        arrived_ns=fix.arrived_ns,
        topic=fix.topic,
        kind="pose",
        order=order(t_ns, "pose", fix.topic, *content),
        rules=RULES["pose"],
        absolute=_fixes_place(directions),
        log_false=log_false(RULES["pose"], [FALSE_POSITION_M] * len(directions)),
        measurement=lambda _: z,
        slow_errors=tuple(_seen_along(directions, slow) for slow in slow_errors),
        detail=f"{len(directions)} of 6 directions",
        delay_sigma_s=config.delay_sigma_s,
    )


def _directions_refusal(directions: Array, readings: Array) -> Refusal | None:
    if directions.ndim != 2 or directions.shape[1] != 6 or len(directions) > 6:
        return Refusal(Reason.MALFORMED, f"directions of shape {directions.shape}, not (r, 6)")
    if not len(directions):
        return Refusal(Reason.UNSUPPORTED, "no direction was measured")
    if not np.isfinite(directions).all():
        return Refusal(Reason.NOT_FINITE, "directions")
    rows = directions / DIRECTION_SCALE
    if np.abs(rows).max() > 1.0 + _ROUNDING or np.abs(rows @ rows.T - np.eye(len(rows))).max() > _ROUNDING:
        return Refusal(Reason.MALFORMED, "directions are not orthonormal")
    if readings.shape != (len(directions),):
        return Refusal(Reason.MALFORMED, f"{readings.size} readings of {len(directions)} directions")
    if not np.isfinite(readings).all():
        return Refusal(Reason.NOT_FINITE, "readings")
    if np.abs(readings).max() > FARTHEST_M:
        return Refusal(Reason.IMPLAUSIBLE, "readings of more than 1000 km")
    return None


def _fixes_place(directions: Array) -> bool:
    return len(directions) >= 3 and bool(np.linalg.svd(directions[:, :3], compute_uv=False)[-1] > _FIXES_PLACE)


def position_innovation(z: PartialPose, nu: Array, s: Array) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Innovation and sigma of the position, (3,) NED m, of nu (r,), S (r, r); None without a whole position.

    D = R diag(scale) with R R^T = I: where R is square, scale (x_true (-) z) = R^T nu, and positions have the scale 1.
    """
    if len(z.directions) < _WHOLE_POSE:
        return None
    back = z.directions[:, :XYZ].T
    return tuple((back @ nu).tolist()), tuple(map(math.sqrt, (back @ s @ back.T).diagonal().tolist()))


def _seen_along(directions: Array, slow: SlowError) -> SlowError:
    moved = slow.jacobian
    assert moved is not None
    return replace(slow, jacobian=(lambda x: directions @ moved(x)) if callable(moved) else directions @ moved)
