"""Predict and verify: the main path in flight.

prior -> coarse_search.py -> edges along normals, Gauss-Newton (fit.py) -> verify.py
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.outline.detail import as_seen
from vision.outline.visibility import Prisms
from vision.pose import small_landmarks
from vision.pose.pose import PoseConfig, PoseEstimate, difference
from vision.pose.sensitivity import Eye, eyes
from vision.predict import verify
from vision.predict.coarse_search import Candidate, CoarseConfig, Search, limit_px
from vision.predict.fit import Fitter
from vision.predict.motion import Motion, motion, roofs_in_view, straight
from vision.predict.verify import Evidence, Fitted, Grade, VerifyConfig, Waiting
from vision.records.images import Images
from vision.records.reports import RegionReport, Result, fix_of, report_of

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
PATH = "predict"
_BEYOND = 1.5  # of the limit: 2 sigma of the shift (86 %) are searched; where the position lies farther off nothing is found
_TURNED_BEYOND = 1.2  # of the turns searched: the last ones are unlikely
_MOST_STEPS = 12  # positions that may be fitted beside a position
_DISTANCES = (-2.0, -1.0, 1.0, 2.0)  # standard deviations of the prior, from which a position that is not sure is fitted as well


class PredictConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """most_voting, most_fitted: landmarks, most in view first; most_together: as one pattern."""

    coarse: CoarseConfig = CoarseConfig()
    verify: VerifyConfig = VerifyConfig()
    most_voting: int = 12
    most_fitted: int = 6
    most_together: int = 40


class _Refused(NamedTuple):
    outcome: str
    detail: str


class _Decided(NamedTuple):
    hypothesis: Candidate
    fitted: Fitted
    grade: Grade
    reason: str
    rival: float


class PredictPath:
    """Images of one rig, searched near the prior."""

    def __init__(self, rig: StereoRig, config: PredictConfig, pose: PoseConfig, gone: float, *, alone: bool = True) -> None:
        self._rig, self._config = rig, config
        self._fitter = Fitter(rig, pose, config.verify, config.most_fitted, gone)
        self._waiting = Waiting(config.verify)
        self._alone = alone

    def moves(
        self, images: Images, near: Sequence[Landmark], prior: Prior, most: int | None = None
    ) -> tuple[list[Landmark], Motion] | None:
        """Landmarks that may be in view and their motion by the prior, or None."""
        eye = self._eye(images)
        marks = _in_view(eye, near, prior, self._limit_px(eye), most or self._config.most_voting)
        move = motion(eye, marks, prior) if marks else None
        return None if move is None else (marks, move)

    def narrow(self, images: Images, move: Motion, share: float = _BEYOND) -> bool:
        """Whether 3 sigma of shift and turn lie within `share` of the search's limits."""
        return not self.too_wide(images, move, share)

    def too_wide(self, images: Images, move: Motion, share: float = _BEYOND) -> str:
        """Which part of the prior is too wide, and what would do; empty for none."""
        c, sigmas = self._config.coarse, self._config.coarse.sigmas
        turn, most_turn = sigmas * move.turn_rad, _TURNED_BEYOND * math.radians(c.turn_deg)
        if turn > most_turn:
            allowed = math.degrees(most_turn) / sigmas
            return f"heading open by {math.degrees(move.turn_rad):.1f} deg (1 sigma), searched up to {allowed:.1f}"
        shift, most_shift = sigmas * move.shift_px, share * self._limit_px(self._eye(images))
        if shift > most_shift:
            return f"position and tilt open by {move.shift_px:.0f} px (1 sigma), searched up to {most_shift / sigmas:.0f}"
        return ""

    def locate(self, images: Images, marks: list[Landmark], move: Motion, t_ns: int, prior: Prior) -> Result:
        """Fix or reason, within what `move` allows."""
        eye, candidates = self._eye(images), self._candidates(images, marks, move)
        found = self._decide(images, marks, candidates, prior)
        hypothesis = found.hypothesis if isinstance(found, _Decided) else candidates[0] if candidates else None
        found = self._confirmed(found, marks, t_ns, prior) if isinstance(found, _Decided) else found
        if isinstance(found, _Refused):
            said = [] if hypothesis is None else _reports(eye, marks, hypothesis, self._trusted(hypothesis))
            if found.outcome != "waiting":
                self._waiting.nothing(t_ns)
            report = report_of(t_ns, found.outcome, f"{images.remark}predicted: {found.detail}", said)
            return Result(None, report, tuple(said))
        self._waiting.fixed(found.fitted, t_ns, prior)
        fit, names = found.fitted.pose, tuple(marks[k].id for k in found.fitted.used)
        said = [_settled(one, names) for one in _reports(eye, marks, _as_fitted(found), self._trusted(found.hypothesis))]
        used = f"{len(names)} of {len(said)} landmarks used, next position {found.rival:.0%} as good"
        detail = f"{images.remark}{found.fitted.remark}predicted: {used}"
        fix = fix_of(fit, t_ns, names, fit.found)
        return Result(fix, report_of(t_ns, "fixed", detail, said, fit.residual_px), tuple(said), fit)

    def stands_out(self, images: Images, near: Sequence[Landmark], here: PoseEstimate, steps: Array, prior: Prior) -> bool:
        """Whether a position is decidedly likelier than those at steps (S, 3)."""
        if len(steps) > _MOST_STEPS:
            return False
        eye, v = self._eye(images), self._config.verify
        p_0, q_0 = np.asarray(prior.p_n, float), np.asarray(prior.q_nb_wxyz, float)
        R_nb, q_nb = here.joint_R_nb, so3.from_matrix(here.joint_R_nb)
        beside = [here.joint_p_n + step for step in (np.zeros(3), *steps)]
        shown = [_in_view(eye, near, Prior(p_n, q_nb, prior.covariance), 0.0, self._config.most_voting) for p_n in beside]
        marks = list({mark.id: mark for some in shown for mark in some}.values())
        hypotheses = [Candidate.as_mapped(eye, marks, (p_n, R_nb), difference(p_n, R_nb, p_0, q_0)) for p_n in beside]
        fits = [self._fit_at(images, marks, hypothesis, prior) for hypothesis in hypotheses]
        first, likeliest = fits[0], verify.decided(fits, v)
        if isinstance(first, str) or isinstance(likeliest, str):
            return False
        return first.odds >= v.odds and verify.same_position(likeliest, first, v)

    def _fit_at(self, images: Images, marks: list[Landmark], hypothesis: Candidate, prior: Prior) -> Fitted | str:
        fitted = self._fitter.fit(images, marks, hypothesis, prior)
        return fitted if isinstance(fitted, Fitted) else self._fitter.fit_one(images, marks, hypothesis, prior) or fitted

    def _candidates(self, images: Images, marks: list[Landmark], move: Motion) -> list[Candidate]:
        image = images.right if images.only_right else images.left
        assert image is not None
        return Search(self._eye(images), marks, move, self._config.coarse).candidates(image)

    def _fit(self, images: Images, marks: list[Landmark], hypothesis: Candidate, prior: Prior) -> Fitted | str:
        eye, voted = self._eye(images), self._trusted(hypothesis)
        large = voted & ~small_landmarks.small(marks, eye, hypothesis.pose)
        mixed = 0 < large.sum() < voted.sum()
        known = self._fitter.fit(images, marks, hypothesis, prior, large) if mixed else ""
        if isinstance(known, str):
            return self._fitter.fit(images, marks, hypothesis, prior)
        p_n, R_nb = known.pose.joint_p_n, known.pose.joint_R_nb
        move = motion(eye, marks, Prior(p_n, so3.from_matrix(R_nb), known.pose.joint_covariance))
        for again in self._candidates(images, marks, move)[:1] if move else ():
            every = self._fitter.fit(images, marks, again, prior)
            if isinstance(every, Fitted) and len(every.used) > len(known.used):
                return every
        return known

    def _decide(self, images: Images, marks: list[Landmark], candidates: list[Candidate], prior: Prior) -> _Decided | _Refused:
        if not candidates:
            return _Refused("not_found", "nothing of the outlines in view")
        v, best = self._config.verify, candidates[0]
        evidence = Evidence.of(candidates, self._trusted(best), self._eye(images).camera.width)
        if flaw := verify.flaw(evidence, v):
            return _Refused("not_found", flaw)
        likely = 1 + sum(hypothesis.score > v.rival * best.score for hypothesis in candidates[1:])
        hypotheses = candidates[:likely]
        tried = [self._fit(images, marks, hypothesis, prior) for hypothesis in hypotheses]
        outcome = verify.decided(tried, v)
        if isinstance(outcome, str) or verify.grade(evidence, outcome, v)[0] != "sure":  # the votes do not know best
            hypotheses = [*hypotheses, *nearer_and_farther(marks, best, self._trusted(best), prior)]
            tried += [self._fit(images, marks, hypothesis, prior) for hypothesis in hypotheses[likely:]]
            outcome = verify.decided(tried, v)
        if not any(isinstance(one, Fitted) for one in tried):
            tried = [
                self._fitter.fit_one(images, marks, hypothesis, prior) or why
                for hypothesis, why in zip(hypotheses, tried, strict=True)
            ]
            outcome = verify.decided(tried, v)
        if isinstance(outcome, str):
            return _Refused("ambiguous" if sum(isinstance(one, Fitted) for one in tried) > 1 else "no_pose", outcome)
        at = next(k for k, one in enumerate(tried) if isinstance(one, Fitted) and one.pose is outcome.pose)
        outcome = self._fitter.joined(images, marks, hypotheses[at], outcome, prior)
        grade, reason = verify.grade(evidence, outcome, v)
        voted = any(isinstance(one, Fitted) and verify.same_position(one, outcome, v) for one in tried[:likely])
        if grade == "sure" and at >= likely and not voted:
            grade, reason = "weak", "another position has more votes"
        return _Decided(hypotheses[at], outcome, grade, reason, evidence.rival)

    def _confirmed(self, found: _Decided, marks: list[Landmark], t_ns: int, prior: Prior) -> _Decided | _Refused:
        """Weak or contradicted positions wait for an agreeing image."""
        fitted, weak = found.fitted, found.grade == "weak"
        if found.grade == "refused":
            return _Refused("no_pose", found.reason)
        if not self._alone and len(fitted.used) == 1:
            return _Refused("ambiguous", verify.ONE_ALONE)
        if not weak and not self._waiting.holds(t_ns, fitted.odds):
            return found
        roofs_n = np.array([[*marks[k].centre_n, marks[k].roof_d] for k in fitted.used])
        doubt = self._waiting.doubt(fitted, t_ns, prior, roofs_n, weak=weak)
        reason = found.reason or "the image before showed another position"
        return _Refused("waiting", f"{reason}: {doubt}") if doubt else found

    def _trusted(self, hypothesis: Candidate) -> Mask:
        return np.asarray(hypothesis.support > self._config.verify.landmark_share * np.maximum(hypothesis.length, 1.0))

    def _eye(self, images: Images) -> Eye:
        return eyes(self._rig)[int(images.only_right)]

    def _limit_px(self, eye: Eye) -> float:
        return limit_px(eye.camera, self._config.coarse)


