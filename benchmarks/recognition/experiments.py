"""The thesis' four experiments (chapter 6) on hundreds of samples.

share wrong < p95:  sum_{i <= k} C(n, i) p95^i (1 - p95)^(n - i) = 0.05        (Clopper & Pearson 1934; 0 of 200: 1.5 %)
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import cv2
import msgspec
import numpy as np
from scipy.stats import beta

from benchmarks.recognition.recognisers import METHODS, Answer, ask, sift_points
from benchmarks.recognition.views import EXPERIMENTS, ROOFS, Experiment, Roof, draw
from estimator.frontend.workers import pool

TITLES: Final[dict[str, str]] = {
    "accuracy": "accuracy and speed",
    "size": "same texture, other size",
    "partial": "30 to 70 % in view",
    "description": "known by description only",
}
LEAST_KEY_POINTS: Final = 500  # in an image; with fewer the comparison would be unfair to feature matching

TIMED: Final = 4  # one sample in so many


class Trial(msgspec.Struct, frozen=True):
    """One sample."""

    experiment: Experiment
    roof: Roof
    number: int
    seen: float
    key_points: int
    redrawn: int
    answers: dict[str, Answer]


class Row(msgspec.Struct, frozen=True):
    """One method in one experiment; by_pair: recognised from the first pairs;

    wrong_below, recognised_above: 95 % bounds.
    """

    experiment: Experiment
    roof: Roof
    method: str
    samples: int
    recognised: int
    by_pair: list[int]
    wrong: int
    recognised_above: float
    wrong_below: float
    cpu_ms_p50: float | None
    cpu_ms_p99: float | None
    error_m_p50: float | None


class Recognition(msgspec.Struct, frozen=True):
    """A run; redrawn: images with too few keypoints."""

    samples: int
    seed: int
    pairs: int
    redrawn: int
    key_points_least: int
    key_points_p50: float
    rows: list[Row]
    trials: list[Trial]


def run(
    samples: int,
    seed: int,
    pairs: int,
    experiments: Sequence[Experiment] = EXPERIMENTS,
    roofs: Sequence[Roof] = ROOFS,
    jobs: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Recognition:
    """`samples` of every experiment and roof; jobs: 0: all cores."""
    wanted = [(e, r, seed, k, pairs) for e in experiments for r in roofs for k in range(samples)]
    trials: list[Trial] = []
    with pool(jobs or None, _begin) as workers:
        for trial in workers.map(_trial, wanted, chunksize=2):
            trials.append(trial)
            progress(len(trials) / len(wanted))
    rows = [
        row(e, r, m, [t for t in trials if (t.experiment, t.roof) == (e, r)], pairs)
        for e in experiments
        for r in roofs
        for m in METHODS
    ]
    points = [t.key_points for t in trials]
    return Recognition(samples, seed, pairs, sum(t.redrawn for t in trials), min(points), float(np.median(points)), rows, trials)


def row(experiment: Experiment, roof: Roof, method: str, trials: Sequence[Trial], pairs: int) -> Row:
    """Summary of a method's trials."""
    answers = [t.answers[method] for t in trials]
    wrong = sum(a.verdict == "wrong" for a in answers)
    ms = [a.cpu_ms for a in answers if a.cpu_ms is not None]
    errors = [a.error_m for a in answers if a.error_m is not None and a.verdict == "recognised"]
    by_pair = [sum(a.verdict == "recognised" and a.pair <= k for a in answers) for k in range(1, pairs + 1)]
    n, recognised = len(answers), by_pair[-1]
    return Row(
        experiment, roof, method, n, recognised, by_pair, wrong, 1.0 - below(n - recognised, n), below(wrong, n),
        _percentile(ms, 50.0), _percentile(ms, 99.0), _percentile(errors, 50.0),
    )  # fmt: skip


def below(k: int, n: int) -> float:
    """p95 for k of n seen."""
    return 1.0 if k >= n else float(beta.ppf(0.95, k + 1, n - k))


def _percentile(values: Iterable[float], percent: float) -> float | None:
    several = list(values)
    return float(np.percentile(several, percent)) if several else None


def _begin() -> None:
    cv2.setNumThreads(1)
    sample = draw("accuracy", "painted", 0, 0)
    ask(sample, sift_points(sample.left), timed=True, pairs=1)


def _trial(which: tuple[Experiment, Roof, int, int, int]) -> Trial:
    experiment, roof, seed, number, pairs = which
    for redrawn in itertools.count():
        sample = draw(experiment, roof, seed, number, redrawn)
        looked = sift_points(sample.left)
        if len(looked.points) >= LEAST_KEY_POINTS:
            answers = ask(sample, looked, number % TIMED == 0, pairs)
            return Trial(experiment, roof, number, sample.seen, len(looked.points), redrawn, answers)
    raise AssertionError
