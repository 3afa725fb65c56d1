"""From a search position to a fit.

fit -> final check -> contradicting landmarks or image go -> others searched from the joint pose -> final check
"""

import math
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import Image
from vision.pose.pose import NoPose, Pose, PoseConfig, PoseEstimate, difference, estimate_pose
from vision.pose.sensitivity import Eye, eyes
from vision.predict.coarse_search import Candidate
from vision.predict.final_check import FinalCheck, final_check
from vision.predict.motion import straight
from vision.predict.verify import Fitted, VerifyConfig, position_odds
from vision.records.images import Images
from vision.records.reports import pose_flaw

Views = tuple[Image | None, Image | None]
Mask = NDArray[np.bool_]
_MOST_FITS = 3
_MOST_ALONE = 3  # landmarks from each of which a fit begins
_WINDOW_PX = (8, 8)  # about a position the search found, good to a few px; wider ones meet feet of walls and rims of shadows
_AGAIN_PX = ()  # where a fit was that had wrong landmarks as well: it is good to a pixel
_ALONE_PX = (16, 8)  # about where the others put a landmark: as far as its shift and size may be off the map
_PAIR_PX = 0.8  # shifts between the two images that do no harm
_SURE = math.log(0.99 / 0.01)  # odds from which a landmark stands,
_SURE_HIDDEN = math.log(0.999 / 0.001)  # from which it does though more of it is hidden,
_SURE_ANYHOW = math.log(0.9999 / 0.0001)  # and however little of it the final check finds
_LEAST_SHARE = 0.5  # of what the better image shows
_NO_WORSE = 1.1  # by so much may the position be less sure with more landmarks


@dataclass(frozen=True, slots=True)
class _Start:
    pose: Pose
    shift_m: Array
    chosen: list[int]
    asked: list[int]
    views: Views
    remark: str = ""


