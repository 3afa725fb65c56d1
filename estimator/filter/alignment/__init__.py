"""From nothing to an aligned filter. May import estimator.filter.relinearise and what is below it."""

from estimator.filter.alignment.alignment import AT_REST, NO_POSITION, WRONG_SENSOR, Alignment
from estimator.filter.alignment.config import FilterConfig, TrackerConfig
from estimator.filter.alignment.core import NEVER, Core, Decision
from estimator.filter.alignment.heading import widen_unaligned
from estimator.filter.alignment.initialise import InitialiseConfig, lacks

__all__ = [
    "AT_REST", "NEVER", "NO_POSITION", "WRONG_SENSOR", "Alignment", "Core", "Decision", "FilterConfig", "InitialiseConfig",
    "TrackerConfig", "lacks", "widen_unaligned",
]  # fmt: skip
