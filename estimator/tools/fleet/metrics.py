"""Each metric as a cost; more is worse.

error       c = ln x
consistency c = |ln x|            1 is consistent, too small is as bad as too large
share       c = -x                differences count
count       c = x                 differences count
"""

import math
from collections.abc import Mapping
from enum import Enum
from typing import Any, Final


class Kind(Enum):
    """How a value becomes a cost."""

    ERROR = "error"
    CONSISTENCY = "consistency"
    SHARE = "share"
    COUNT = "count"


METRICS: Final[Mapping[str, Kind]] = {
    "rmse_m": Kind.ERROR,
    "max_m": Kind.ERROR,
    "aided_m": Kind.ERROR,
    "outage_end_m": Kind.ERROR,
    "attitude_deg": Kind.ERROR,
    "velocity_m_s": Kind.ERROR,
    "nees_position": Kind.CONSISTENCY,
    "nees_pose": Kind.CONSISTENCY,
    "nis_per_dof": Kind.CONSISTENCY,
    "radius95_median_m": Kind.ERROR,
    "hpl_median_m": Kind.ERROR,
    "hpl_exceeded": Kind.COUNT,
    "vpl_exceeded": Kind.COUNT,
    "hazardous": Kind.COUNT,
    "available": Kind.SHARE,
    "covered95": Kind.SHARE,
    "first_estimate_s": Kind.ERROR,
    "without_absolute_s": Kind.COUNT,
    "refusals": Kind.COUNT,
    "resets": Kind.COUNT,
}
RANKED: Final = ("rmse_m", "outage_end_m", "nees_position", "nis_per_dof")  # a flight is as much worse as the worst of these
_SMALLEST: Final = 1e-9


def cost(metric: str, value: float | None) -> float | None:
    """Cost of a value, or None."""
    if value is None or not math.isfinite(value):
        return None
    match METRICS[metric]:
        case Kind.ERROR:
            return math.log(max(value, _SMALLEST))
        case Kind.CONSISTENCY:
            return abs(math.log(max(value, _SMALLEST)))
        case Kind.SHARE:
            return -value
        case Kind.COUNT:
            return value


def value_of(row: Mapping[str, Any], metric: str) -> float | None:
    """A metric of a row."""
    if metric == "refusals":
        return float(sum(n for _, n in row["refused"] or ()))
    found = row[metric]
    return None if found is None else float(found)


def is_ratio(metric: str) -> bool:
    """Whether a difference of costs is the logarithm of a ratio."""
    return METRICS[metric] in {Kind.ERROR, Kind.CONSISTENCY}


def percent(metric: str, change: float, before: float | None) -> float:
    """Cost difference in percent of before; infinite for nothing before."""
    if is_ratio(metric):
        return 100.0 * math.expm1(min(change, 700.0))
    return 100.0 * change / abs(before) if before else math.copysign(math.inf, change) if change else 0.0