def nearer_and_farther(marks: list[Landmark], hypothesis: Candidate, seen: Mask, prior: Prior) -> list[Candidate]:
    """Positions at other distances from one landmark's roof middle m.

    p = m + exp(k s) (p - m),    k = -2, -1, 1, 2,    s: standard deviation of |p - m| by the prior, over |p - m|
    """
    if seen.sum() != 1:
        return []
    mark = marks[int(np.flatnonzero(seen)[0])]
    middle = np.array([*mark.centre_n, mark.roof_d])
    away = hypothesis.p_n - middle
    s = math.sqrt(float(away @ prior.covariance[:3, :3] @ away)) / float(away @ away)
    return [replace(hypothesis, p_n=middle + math.exp(k * s) * away) for k in _DISTANCES]


def _in_view(eye: Eye, near: Sequence[Landmark], prior: Prior, limit_px: float, most: int) -> list[Landmark]:
    pinhole, p_n = straight(eye), np.asarray(prior.p_n, dtype=float)
    p_nk, R_nk = pinhole.pose(p_n, prior.R_nb)
    ends, mark = roofs_in_view(pinhole, near, (p_n, prior.R_nb), limit_px)
    marks, first = np.unique(mark, return_index=True)
    if not len(marks):
        return []
    c, x_c = pinhole.camera, (ends - p_nk) @ R_nk
    px, size = c.project(x_c), np.array([c.width, c.height])
    low, high = np.minimum.reduceat(px, first), np.maximum.reduceat(px, first)
    beside = np.maximum(np.maximum(low - size, -high), 0.0).max(axis=1)
    inside = np.prod(np.maximum(np.minimum(high, size) - np.maximum(low, 0.0), 0.0), axis=1)
    depth = np.add.reduceat(x_c[:, 2], first) / np.diff(first, append=len(ends))
    return [as_seen(near[marks[k]], c.fx / depth[k]) for k in np.lexsort((marks, beside, -inside))[:most]]


