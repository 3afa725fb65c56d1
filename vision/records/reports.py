"""Result of a pair: fix or reason, a line per region or landmark."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from models import so3
from models.messages import Array, LandmarkFix, Quat, VisionReport, vec3
from models.prior import Prior
from vision.pose.pose import PoseEstimate, difference

INSIDE_9999: Final = (15.137, 18.421, 21.108, 23.513, 25.745, 27.856)  # chi-square of 1 to 6, 99.99 %


class RegionReport(msgspec.Struct, frozen=True):
    """Result of a region (segment) or landmark (predict).

    state: identified, open, not_in_map, not_measured, cut_off, not_found;  landmark: identity or best candidate
    bbox: u0, v0, width, height, rectified (segment) or raw (predict)
    """

    state: str
    bbox: tuple[int, int, int, int]
    landmark: str = ""
    similarity: float = 0.0
    posterior: float = 0.0
    candidates: int = 0
    reason: str = ""
    path: str = "segment"


@dataclass(frozen=True, slots=True)
class Result:
    """fix or None, its report, a line per region, and the pose fit."""

    fix: LandmarkFix | None
    report: VisionReport
    regions: tuple[RegionReport, ...] = ()
    pose: PoseEstimate | None = None


def fix_of(pose: PoseEstimate, t_ns: int, landmarks: tuple[str, ...], similarity: float) -> LandmarkFix:
    """The message of a pose."""
    return LandmarkFix(
        t_ns=t_ns,
        arrived_ns=t_ns,
        p_n=vec3(pose.p_n),
        q_nb_wxyz=_quat(so3.from_matrix(np.ascontiguousarray(pose.R_nb))),
        covariance=pose.covariance,
        covariance_common=pose.covariance_common,
        landmarks=landmarks,
        similarity=similarity,
        residual_px=pose.residual_px,
        landmark_errors=pose.landmark_errors,
        covariance_rig=pose.covariance_rig,
        directions=pose.directions,
        readings=pose.readings,
    )


def nothing(t_ns: int, outcome: str, detail: str, regions: int = 0) -> Result:
    """No fix and no candidate."""
    return Result(None, VisionReport(t_ns, t_ns, outcome, detail.removesuffix("; "), regions))


def report_of(
    t_ns: int, outcome: str, detail: str, reports: Sequence[RegionReport], residual_px: float = float("nan")
) -> VisionReport:
    """The report message."""
    candidates = [r for r in reports if r.candidates > 0]
    return VisionReport(
        t_ns, t_ns, outcome, detail.removesuffix("; "), len(reports), len(candidates), tuple(r.landmark for r in candidates),
        tuple(r.similarity for r in candidates), residual_px,
    )  # fmt: skip


def with_regions(result: Result, regions: Sequence[RegionReport]) -> Result:
    """The result plus the lines of regions that were not identified."""
    said, r = (*result.regions, *(one for one in regions if one.state != "identified")), result.report
    return replace(result, regions=said, report=report_of(r.t_ns, r.outcome, r.detail, said, r.residual_px))


def pose_flaw(pose: PoseEstimate, prior: Prior) -> str:
    """Why a fitted pose is rejected."""
    total = pose.covariance + pose.covariance_common
    if not (np.isfinite(pose.p_n).all() and np.isfinite(pose.R_nb).all() and np.isfinite(total).all()):
        return "the fit is not finite"
    if float(np.linalg.eigvalsh(total)[0]) <= 0.0:
        return "the fit's covariance is not positive definite"
    if pose.directions is None or pose.readings is None:
        distance = squared_distance(pose.p_n, pose.R_nb, prior.p_n, prior.q_nb_wxyz, prior.covariance + total)
        limit = INSIDE_9999[5]
    else:
        D = pose.directions
        nu = D @ difference(pose.p_n, pose.R_nb, prior.p_n, prior.q_nb_wxyz) + pose.readings
        distance = float(nu @ np.linalg.solve(D @ (prior.covariance + total) @ D.T, nu))
        limit = INSIDE_9999[len(nu) - 1]
    if distance > limit:
        return f"the prior excludes it: squared distance {distance:.0f}, 99.99 % are below {limit:.0f}"
    return ""


def squared_distance(p_n: Array, R_nb: Array, of_p_n: Array, of_q: Array, covariance: Array) -> float:
    """Squared Mahalanobis distance of two poses."""
    e = difference(p_n, R_nb, of_p_n, of_q)
    return float(e @ np.linalg.solve(covariance, e))


def _quat(q: Array) -> Quat:
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])