class Fitter:
    """Fits outlines in a rig's images; gone: assumed share of vanished landmarks."""

    def __init__(self, rig: StereoRig, pose: PoseConfig, config: VerifyConfig, most: int, gone: float) -> None:
        self._rig, self._config, self._most = rig, config, most
        self._wide = msgspec.structs.replace(pose, least_edges=3, least_found=0.3, least_fitted=config.weak_found)
        self._pose, self._again, self._alone = (
            msgspec.structs.replace(self._wide, observation=msgspec.structs.replace(pose.observation, search_px=window))
            for window in (_WINDOW_PX, _AGAIN_PX, _ALONE_PX)
        )
        self._gone = gone
        self._odds_whole, self._odds_hidden, self._odds_anyhow = (  # ratios
            odds - math.log((1.0 - gone) / gone) for odds in (_SURE, _SURE_HIDDEN, _SURE_ANYHOW)
        )
        self._pair_sigma_px = _pair_sigma_px(rig)

    def fit(
        self, images: Images, marks: list[Landmark], hypothesis: Candidate, prior: Prior, among: Mask | None = None
    ) -> Fitted | str:
        """The fit from a position, or why none; among: landmarks (L,) that may take part."""
        first = [k for k in sorted(self._most_seen(hypothesis)) if among is None or among[k]]
        return self._settled(marks, hypothesis, _start(images, hypothesis, first, first), prior)

    def fit_one(self, images: Images, marks: list[Landmark], hypothesis: Candidate, prior: Prior) -> Fitted | None:
        """The likeliest fit from one landmark, where all together give none."""
        asked = self._most_seen(hypothesis)
        tried = [
            self._settled(marks, hypothesis, _start(images, hypothesis, [k], sorted(asked)), prior) for k in asked[:_MOST_ALONE]
        ]
        fits = [one for one in tried if isinstance(one, Fitted)]
        return max(fits, key=lambda one: one.odds, default=None)

    def joined(self, images: Images, marks: list[Landmark], hypothesis: Candidate, fitted: Fitted, prior: Prior) -> Fitted:
        """The fit with all landmarks it places, or itself; never less certain."""
        views: Views = (images.left, None if fitted.remark else images.right)
        fit, shift_m = fitted.pose, hypothesis.shift_m.copy()
        shift_m[fitted.used] = fit.shift_m
        more, known = [], fit
        for k in sorted(set(np.flatnonzero(self._seen(hypothesis)).tolist()).difference(fitted.used)):
            if (found := self._found(views, marks[k], known)) is not None:
                known, shift_m[k] = found, found.shift_m[0]
                more.append(k)
        if not more:
            return fitted
        here, chosen = (
            replace(hypothesis, p_n=known.joint_p_n, R_nb=known.joint_R_nb, shift_m=shift_m),
            sorted(fitted.used + more),
        )
        start = _Start(here.pose, shift_m, chosen, sorted({*fitted.asked, *more}), views, fitted.remark)
        again = self._settled(marks, here, start, prior)
        if isinstance(again, str) or len(again.used) <= len(fitted.used):
            return fitted
        return again if _sigma_m(again.pose) < _NO_WORSE * _sigma_m(fit) else fitted

    def _found(self, views: Views, mark: Landmark, others: PoseEstimate) -> PoseEstimate | None:
        pose = others.joint_p_n, others.joint_R_nb
        about = Prior(pose[0], so3.from_matrix(pose[1]), others.joint_covariance)
        alone = estimate_pose(self._rig, views, [mark], pose, about, self._alone)
        if isinstance(alone, NoPose):
            return None
        present = self._present([mark], alone, final_check(self._rig, views, [mark], alone, self._alone.observation))
        return alone if present[0] else None

    def _settled(self, marks: list[Landmark], hypothesis: Candidate, start: _Start, prior: Prior) -> Fitted | str:
        eye, v = eyes(self._rig)[int(start.views[0] is None)], self._config
        views, chosen, asked, remark = start.views, start.chosen, start.asked, start.remark
        before: tuple[Pose, Array] | None = None
        for _ in range(_MOST_FITS):
            some = [marks[k] for k in chosen]
            fit = self._estimated(views, some, (start.pose, start.shift_m[chosen]), before, prior)
            if isinstance(fit, NoPose):
                return f"{remark}{fit.reason} {fit.detail}".strip()
            seen = final_check(self._rig, views, some, fit, self._pose.observation)
            good = [k for k, present in zip(chosen, self._present(some, fit, seen), strict=True) if present]
            if problem := self._pair_flaw(seen):
                if self._swapped(views, some, start, chosen, prior):
                    return "left and right image are swapped"
                views, remark, before = (views[0], None), f"right camera not used: {problem}; ", None
            elif len(good) < len(chosen):
                if sum(hypothesis.length[good]) < v.remain * sum(hypothesis.length[start.asked]):
                    return f"{len(start.asked) - len(good)} of {len(start.asked)} landmarks contradict the others"
                unseen = {k for k, share in zip(chosen, seen.share, strict=True) if np.isnan(share)}
                before = (fit.joint_p_n, fit.joint_R_nb), fit.shift_m[np.isin(chosen, good)]
                chosen, asked = good, [k for k in asked if k not in unseen]
            elif (far := _moved_px(eye, some, hypothesis, chosen, fit)) > v.moved_px * self._rig.left.width / 640.0 and _whole(
                fit
            ):
                return f"the fit left the position that was found by {far:.0f} px"
            else:
                kept = float(
                    hypothesis.length[chosen].sum() / hypothesis.length[self._answering(hypothesis, chosen, asked)].sum()
                )
                middles = _middles(eye, marks, (fit.joint_p_n, fit.joint_R_nb), np.zeros_like(hypothesis.shift_m))
                odds = self._odds(views, marks, hypothesis, chosen, fit, seen, prior)
                return pose_flaw(fit, prior) or Fitted(fit, chosen, asked, remark, kept, min(seen.images), middles, odds)
        return f"{remark}the landmarks do not agree"

    def _estimated(
        self, views: Views, marks: list[Landmark], start: tuple[Pose, Array], before: tuple[Pose, Array] | None, prior: Prior
    ) -> PoseEstimate | NoPose:
        if before is not None:
            pose, shift_m = before
            again = estimate_pose(self._rig, views, marks, pose, prior, self._again, shift_m)
            if isinstance(again, PoseEstimate):
                return again
        pose, shift_m = start
        return estimate_pose(self._rig, views, marks, pose, prior, self._pose, shift_m)

    def _most_seen(self, hypothesis: Candidate) -> list[int]:
        order = np.argsort(-np.where(self._seen(hypothesis), hypothesis.support, -1.0), kind="stable")
        return [int(k) for k in order[: min(self._most, int(self._seen(hypothesis).sum()))]]

    def _seen(self, hypothesis: Candidate) -> Mask:
        return np.asarray(hypothesis.support > self._config.landmark_share * np.maximum(hypothesis.length, 1.0))

    def _answering(self, hypothesis: Candidate, chosen: list[int], asked: list[int]) -> list[int]:
        return asked if len(chosen) > 1 else sorted({*asked, *np.flatnonzero(~self._seen(hypothesis)).tolist()})

    def _present(self, marks: list[Landmark], fit: PoseEstimate, seen: FinalCheck) -> Mask:
        v = self._config
        whole = (seen.share >= v.landmark_found) & (seen.present > self._odds_whole)
        hidden = (seen.share >= v.hidden_found) & (seen.present > self._odds_hidden)
        return np.asarray((whole | hidden | (seen.present > self._odds_anyhow)) & (_off_map(marks, fit) < v.off_map))

    def _odds(
        self,
        views: Views,
        marks: list[Landmark],
        hypothesis: Candidate,
        chosen: list[int],
        fit: PoseEstimate,
        seen: FinalCheck,
        prior: Prior,
    ) -> float:
        others = [k for k in np.flatnonzero(hypothesis.length > 0.0).tolist() if k not in chosen]
        some = [marks[k] for k in others]
        as_mapped = replace(fit, shift_m=np.zeros((len(some), fit.shift_m.shape[1])))
        rest = final_check(self._rig, views, some, as_mapped, self._pose.observation).present if some else np.zeros(0)
        off = difference(fit.joint_p_n, fit.joint_R_nb, np.asarray(prior.p_n, float), np.asarray(prior.q_nb_wxyz, float))
        squared = float(off @ prior.information @ off) + float(_off_map([marks[k] for k in chosen], fit).sum())
        covered = seen.covered if len(chosen) == 1 else 0.0  # beside others a cover is not the bare ground
        return position_odds(np.concatenate((seen.present, rest)), self._gone, squared, fit.found, covered)

    def _pair_flaw(self, seen: FinalCheck) -> str:
        if seen.apart is not None:
            du, dv, sigma = seen.apart
            limit = max(_PAIR_PX, 3.0 * self._pair_sigma_px) + 3.0 * sigma
            if abs(dv) > limit:
                return f"rows differ by {dv:+.1f} px: wrong calibration, or images not taken together"
            if abs(du) > limit:
                return f"disparities are off by {du:+.1f} px: swapped, moved, or not taken together"
        if len(seen.images) == 2 and min(seen.images) < _LEAST_SHARE * max(seen.images):
            return f"{seen.images[0]:.0%} of the outlines found in the left image, {seen.images[1]:.0%} in the right one"
        return ""

    def _swapped(self, views: Views, marks: list[Landmark], start: _Start, chosen: list[int], prior: Prior) -> bool:
        shift_m = start.shift_m[chosen]
        fit = estimate_pose(self._rig, views[::-1], marks, start.pose, prior, self._wide, shift_m)  # off by twice the disparity
        return isinstance(fit, PoseEstimate) and not self._pair_flaw(
            final_check(self._rig, views[::-1], marks, fit, self._pose.observation)
        )


