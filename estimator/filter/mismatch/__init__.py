"""Differences of world and configuration, from innovations and paths. May import hypotheses and what is below."""

from estimator.filter.mismatch import between, delay, lasting, score, speed_step
from estimator.filter.mismatch.between import Means
from estimator.filter.mismatch.bias_walk import BiasWalk
from estimator.filter.mismatch.delay import DELAY
from estimator.filter.mismatch.frame import Frame
from estimator.filter.mismatch.heading import HEADING
from estimator.filter.mismatch.jamming import Jamming
from estimator.filter.mismatch.lasting import Lasting
from estimator.filter.mismatch.scatter import Scatter
from estimator.filter.mismatch.score import Scores

CONSTANTS = DELAY, HEADING  # of a source, which nobody configured

__all__ = [
    "CONSTANTS", "DELAY", "BiasWalk", "Frame", "Jamming", "Lasting", "Means", "Scatter", "Scores", "between", "delay", "lasting",
    "score", "speed_step",
]  # fmt: skip