def _settled(one: RegionReport, used: tuple[str, ...]) -> RegionReport:
    if one.state != "open":
        return one
    done = one.landmark in used
    return msgspec.structs.replace(one, state="identified" if done else "open", reason="" if done else "seen, but not used")


def _as_fitted(found: _Decided) -> Candidate:
    hypothesis, fit = found.hypothesis, found.fitted.pose
    shift_m = hypothesis.shift_m.copy()
    shift_m[found.fitted.used] = fit.shift_m
    return replace(hypothesis, p_n=fit.joint_p_n, R_nb=fit.joint_R_nb, shift_m=shift_m)


def _reports(eye: Eye, marks: list[Landmark], hypothesis: Candidate, trusted: Mask) -> list[RegionReport]:
    p_nk, R_nk = eye.pose(*hypothesis.pose)
    bodies, said = Prisms.of(marks), []
    roofs = bodies.roofs
    roofs[:, :2] += np.repeat(hypothesis.shift_m[:, :2], np.diff(bodies.offsets), axis=0)
    boxes = _boxes(eye, eye.camera.project((roofs - p_nk) @ R_nk), bodies.offsets)
    for k, mark in enumerate(marks):
        if hypothesis.length[k] <= 0.0:
            continue
        share = float(hypothesis.support[k] / hypothesis.length[k])
        said.append(RegionReport(
            "open" if trusted[k] else "not_found", boxes[k], mark.id, min(share, 1.0), 0.0, int(trusted[k]),
            f"{share:.0%} of its outline lies on edges", PATH,
        ))  # fmt: skip
    return said


def _boxes(eye: Eye, px: Array, offsets: Indices) -> list[tuple[int, int, int, int]]:
    good, limit = np.isfinite(px).all(axis=1, keepdims=True), np.array([eye.camera.width, eye.camera.height])
    low = np.minimum.reduceat(np.where(good, px, np.inf), offsets[:-1])
    high = np.maximum.reduceat(np.where(good, px, -np.inf), offsets[:-1])
    shown = np.isfinite(low)
    low, high = np.where(shown, np.clip(np.floor(low), 0, limit), 0), np.where(shown, np.clip(np.ceil(high), 0, limit), 0)
    return [(u, v, w, h) for u, v, w, h in np.column_stack((low, high - low)).astype(int).tolist()]