def _start(images: Images, hypothesis: Candidate, chosen: list[int], asked: list[int]) -> _Start:
    return _Start(hypothesis.pose, hypothesis.shift_m, chosen, asked, (images.left, images.right))


def _off_map(marks: list[Landmark], fit: PoseEstimate) -> Array:
    sigma = np.array([(m.sigma_m, m.sigma_m, m.height_sigma_m, m.outline_sigma_m) for m in marks])
    error = fit.shift_m[:, : sigma.shape[1]]
    return np.asarray(np.sum(np.where(sigma > 0.0, error / np.maximum(sigma, 1e-9), 0.0) ** 2, axis=1))


def _sigma_m(fit: PoseEstimate) -> float:
    return math.sqrt(float(np.trace(fit.joint_covariance[:3, :3])))


def _pair_sigma_px(rig: StereoRig) -> float:
    turn = 0.0 if rig.covariance_rc is None else float(rig.covariance_rc[3:5, 3:5].diagonal().max()) * rig.left.fy**2
    lenses = sum(float(c.covariance[2:4, 2:4].diagonal().max()) for c in (rig.left, rig.right) if c.covariance is not None)
    return math.sqrt(turn + lenses)


def _moved_px(eye: Eye, marks: list[Landmark], hypothesis: Candidate, chosen: list[int], fit: PoseEstimate) -> float:
    before = _middles(eye, marks, hypothesis.pose, hypothesis.shift_m[chosen])
    after = _middles(eye, marks, (fit.joint_p_n, fit.joint_R_nb), fit.shift_m)
    moved = np.linalg.norm(after - before, axis=1)
    return float(np.median(moved[~np.isnan(moved)]))


def _whole(fit: PoseEstimate) -> bool:
    return fit.directions is None


def _middles(eye: Eye, marks: list[Landmark], pose: Pose, shift_m: Array) -> Array:
    p_nk, R_nk = eye.pose(*pose)
    roofs = np.array([(*(np.array(mark.centre_n) + one[:2]), mark.roof_d) for mark, one in zip(marks, shift_m, strict=True)])
    return straight(eye).camera.project((roofs - p_nk) @ R_nk)
