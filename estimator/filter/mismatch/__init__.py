"""Differences of world and configuration, from innovations and paths. May import hypotheses and what is below."""

from estimator.filter.mismatch import between, delay, scatter, score, speed_step
from estimator.filter.mismatch.between import Means
from estimator.filter.mismatch.bias_walk import BiasWalk
from estimator.filter.mismatch.delay import DELAY
from estimator.filter.mismatch.frame import Frame
from estimator.filter.mismatch.heading import HEADING
from estimator.filter.mismatch.scatter import Scatter, Scatters
from estimator.filter.mismatch.score import Scores

CONSTANTS = DELAY, HEADING  # of a source, which nobody configured

__all__ = [
    "CONSTANTS", "DELAY", "BiasWalk", "Frame", "Means", "Scatter", "Scatters", "Scores", "between", "delay", "scatter", "score",
    "speed_step",
]  # fmt: skip
