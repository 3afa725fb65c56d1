"""Differences of world and configuration, from innovations and paths. May import hypotheses and what is below."""

from estimator.filter.mismatch import delay, speed_step
from estimator.filter.mismatch.bias_walk import BiasWalk
from estimator.filter.mismatch.delay import Delays
from estimator.filter.mismatch.jamming import Jamming
from estimator.filter.mismatch.path_scale import PathScale
from estimator.filter.mismatch.scatter import Scatter

__all__ = ["BiasWalk", "Delays", "Jamming", "PathScale", "Scatter", "delay", "speed_step"]
