"""From a place that the coarse search found to a fit of the outlines, with what does not belong left out.

fit -> last look (recheck.py) -> landmarks that are not where the fit says, or a picture that contradicts the other, go -> again
"""

import math

import msgspec
import numpy as np

from models.camera import StereoRig
from models.landmarks import Landmark
from models.messages import Array
from vision.catalogue import Beliefs
from vision.coarse import Candidate
from vision.identify import Prior
from vision.motion import straight
from vision.pictures import Pictures
from vision.pose import NoPose, Pose, PoseConfig, PoseEstimate, estimate_pose
from vision.recheck import Recheck, recheck
from vision.rectify import Image
from vision.reports import pose_flaw
from vision.sensitivity import Eye, eyes
from vision.verify import Fitted, VerifyConfig

Views = tuple[Image | None, Image | None]
_MOST_FITS = 3
_GONE = Beliefs().gone_fraction
_WINDOW_PX = (8, 8)  # about a place the search found, good to a few px; wider ones meet feet of walls and rims of shadows
_PAIR_PX = 0.8  # shifts between the two pictures that do no harm
_STANDS = math.log(0.99 / 0.01) + math.log(_GONE / (1.0 - _GONE))  # likelihood ratio from which a landmark stands for 99 %
_LEAST_SHARE = 0.5  # of what the better picture shows


class Fitter:
    """Fits outlines in the pictures of one rig."""

    def __init__(self, rig: StereoRig, pose: PoseConfig, config: VerifyConfig, most: int) -> None:
        self._rig, self._config, self._most = rig, config, most
        self._wide = msgspec.structs.replace(pose, least_edges=3, least_found=0.3, least_fitted=config.weak_found)
        self._pose = msgspec.structs.replace(self._wide, look=msgspec.structs.replace(pose.look, search_px=_WINDOW_PX))
        self._pair_sigma_px = _pair_sigma_px(rig)

    def fit(self, pictures: Pictures, marks: list[Landmark], place: Candidate, prior: Prior) -> Fitted | str:
        """The fit from a place, or why there is none."""
        views: Views = (pictures.left, pictures.right)
        first = self._chosen(place)
        eye, v = eyes(self._rig)[int(pictures.only_right)], self._config
        chosen, remark = first, ""
        for _ in range(_MOST_FITS):
            some = [marks[k] for k in chosen]
            fit = estimate_pose(self._rig, views, some, place.pose, prior, self._pose, place.shift_m[chosen])
            if isinstance(fit, NoPose):
                return f"{remark}{fit.reason} {fit.detail}".strip()
            seen = recheck(self._rig, views, some, fit, self._pose.look)
            off_map = _off_map(some, fit)
            good = [
                k
                for k, share, stands, chi2 in zip(chosen, seen.share, seen.stands, off_map, strict=True)
                if share >= v.landmark_found and stands > _STANDS and chi2 < v.off_map
            ]
            if problem := self._pair_flaw(seen):
                if self._swapped(views, some, place.pose, place.shift_m[chosen], prior):
                    return "left and right picture are swapped"
                views, remark = (pictures.left, None), f"right camera not used: {problem}; "
            elif len(good) < len(chosen):
                if sum(place.length[good]) < v.remain * sum(place.length[first]):
                    return f"{len(first) - len(good)} of {len(first)} landmarks are not where the others say"
                chosen = good
            elif (far := _moved_px(eye, some, place, chosen, fit)) > v.moved_px * self._rig.left.width / 640.0 and _whole(fit):
                return f"the fit left the place that was found by {far:.0f} px"
            else:
                kept = float(place.length[chosen].sum() / place.length[first].sum())
                found = float(seen.share @ place.length[chosen])
                middles = _middles(eye, marks, (fit.joint_p_n, fit.joint_R_nb), np.zeros_like(place.shift_m))
                return pose_flaw(fit, prior) or Fitted(fit, chosen, remark, kept, min(seen.pictures), found, middles)
        return f"{remark}the landmarks do not agree"

    def _chosen(self, place: Candidate) -> list[int]:
        """The landmarks seen, those with most support, in their order."""
        seen = place.support > self._config.landmark_share * np.maximum(place.length, 1.0)
        order = np.argsort(-np.where(seen, place.support, -1.0), kind="stable")
        return sorted(order[: min(self._most, int(seen.sum()))].tolist())

    def _pair_flaw(self, seen: Recheck) -> str:
        """Why the right picture does not belong to the left one; empty where it does."""
        if len(seen.pictures) == 2 and min(seen.pictures) < _LEAST_SHARE * max(seen.pictures):
            return f"{seen.pictures[0]:.0%} of the outlines found in the left picture, {seen.pictures[1]:.0%} in the right one"
        if seen.apart is None:
            return ""
        du, dv, sigma = seen.apart
        limit = max(_PAIR_PX, 3.0 * self._pair_sigma_px) + 3.0 * sigma
        if abs(dv) > limit:
            return f"rows differ by {dv:+.1f} px: wrong calibration, or pictures not taken together"
        return f"disparities are off by {du:+.1f} px: swapped, moved, or not taken together" if abs(du) > limit else ""

    def _swapped(self, views: Views, marks: list[Landmark], start: Pose, shift_m: Array, prior: Prior) -> bool:
        """Whether the outlines lie in both pictures once they are taken the other way round."""
        fit = estimate_pose(self._rig, views[::-1], marks, start, prior, self._wide, shift_m)  # off by twice the disparity
        return isinstance(fit, PoseEstimate) and not self._pair_flaw(recheck(self._rig, views[::-1], marks, fit, self._pose.look))


