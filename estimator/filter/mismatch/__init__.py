"""Differences of world and configuration, from innovations and paths. May import hypotheses and what is below."""

from estimator.filter.mismatch import between, delay, lasting, speed_step
from estimator.filter.mismatch.between import Means
from estimator.filter.mismatch.bias_walk import BiasWalk
from estimator.filter.mismatch.delay import Delays
from estimator.filter.mismatch.frame import Frame
from estimator.filter.mismatch.jamming import Jamming
from estimator.filter.mismatch.lasting import Lasting
from estimator.filter.mismatch.scatter import Scatter

__all__ = ["BiasWalk", "Delays", "Frame", "Jamming", "Lasting", "Means", "Scatter", "between", "delay", "lasting", "speed_step"]
