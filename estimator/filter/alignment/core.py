"""Shared by alignment and tracker: filters, constants, state of position sources."""

from typing import Final

import msgspec
import numpy as np

from estimator.filter.alignment.config import TrackerConfig
from estimator.filter.alignment.initialise import LEVEL_NS
from estimator.filter.conflict import Conflicts
from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses import Hypotheses
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relinearise import Stretch, relinearise
from estimator.filter.variance_factor import NO_EXCESS
from estimator.sources.base.aid import Aid
from models import imu
from models.messages import Array, Reason

NEVER = -(2**62)
FEWEST_SAMPLES = 5  # of IMU, to level with
_NO_IMU = np.zeros(6)
_AIDED_NS: Final = 3_000_000_000  # after a position; then the mode is dead_reckoning


class Decision(msgspec.Struct, frozen=True, eq=False):
    """Decision on a measurement.

    position: innovation and sigma, (3,) NED m, or None.
    """

    reason: Reason
    innovation: tuple[float, ...] = ()
    innovation_sigma: tuple[float, ...] = ()
    test_ratio: float = 0.0
    detail: str = ""
    position: tuple[tuple[float, ...], tuple[float, ...]] | None = None


class Core:
    """Hypotheses and the constants of their motion."""

    def __init__(self, config: TrackerConfig) -> None:
        self.config = config
        self.aided_ns = _AIDED_NS
        self.gap_ns = round(config.coast.gap_s * 1e9)
        self.t_ns = NEVER
        self.origin = config.origin
        self.noise = config.imu  # of the IMU that leads
        self.constants = imu.constants(self.noise, config.coast, config.origin)
        self.hypotheses: Hypotheses | None = None
        self.is_aligned = False
        self.stretch: Stretch | None = None
        self.variance_factor = NO_EXCESS
        self.conflicts = Conflicts()
        self.absolute: frozenset[str] = frozenset()  # topics that have given positions
        self.receivers: frozenset[str] = frozenset()  # of these, GNSS
        self.last_absolute_ns = NEVER

    def copy(self) -> "Core":
        """An independent copy; immutable parts are shared."""
        other = object.__new__(Core)
        other.__dict__ = self.__dict__.copy()
        other.hypotheses = self.hypotheses.copy() if self.hypotheses else None
        return other

    @property
    def is_aided(self) -> bool:
        """An absolute position was used lately."""
        return self.t_ns - self.last_absolute_ns <= self.aided_ns

    def recent(self, samples: ImuBuffer) -> Array | None:
        """The last second of IMU samples (k, 6), or None."""
        span_ns = LEVEL_NS
        end = samples.first_after(self.t_ns)
        begin = int(np.searchsorted(samples.t_ns[:end], self.t_ns - span_ns))
        if end - begin < FEWEST_SAMPLES or samples.t_ns[end - 1] - samples.t_ns[begin] < 0.5 * span_ns:
            return None
        return samples.u[begin:end]

    def last_sample(self, samples: ImuBuffer) -> Array | None:
        """The last sample up to now, (6,); None in a gap."""
        last = samples.first_after(self.t_ns) - 1
        return samples.u[last] if last >= 0 and self.t_ns - samples.t_ns[last] <= self.gap_ns else None

    def sample_now(self, samples: ImuBuffer) -> Array:
        """The raw angular rate and specific force now, (6,)."""
        if not samples.count:
            return _NO_IMU
        index = samples.first_after(self.t_ns)
        return imu.interpolate(samples.t_ns, samples.u, samples.count, index, self.t_ns)

    def note_variance(self, aid: Aid, seen: Innovation, largest: float | None = None) -> None:
        """One more innovation of an absolute source."""
        assert self.hypotheses is not None
        distance2 = seen.distance2 * self.variance_factor.value
        self.variance_factor = self.variance_factor.also(aid.topic, aid.t_ns, distance2, len(seen.nu), largest)
        self.hypotheses.scale(self.variance_factor.value)

    def relinearise(self, stretch: Stretch, samples: ImuBuffer) -> Stretch:
        """Relinearise the leading filter; the stretch, where it succeeded."""
        assert self.hypotheses is not None
        try:
            result = relinearise(stretch, self.hypotheses.lead, samples)
        except np.linalg.LinAlgError:  # a covariance is singular to rounding: no better than not to converge
            result = None
        if result is not None:
            self.hypotheses.members[0].filter, stretch = result
        self.stretch = stretch
        return stretch
