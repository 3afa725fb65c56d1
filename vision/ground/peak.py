"""Position by the search's peak alone, where blocks disagree (docs/vision_orthophoto.md).

    C = (1 - rho^2) / rho  K^-1  c  +  (f q)^2 I,   K = -d^2 rho / d(north, east)^2
    s = m unevenness (1 - rho)^4

C: of an image; s: common to all, shadows and leaning objects, m = 1 / (2 tan 15 deg). A peak, or a line (ridge.py), needs other
evidence (orientation.py, recognisers.py).
"""

import math
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.image import GroundImage
from vision.ground.search import Peak
from vision.pose.point_pose import PointConfig, Points, fit_points
from vision.pose.pose import PoseEstimate

_OPEN_M: Final = 1e4  # 1 sigma along a line of positions: nothing is known
_POINT = PointConfig(least=1, freedom=1e3, expected=1.0)  # one point is not used for its own noise


class PeakConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a peak counts, when its edges lie the same way (oriented), and c, f, m."""

    ratio: Annotated[float, Meta(ge=1, description="height of the peak over that of the second")] = 1.25
    correlation: Annotated[float, Meta(ge=0, le=1, description="at the peak")] = 0.2
    deviations: Annotated[float, Meta(ge=0, description="correlation at the peak over the scatter at other positions")] = 5.0
    oriented: Annotated[float, Meta(ge=0, le=1, description="coefficient of the edges' directions, as other evidence")] = 0.2
    oriented_correlation: Annotated[float, Meta(ge=0, le=1, description="at the peak, with that evidence")] = 0.28
    oriented_deviations: Annotated[
        float, Meta(ge=0, description="correlation over the scatter, with that evidence: streets raise the scatter along them")
    ] = 3.0
    noise: Annotated[float, Meta(gt=0, description="c: variance of the correlation's noise")] = 2e-3
    step: Annotated[float, Meta(gt=0, description="f: of the search's step, 1 sigma")] = 0.3
    moved: Annotated[float, Meta(ge=0, description="m: of the unevenness, 1 sigma, where nothing correlates")] = 1.9


def peak_flaw(peak: Peak, config: PeakConfig) -> str:
    """Why a peak makes no fix, or empty."""
    if peak.curvature is None:
        return "the search has no single peak inside its area"
    if peak.ratio < config.ratio:
        return f"the peak is {peak.ratio:.2f} times the second, needed {config.ratio:g}"
    if peak.correlation < config.correlation:
        return f"correlation {peak.correlation:.2f}, needed {config.correlation:g}"
    least = config.oriented_deviations if edges_agree(peak, config) else config.deviations
    if peak.deviations < least:
        return f"the peak is {peak.deviations:.1f} standard deviations of other positions high, needed {least:g}"
    return ""


def edges_agree(peak: Peak, config: PeakConfig) -> bool:
    """Whether edges lie the same way at the peak."""
    return peak.correlation >= config.oriented_correlation and peak.oriented >= config.oriented


def fit_peak(
    rig: StereoRig, prior: Prior, map_image: GroundImage, peak: Peak, config: PeakConfig | None = None
) -> PoseEstimate | str:
    """Pose by prior and peak, two directions measured, or why none."""
    config = config or PeakConfig()
    if flaw := peak_flaw(peak, config):
        return flaw
    assert peak.curvature is not None
    rho = peak.correlation
    C = config.noise * (1.0 - rho**2) / rho * np.linalg.inv(peak.curvature) + (config.step * peak.q) ** 2 * np.eye(2)
    return _fit(rig, prior, map_image, (peak.seen_n, peak.shown_n, C), _moved(peak, map_image, config))


def fit_ridge(
    rig: StereoRig, prior: Prior, map_image: GroundImage, peak: Peak, config: PeakConfig | None = None
) -> PoseEstimate | str:
    """Pose by prior and line, measured across only, or why none."""
    config = config or PeakConfig()
    ridge = peak.ridge
    if ridge is None:
        return "the best positions are no line"
    if not edges_agree(peak, config):
        return "the edges lie another way"
    if ridge.deviations < config.oriented_deviations:
        return f"the line is {ridge.deviations:.1f} standard deviations high, needed {config.oriented_deviations:g}"
    across = np.outer(ridge.normal_n, ridge.normal_n)
    C = (ridge.sigma_m**2 + (config.step * peak.q) ** 2) * across + _OPEN_M**2 * (np.eye(2) - across)
    return _fit(rig, prior, map_image, (ridge.seen_n, ridge.shown_n, C), _moved(peak, map_image, config))


def _moved(peak: Peak, map_image: GroundImage, config: PeakConfig) -> float:
    return config.moved * map_image.heights.unevenness_m * (1.0 - peak.correlation) ** 4


def _fit(
    rig: StereoRig, prior: Prior, map_image: GroundImage, found: tuple[Array, Array, Array], moved_m: float
) -> PoseEstimate | str:
    seen_n, shown_n, C = found
    p_nc, R_nc = rig.camera_pose(prior.p_n, prior.R_nb)
    x_c = ((seen_n - p_nc) @ R_nc)[None]
    J = (rig.left.project_jacobian(x_c)[0] @ R_nc.T)[:, :2]
    point = Points(map_image.points(shown_n[None]), rig.left.project(x_c), (J @ C @ J.T)[None])
    horizontal, height, slope = map_image.shared_sigma
    fit = fit_points(rig, point, (prior.p_n, prior.R_nb), prior, (math.hypot(horizontal, moved_m), height, slope), _POINT)
    return fit if isinstance(fit, str) else fit.estimate
