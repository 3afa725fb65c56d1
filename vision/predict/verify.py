"""Verification of a position (docs/vision_predict.md).

share   = sum support / sum length          of all landmarks in view, not of the chosen ones
rival   = (score of another position) / score          where it is high, both are fitted, and their odds compared
agree   : |x (-) x0 now  -  x (-) x0 then|^2 < chi2,   over the covariances of both fits and the prior's drift since
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models import so3
from models.messages import Array
from models.prior import Prior
from vision.pose.pose import PoseEstimate, difference
from vision.predict.coarse_search import Candidate

_ONE_FIT_PX = 2.0  # to which roofs come to lie together (the median): one fit, reached from two positions
_FOUND_RIGHT, _FOUND_CHANCE, _PIECES, _ALIKE = 0.75, 0.45, 12.0, 3.0  # of fits of rendered outlines, right and wrong ones
_COVERED = 16.0  # 5 ln (0.99 / 0.8 * 0.2 / 0.01): of five pieces of outline 1 % is covered at right positions, 20 % at others
ONE_ALONE = "one landmark alone, of a map that was picked automatically"
Grade = Literal["sure", "weak", "refused"]


class VerifyConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Requirements of a position."""

    landmark_share: Annotated[float, Meta(gt=0, lt=1, description="support per length of a landmark that counts as seen")] = 0.2
    share: Annotated[float, Meta(gt=0, lt=1, description="support per length of all landmarks in view, at least")] = 0.22
    seen: Annotated[float, Meta(gt=0, lt=1, description="share of the outline in view that belongs to landmarks seen")] = 0.35
    rival: Annotated[float, Meta(gt=0, lt=1, description="score over the best one's from which a position is fitted too")] = 0.7
    score_px: Annotated[float, Meta(gt=0, description="score that is accepted at once, in an image 640 px wide")] = 45.0
    least_px: Annotated[float, Meta(gt=0, description="score that is accepted if the next image agrees")] = 25.0
    found: Annotated[float, Meta(gt=0, lt=1, description="share of the fitted outlines that is found")] = 0.5
    weak_found: Annotated[float, Meta(gt=0, lt=1, description="the same, if the next image agrees")] = 0.35
    landmark_found: Annotated[
        float, Meta(gt=0, lt=1, description="the same of one landmark in the final check, or it is left out")
    ] = 0.5
    hidden_found: Annotated[float, Meta(gt=0, lt=1, description="the same where the edges there leave no doubt of it")] = 0.3
    checked: Annotated[float, Meta(gt=0, lt=1, description="the same of all, or the next image must agree")] = 0.72
    off_map: Annotated[float, Meta(gt=0, description="chi-square (4) of a landmark's error on the map, or it is left out")] = 12.0
    remain: Annotated[float, Meta(gt=0, lt=1, description="share of the outline that agrees on one fit, at least")] = 0.4
    kept: Annotated[float, Meta(gt=0, lt=1, description="the same, or the next image must agree")] = 0.65
    odds: Annotated[float, Meta(description="ln of the odds of a position that is accepted at once")] = 5.0
    sure_odds: Annotated[float, Meta(description="the same, however little of the outlines is found")] = 12.0
    weak_odds: Annotated[float, Meta(description="the same, if the next image agrees")] = 2.0
    both_odds: Annotated[float, Meta(description="the same of both images together, where they show one landmark alone")] = 7.0
    decides: Annotated[float, Meta(gt=0, description="ln of the odds by which it must be likelier than another position")] = 2.3
    decides_alike: Annotated[
        float,
        Meta(gt=0, description="the same of a position that would be accepted by itself: more than one landmark contributes"),
    ] = 6.6
    moved_px: Annotated[float, Meta(gt=0, description="from the position to the fit, at most, in an image 640 px wide")] = 12.0
    factor: Annotated[float, Meta(gt=1, description="variance factor of the fit, at most")] = 4.0
    weak_factor: Annotated[float, Meta(gt=1, description="above it the next image must agree")] = 2.2
    memory_s: Annotated[float, Meta(gt=0, description="how long a weak position waits for another that agrees")] = 3.0
    agree: Annotated[float, Meta(gt=0, description="chi-square (6) below which two positions agree")] = 16.8
    view_deg: Annotated[
        float, Meta(ge=0, description="by which lines of sight must have turned for another image to confirm a weak position")
    ] = 0.5
    drift_m: Annotated[float, Meta(gt=0, description="by which dead reckoning may be off from image to image")] = 0.05


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence for a candidate before its fit."""

    score_px: float
    share: float
    seen: float
    rival: float

    @classmethod
    def of(cls, candidates: list[Candidate], trusted: NDArray[np.bool_], width: int) -> "Evidence":
        """trusted (L,): landmarks of the best one that count as seen."""
        best = candidates[0]
        total = max(float(best.length.sum()), 1e-9)
        rival = max((c.score for c in candidates[1:]), default=0.0)
        return cls(
            best.score * 640.0 / width,
            float(best.support.sum()) / total,
            float(best.length[trusted].sum()) / total,
            max(rival, 0.0) / max(best.score, 1e-9),
        )


@dataclass(frozen=True, slots=True)
class Fitted:
    """used: landmarks; asked: all that the final check could see.

    kept: share of the asked outline that agreed; checked: in the worse image; odds: ln, against chance.
    """

    pose: PoseEstimate
    used: list[int]
    asked: list[int]
    remark: str
    kept: float
    checked: float
    middles: Array
    odds: float


def flaw(evidence: Evidence, config: VerifyConfig) -> str:
    """Why a position is not fitted; empty if it is."""
    if evidence.score_px < config.least_px or evidence.share < config.share:
        return f"the outlines are not where they should be: {evidence.share:.0%} of them on edges"
    if evidence.seen < config.seen:
        return f"landmarks with {evidence.seen:.0%} of the outline in view were found, the others were not"
    return ""


def position_odds(present: Array, gone: float, squared: float, found: float, covered: float) -> float:
    """ln odds of a position against chance.

    (sum_j ln ((1 - g) LR_j + g) - d^2 / 2) / a + n (f ln (r / c) + (1 - f) ln ((1 - r) / (1 - c))) - b h

    present (L,): ln LR in view; gone: g; squared: d^2 from prior and map; found: f, r at right positions, c by chance; a:
    repetition; n: pieces; covered: h.
    """
    r, c = _FOUND_RIGHT, _FOUND_CHANCE
    there = float(np.logaddexp(math.log(1.0 - gone) + present, math.log(gone)).sum())
    shown = found * math.log(r / c) + (1.0 - found) * math.log((1.0 - r) / (1.0 - c))
    return (there - 0.5 * squared) / _ALIKE + _PIECES * shown - _COVERED * covered


def decided(tried: Sequence[Fitted | str], config: VerifyConfig) -> Fitted | str:
    """The one fit left, or why none.

    Of nearly equally likely fits the most certain counts, with no more directions than the likeliest.
    """
    fits = [one for one in tried if not isinstance(one, str)]
    if not fits:
        return str(tried[0])
    likeliest = max(fits, key=lambda one: one.odds)
    as_likely = [
        one
        for one in fits
        if one.odds > likeliest.odds - config.decides
        and same_position(one, likeliest, config)
        and _measured(one) <= _measured(likeliest)
    ]
    best = min(as_likely, key=lambda one: (float(np.trace(one.pose.joint_covariance[:3, :3])), -one.odds))
    kept = best.kept
    for other in (one for one in fits if one is not best):
        apart = float(np.nanmedian(np.linalg.norm(other.middles - best.middles, axis=1)))
        if apart < _ONE_FIT_PX:
            kept = min(kept, other.kept)
        if (
            apart > config.moved_px
            and not same_position(best, other, config)
            and other.odds > best.odds - _decisive(other, config)
        ):
            return f"another position, {apart:.0f} px off, is not much less likely (ln odds {best.odds:.1f} and {other.odds:.1f})"
    return best if kept == best.kept else replace(best, kept=kept)


def _measured(one: Fitted) -> int:
    return len(np.eye(6) if one.pose.directions is None else one.pose.directions)


def _decisive(other: Fitted, config: VerifyConfig) -> float:
    """ln odds by which another position must be less likely."""
    return config.decides if other.odds < config.odds else config.decides_alike


def same_position(one: Fitted, other: Fitted, config: VerifyConfig) -> bool:
    """Whether |x_1 (-) x_2|^2 over both covariances is that of two fits of one pose."""
    a, b = one.pose, other.pose
    between = difference(a.joint_p_n, a.joint_R_nb, b.joint_p_n, so3.from_matrix(b.joint_R_nb))
    return bool(between @ np.linalg.solve(a.joint_covariance + b.joint_covariance, between) < config.agree)


def grade(evidence: Evidence, fitted: Fitted, config: VerifyConfig) -> tuple[Grade, str]:
    """Grade of a fit, and its reason."""
    fit = fitted.pose
    if fit.factor > config.factor:
        return "refused", f"residuals are {fit.factor:.1f} times what they should be"
    if fitted.odds < config.weak_odds:
        return "refused", f"the position is hardly likelier than one of chance (ln odds {fitted.odds:.1f})"
    if fit.factor > config.weak_factor:
        return "weak", f"residuals are {fit.factor:.1f} times what they should be"
    if fitted.odds < config.sure_odds and (fit.found < config.found or fitted.checked < config.checked):
        return "weak", f"{min(fit.found, fitted.checked):.0%} of the outlines found"
    if fitted.kept < config.kept:
        return "weak", f"landmarks with {1.0 - fitted.kept:.0%} of the outline are not where the others say"
    if fitted.odds < config.odds:
        return "weak", f"the position is not much likelier than one of chance (ln odds {fitted.odds:.1f})"
    if evidence.score_px < config.score_px:
        return "weak", "little of the outlines in view"
    return "sure", ""


@dataclass(frozen=True, slots=True)
class _Held:
    t_ns: int
    error: Array  # x (-) x0, (6,)
    covariance: Array
    prior: Prior
    odds: float
    sure: bool

    @classmethod
    def of(cls, fitted: Fitted, t_ns: int, prior: Prior, *, sure: bool) -> "_Held":
        fit = fitted.pose
        error = difference(fit.joint_p_n, fit.joint_R_nb, np.asarray(prior.p_n, float), np.asarray(prior.q_nb_wxyz, float))
        return cls(t_ns, error, fit.joint_covariance, prior, fitted.odds, sure)

    def view_change(self, now: Prior, points_n: Array) -> float:
        then_b, now_b = ((points_n - prior.p_n) @ prior.R_nb for prior in (self.prior, now))
        across = np.linalg.norm(np.cross(then_b, now_b), axis=1)
        return float(np.mean(np.arctan2(across, np.sum(then_b * now_b, axis=1))))


class Waiting:
    """The last image's position."""

    def __init__(self, config: VerifyConfig) -> None:
        self._config = config
        self._held: _Held | None = None
        self._nothing_ns: int | None = None  # when an image after it showed no position

    def nothing(self, t_ns: int) -> None:
        """No position was found at t_ns: later images know of none before."""
        self._nothing_ns = t_ns

    def fixed(self, fitted: Fitted, t_ns: int, prior: Prior) -> None:
        """After a fix, which confirms weak positions."""
        self._held, self._nothing_ns = _Held.of(fitted, t_ns, prior, sure=True), None

    def holds(self, t_ns: int, odds: float) -> bool:
        """Whether a weak position not much less likely than `odds` came before t_ns."""
        before = self._before(t_ns)
        return before is not None and not before.sure and before.odds > odds - self._config.decides

    def _before(self, t_ns: int) -> _Held | None:
        held = self._held
        if held is None or not 0 < t_ns - held.t_ns <= self._config.memory_s * 1e9:
            return None
        return None if self._nothing_ns is not None and self._nothing_ns < t_ns else held

    def doubt(self, fitted: Fitted, t_ns: int, prior: Prior, roofs_n: Array, *, weak: bool) -> str:
        """Why the held position does not confirm this one; empty where both show the same error of the prior.

        A single landmark needs the odds of both images; two weak positions need a changed view of the roofs (L, 3).
        """
        before, now = self._before(t_ns), _Held.of(fitted, t_ns, prior, sure=False)
        alone = before is not None and len(fitted.used) == 1 and before.odds + fitted.odds < self._config.both_odds
        if before is not None and self._same_error(before, now) and not alone:
            if before.sure or not weak or before.view_change(prior, roofs_n) >= math.radians(self._config.view_deg):
                self._held, self._nothing_ns = now, None
                return ""
            self._nothing_ns = None
            return "the image before agrees, but from the same viewpoint; one from elsewhere must agree"
        self._held, self._nothing_ns = now, None
        return "the next image must agree"

    def _same_error(self, before: _Held, now: _Held) -> bool:
        variances, variances_before = (np.diag(held.prior.covariance) for held in (now, before))
        drift = np.maximum(variances - variances_before, 0.0)
        drift[:3] += self._config.drift_m**2
        apart = now.error - before.error
        spread = now.covariance + before.covariance + np.diag(drift)
        return bool(apart @ np.linalg.solve(spread, apart) < self._config.agree)
