"""Pose fixes, from outside or from our own landmarks: position and attitude of the body on the map, whole or in part."""

import math
from typing import Annotated

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

_NOT_GIVEN_M2, _NOT_GIVEN_RAD2 = 9e4, 10.0
_FARTHEST_M = 1e6
_PERMANENT_S = 1e9  # time constant of an error that does not change
_ATTITUDES = {(True, True, True): "full", (True, True, False): "tilt", (False, False, True): "yaw", (False, False, False): "none"}


class PoseConfig(SourceRules, frozen=True, forbid_unknown_fields=True):
    """[pose_fix], [landmark_fix]: how pose fixes from outside, and those of our own landmarks, are judged."""

    noise_scale: Annotated[float, Meta(gt=0, description="factor on the standard deviations that fixes claim")] = 1.0
    tilt_deg: Annotated[
        float, Meta(ge=0, description="deg: how well the frame of the fixes is levelled, where they do not say; 0: exactly")
    ] = 0.2


LANDMARKS = PoseConfig(tilt_deg=0.0)  # our own: they say which of their errors repeat


def given_components(cov: Array) -> NDArray[np.bool_]:
    """Which of (x y z rx ry rz) a fix gives: a variance that is NaN, negative, >= 9e4 m^2 or >= 10 rad^2 says "not given"."""
    variance = np.diag(cov)
    limit = np.array([_NOT_GIVEN_M2] * 3 + [_NOT_GIVEN_RAD2] * 3)
    given: NDArray[np.bool_] = (variance >= 0) & (variance < limit)
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
    p_n, q = np.array(fix.p_n), np.array(fix.q_nb_wxyz)
    if not np.isfinite(p_n[given[:3]]).all() or (attitude != "none" and not np.isfinite(q).all()):
        return Refusal(Reason.NOT_FINITE, "pose")
    if np.abs(p_n[given[:3]]).max(initial=0.0) > _FARTHEST_M:
        return Refusal(Reason.IMPLAUSIBLE, "more than 1000 km from the map's origin")
    norm = math.hypot(*q.tolist()) if attitude != "none" else 1.0
    if not math.isclose(norm, 1.0, abs_tol=1e-2):
        return Refusal(Reason.IMPLAUSIBLE, f"quaternion of length {norm:.3g}")
    p_n, q = np.where(given[:3], p_n, 0.0), (q / norm if attitude != "none" else np.array([1.0, 0.0, 0.0, 0.0]))
    common = fix.covariance_common
    if common is None and config.tilt_deg > 0:
        common = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]) * math.radians(config.tilt_deg) ** 2
    if common is not None and (common.shape != (6, 6) or not np.isfinite(common).all() or np.linalg.eigvalsh(common)[0] < 0):
        return Refusal(Reason.NOT_PSD, "common covariance")
    z: Measurement = Pose(p_n, so3.normalise(q), noise, rows, attitude)
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
        slow_error=SlowError(fix.topic, common, _PERMANENT_S) if common is not None and common.any() else None,
    )
