"""One view and its fix: what was drawn, how far off the fix is, and how far by its own account."""

import msgspec
import numpy as np

from benchmarks.fixes.single_fix_views import View
from models import so3
from models.messages import Array
from vision.pose.pose import PoseEstimate, difference

BAND = (0.7, 1.5)  # what the mean squared Mahalanobis distance per degree of freedom should be in
WRONG_M, WRONG_CHI2 = 3.0, 21.11  # 99.99 % of 3 degrees of freedom


class Outcome(msgspec.Struct, frozen=True):
    """One view and its fix.

    error_m, bound_m: of the position, prior and images together; position, pose: squared Mahalanobis distances of that
    posterior over 3 and 6; alone: per direction, of the images without the prior; wrong: off by more than 3 m and outside its
    own 99.99 % ellipse. name: what was tried; number: of the view; share: of the outlines in view; at_once: from the first pair.
    """

    height_m: float
    tilt_deg: float
    marks: int
    roof: str
    map_sigma_m: float
    take: str
    reason: str  # empty: a fix
    error_m: float = 0.0
    bound_m: float = 0.0
    position: float = 0.0
    pose: float = 0.0
    alone: float = 0.0
    wrong: bool = False
    name: str = ""
    number: int = 0
    share: float = 1.0
    at_once: bool = True


def outcome_of(view: View, fit: PoseEstimate | None, reason: str) -> Outcome:
    """Compared with the truth; reason: why there is no fit."""
    cell = view.cell
    what = (cell.height_m, cell.tilt_deg, cell.marks, cell.roof, cell.map_sigma_m, cell.take)
    if fit is None:
        return Outcome(*what, reason)
    joint = _error(view, fit.joint_p_n, fit.joint_R_nb)
    position, error_m = _squared(joint[:3], fit.joint_covariance[:3, :3]), float(np.linalg.norm(joint[:3]))
    return Outcome(
        *what, "", error_m, 0.0, position / 3.0, _squared(joint, fit.joint_covariance) / 6.0, _alone(view, fit),
        error_m > WRONG_M and position > WRONG_CHI2,
    )  # fmt: skip


def _error(view: View, p_n: Array, R_nb: Array) -> Array:
    return difference(view.p_n, view.R_nb, p_n, so3.from_matrix(np.ascontiguousarray(R_nb)))


def _alone(view: View, fit: PoseEstimate) -> float:
    """Squared Mahalanobis distance of the images' own reading, per direction."""
    error, covariance = _error(view, fit.p_n, fit.R_nb), fit.covariance + fit.covariance_common
    if fit.directions is not None and fit.readings is not None:
        error, covariance = fit.directions @ error - fit.readings, fit.directions @ covariance @ fit.directions.T
    return _squared(error, covariance) / len(error)


def _squared(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error))