def _off_map(marks: list[Landmark], fit: PoseEstimate) -> Array:
    """How far off the map each landmark would have to be: chi-square (L,) of shift, rise and growth."""
    sigma = np.array([(m.sigma_m, m.sigma_m, m.height_sigma_m, m.outline_sigma_m) for m in marks])
    error = fit.shift_m[:, : sigma.shape[1]]
    return np.asarray(np.sum(np.where(sigma > 0.0, error / np.maximum(sigma, 1e-9), 0.0) ** 2, axis=1))


def _pair_sigma_px(rig: StereoRig) -> float:
    """By how much the two pictures may be shifted against each other for all that the calibration knows [px]."""
    turn = 0.0 if rig.covariance_rc is None else float(rig.covariance_rc[3:5, 3:5].diagonal().max()) * rig.left.fy**2
    lenses = sum(float(c.covariance[2:4, 2:4].diagonal().max()) for c in (rig.left, rig.right) if c.covariance is not None)
    return math.sqrt(turn + lenses)


def _moved_px(eye: Eye, marks: list[Landmark], place: Candidate, chosen: list[int], fit: PoseEstimate) -> float:
    """How far the middles of the roofs moved from where the search found them: the median, px."""
    before = _middles(eye, marks, place.pose, place.shift_m[chosen])
    after = _middles(eye, marks, (fit.joint_p_n, fit.joint_R_nb), fit.shift_m)
    return float(np.nanmedian(np.linalg.norm(after - before, axis=1)))


def _whole(fit: PoseEstimate) -> bool:
    """Whether the pictures leave no direction open: along one (a strip) the search finds no place that a fit could leave."""
    return fit.directions is None


def _middles(eye: Eye, marks: list[Landmark], pose: Pose, shift_m: Array) -> Array:
    """Middles of the roofs (L, 2) px, without distortion."""
    p_nk, R_nk = eye.pose(*pose)
    roofs = np.array([(*(np.array(mark.centre_n) + one[:2]), mark.roof_d) for mark, one in zip(marks, shift_m, strict=True)])
    return straight(eye).camera.project((roofs - p_nk) @ R_nk)
