"""A shift of the whole map, common to all its fixes.

    P_map = P + C,    C = diag(s_h^2, s_h^2, s_v^2, 0, 0, 0)        (s: common_sigma_m, horizontal and vertical)

P_map: prior in map coordinates.
"""

from dataclasses import replace

import msgspec
import numpy as np

from models.messages import Array, LandmarkFix
from models.prior import Prior

WHOLE_MAP = "(the map)"  # among the landmarks of a fix: the error that they share


def on_map(prior: Prior, common_sigma_m: tuple[float, float]) -> Prior:
    """A prior on Earth as a prior in the map's coordinates."""
    horizontal, vertical = common_sigma_m
    return replace(prior, covariance=prior.covariance + np.diag([horizontal, horizontal, vertical, 0.0, 0.0, 0.0]) ** 2)


def with_map_error(fix: LandmarkFix, common_sigma_m: tuple[float, float]) -> LandmarkFix:
    """The fix with the map's common error, horizontal and vertical sigma."""
    if not any(common_sigma_m):
        return fix
    sigma = np.array([common_sigma_m[0], common_sigma_m[0], common_sigma_m[1]])
    moved = np.vstack((np.diag(sigma), np.zeros((3, 3))))
    before = np.zeros((6, 6)) if fix.covariance_common is None else fix.covariance_common
    errors = None if fix.landmark_errors is None else _joined(fix.landmark_errors, moved)
    return msgspec.structs.replace(
        fix,
        covariance_common=before + moved @ moved.T,
        landmarks=fix.landmarks if errors is None else (*fix.landmarks, WHOLE_MAP),
        landmark_errors=errors,
    )


def _joined(errors: Array, moved: Array) -> Array:
    width = max(errors.shape[2], moved.shape[1])
    joined = np.zeros((len(errors) + 1, 6, width))
    joined[:-1, :, : errors.shape[2]] = errors
    joined[-1, :, : moved.shape[1]] = moved
    return joined
