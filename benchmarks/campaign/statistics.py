"""From the scores of many runs of a flight to its cells: one instant, one part of the state, the mean over seeds.

n * mean(NEES) ~ chi2(n * dof)           two-sided bands of a cell                      (Bar-Shalom 2001, eq. 5.4.2-8)
efficiency = sqrt(mean |e|^2 / mean tr B),   B the posterior Cramer-Rao bound           (Tichavsky 1998)

Cells of a flight are not independent; runs are, so a flight's mean has a standard error.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np

from benchmarks.campaign.flights import Flight, Instant
from benchmarks.campaign.runs import BLOCKS, PARTS, Score
from logs.evaluation.metrics import chi2_band
from models.messages import Array, Reason

INSIDE, OUTSIDE = 0.95, 0.9999  # probabilities of the two bands
MOST_ERRORS = 3.0  # standard errors that a mean may be off
_MET = frozenset({Reason.FUSED, Reason.GATED, Reason.ALIGNING, Reason.PROBATION})  # used, or looked at as it should be


class Consistency(msgspec.Struct, frozen=True):
    """NEES/dof of one part at one instant, mean over n runs, and the bands of that mean; missing: runs without an estimate."""

    instant: Instant
    part: str
    n: int
    missing: int
    mean: float
    band95: tuple[float, float]
    band9999: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Within the 95 % band."""
        return self.band95[0] <= self.mean <= self.band95[1]

    @property
    def outside(self) -> bool:
        """Not even within the 99.99 % band."""
        return not self.band9999[0] <= self.mean <= self.band9999[1]


class Efficiency(msgspec.Struct, frozen=True):
    """RMSE of one block at one instant over runs, next to the bound: m, m/s, rad."""

    instant: Instant
    block: str
    rmse: float
    bound: float

    @property
    def ratio(self) -> float:
        """1 is as good as any estimator can be."""
        return self.rmse / self.bound


class Whole(msgspec.Struct, frozen=True):
    """NEES/dof of one part over a whole flight: mean over runs, and the standard error of that mean from their scatter."""

    part: str
    mean: float
    error: float

    @property
    def consistent(self) -> bool:
        """Not further from 1 than chance explains."""
        return abs(self.mean - 1.0) <= MOST_ERRORS * self.error

    def __str__(self) -> str:
        return f"{self.mean:.2f}±{self.error:.2f}"


class Result(msgspec.Struct, frozen=True):
    """A flight over all its seeds; fixes: valid measurements by what became of them."""

    name: str
    runs: int
    wholes: list[Whole]
    consistency: list[Consistency]
    efficiency: list[Efficiency]
    fixes: dict[str, int]
    internal: int

    @property
    def gated(self) -> float:
        """Share of valid measurements that the gate refused."""
        return self.fixes.get(Reason.GATED, 0) / sum(self.fixes.values())

    @property
    def lost(self) -> int:
        """Valid measurements that neither entered nor met a gate (those on probation count as looked at)."""
        return sum(n for reason, n in self.fixes.items() if reason not in _MET)

    @property
    def missing(self) -> int:
        """Instants without an estimate."""
        return sum(cell.missing for cell in self.consistency) // len(PARTS)


def judge(flight: Flight, scores: Sequence[Score]) -> Result:
    """All cells of a flight."""
    nees, squared, bound = (np.array([getattr(s, name) for s in scores], float) for name in ("nees", "squared", "bound"))
    cells, efficiencies = [], []
    for k, instant in enumerate(flight.instants()):
        for j, (part, indices) in enumerate(PARTS.items()):
            cells.append(consistency(instant, part, nees[:, k, j], len(indices)))
        for j, block in enumerate(BLOCKS):
            there = np.isfinite(squared[:, k, j])
            rmse, least = np.sqrt(squared[there, k, j].mean()), np.sqrt(bound[there, k, j].mean())
            efficiencies.append(Efficiency(instant, block, float(rmse), float(least)))
    fixes: Counter[str] = Counter()
    for score in scores:
        fixes.update(score.fixes)
    wholes = [whole(part, nees[:, :, j], len(indices)) for j, (part, indices) in enumerate(PARTS.items())]
    internal = sum(s.internal for s in scores)
    return Result(flight.name, len(scores), wholes, cells, efficiencies, dict(fixes), internal)


def whole(part: str, values: Array, dof: int) -> Whole:
    """Of NEES values (runs, instants), nan where there was no estimate."""
    each = np.array([run[~np.isnan(run)].mean() / dof for run in values if not np.isnan(run).all()])
    error = float(each.std(ddof=1)) / math.sqrt(len(each)) if len(each) > 1 else math.inf
    return Whole(part, float(each.mean()), error)


def consistency(instant: Instant, part: str, values: np.ndarray[tuple[int], np.dtype[np.float64]], dof: int) -> Consistency:
    """The cell of these NEES values, one a run; nan where there was no estimate."""
    there = values[~np.isnan(values)]
    n = len(there)
    low95, high95 = chi2_band(n * dof, INSIDE)
    low, high = chi2_band(n * dof, OUTSIDE)
    scale = 1.0 / (n * dof)
    mean = float(there.mean()) / dof
    return Consistency(instant, part, n, len(values) - n, mean, (low95 * scale, high95 * scale), (low * scale, high * scale))


def pooled_ratio(cells: Iterable[Efficiency]) -> float:
    """sqrt of the mean over cells of mean |e|^2 / mean tr B."""
    return float(np.sqrt(np.mean([cell.ratio**2 for cell in cells])))
