"""The trials of the ablation: rendered pairs of `landfix bench recognition`, views and decoys of `benchmarks.fixes.outline`, and
the aerial sets. Each is drawn once and answered by every variant of the pipeline.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Final, Literal, NamedTuple

import numpy as np

from benchmarks.aerial import brighton, nust, spacenet
from benchmarks.aerial.trials import WRONG_M
from benchmarks.aerial.trials import Trial as AerialTrial
from benchmarks.fixes.outcome import outcome_of
from benchmarks.fixes.outline_views import DECOYS, PRIOR_PX, decoy, draw, later, prior_of
from benchmarks.fixes.single_fix_views import View
from benchmarks.flights.tasks import data_folder
from estimator.bench import views
from estimator.bench.recognisers import Verdict, judged
from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.prior import Prior
from models.radius import reach
from vision.image.rectify import Image
from vision.pipeline import PipelineConfig, Result

Set = Literal["recognition", "outline", "decoys", "brighton", "nust", "spacenet"]
SETS: Final[tuple[Set, ...]] = ("recognition", "outline", "decoys", "brighton", "nust", "spacenet")
_ORIGIN: Final = (47.3977, 8.5456, 488.0)
_PAIRS: Final = 3  # of one sample of recognition
_PRIORS: Final = {"brighton": 10, "nust": 2, "spacenet": 1}  # drawn for each image
_OFF_PX: Final = (None, None, 120.0)  # views as they are, partly hidden, and with a prior that far off


class Frame(NamedTuple):
    """One pair, or one image, its prior, and the judge of what the pipeline makes of it."""

    left: Image
    right: Image | None
    t_ns: int
    prior: Prior
    judge: Callable[[Result], Verdict]


class Trial(NamedTuple):
    """group: trials counted together; frames: one after the other while `goes_on` asks for the next."""

    group: str
    rig: StereoRig
    landmarks: LandmarkMap
    config: PipelineConfig
    frames: Sequence[Callable[[], Frame]]
    goes_on: Callable[[Result, Verdict], bool]


def drawn(name: Set, seed: int, number: int) -> Trial | None:
    """The trial of a set; None where the set has no more."""
    if name == "recognition":
        return _recognition(seed, number)
    if name == "outline":
        return _outline(seed, number)
    if name == "decoys":
        return _decoy(seed, number)
    several = _aerial(name, seed)
    return _from_above(several[number]) if number < len(several) else None


def _recognition(seed: int, number: int) -> Trial:
    kinds = list(itertools.product(views.EXPERIMENTS, views.ROOFS))
    experiment, roof = kinds[number % len(kinds)]
    samples = [views.draw(experiment, roof, seed, number // len(kinds))]

    def frame(k: int) -> Frame:
        while len(samples) <= k:
            samples.append(samples[-1].next)
        of = samples[k]
        return Frame(of.left, of.right, k * 500_000_000, of.prior, lambda result: judged(result, of, None).verdict)

    scene = samples[0].scene
    several = [lambda k=k: frame(k) for k in range(_PAIRS)]
    return Trial(f"recognition, {experiment}", scene.rig_calibrated, scene.map, PipelineConfig(), several, _while_silent)


def _while_silent(_: Result, verdict: Verdict) -> bool:
    return verdict == "silent"


def _while_waiting(result: Result, _: Verdict) -> bool:
    return result.report.outcome == "waiting"


def _outline(seed: int, number: int) -> Trial:
    kind = number % len(_OFF_PX)
    shown = draw(seed, number // len(_OFF_PX), partial=kind == 1)
    off_px = _OFF_PX[kind]
    prior = prior_of(shown.view, 0.5 * PRIOR_PX if off_px is None else PRIOR_PX, off_px)
    return _of_view(("outline, whole", "outline, partial", "outline, 120 px off")[kind], shown.view, shown.images, prior)


def _decoy(seed: int, number: int) -> Trial:
    kind = DECOYS[number % len(DECOYS)]
    view, images, prior, possible = decoy(seed, number // len(DECOYS), kind)
    return _of_view(f"decoys, {kind}", view, images, prior, possible=possible)


def _of_view(group: str, view: View, images: tuple[Image, Image], prior: Prior, *, possible: bool = True) -> Trial:
    """possible: whether any fix is right."""

    def judge(of: View) -> Callable[[Result], Verdict]:
        def verdict(result: Result) -> Verdict:
            if result.pose is None:
                return "silent"
            return "wrong" if not possible or outcome_of(of, result.pose, "").wrong else "recognised"

        return verdict

    @lru_cache(maxsize=1)
    def second() -> Frame:
        moved, shown, after = later(view, prior)
        return Frame(*shown, 500_000_001, after, judge(moved))

    landmarks = LandmarkMap.from_landmarks(_ORIGIN, view.landmarks)
    several = (lambda: Frame(*images, 1, prior, judge(view)), second)
    return Trial(group, view.rig, landmarks, PipelineConfig(path="predict"), several, _while_waiting)


@lru_cache(maxsize=3)
def _aerial(name: str, seed: int) -> list[AerialTrial]:
    """All trials of a set, in an order that is drawn."""
    data, priors = data_folder(), _PRIORS[name]
    several: Iterator[AerialTrial]
    if name == "brighton":
        several = brighton.trials(data, seed, priors, brighton.AS_FINE_AS_THE_MAP)
    else:
        several = (nust if name == "nust" else spacenet).trials(data, seed, priors)
    every = list(several)
    return [every[k] for k in np.random.default_rng(seed).permutation(len(every))]


def _from_above(trial: AerialTrial) -> Trial:
    """Wrong: any fix under a map that is turned, or one that reports less than 2 m and is farther off."""
    decoys = "turned" in trial.case.group

    def frame(k: int) -> Frame:
        case, prior = (trial.case, trial.prior) if k == 0 else trial.after or (trial.case, trial.prior)

        def verdict(result: Result) -> Verdict:
            if result.fix is None or result.pose is None:
                return "silent"
            off_m = case.judge(result.pose.joint_p_n, result.pose.joint_R_nb)
            sure = reach(result.pose.joint_covariance[:3, :3]) <= WRONG_M
            return "wrong" if decoys or (sure and off_m > WRONG_M) else "recognised"

        return Frame(case.image, None, k * 2_000_000_000, prior, verdict)

    several = [lambda k=k: frame(k) for k in range(1 if trial.after is None else 2)]
    return Trial(trial.case.group, trial.case.rig, trial.case.landmarks, PipelineConfig(path="predict"), several, _while_waiting)
