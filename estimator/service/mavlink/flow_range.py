"""Range for optical flow: of the message, a range finder, or height above level ground.

r = h / (R_nb)_zz,   h = -p_d - ground_m,   sigma_r^2 = (P_pd + sigma_ground^2) / (R_nb)_zz^2
"""

import math
from typing import Any, Final

from logs.wire.increments import LEAST_RANGE_M, Range, measured_range
from models import so3
from models.messages import Estimate
from models.state import E, X

_OLD_NS: Final = 500_000_000
_MOST_TILTED: Final = 0.5  # cos of 60 degrees
_LARGEST_SHARE: Final = 0.3  # an error of scale beyond it is not one that is estimated


class FlowRange:
    """level: level ground above the map's origin and its 1-sigma, m; None: unknown."""

    def __init__(self, level: tuple[float, float] | None) -> None:
        self._level = level
        self._finder: tuple[int, float] | None = None
        self._estimate: Estimate | None = None

    def note_finder(self, t_ns: int, metres: float) -> None:
        """Infinite: no echo."""
        self._finder = t_ns, metres

    def note_estimate(self, estimate: Estimate) -> None:
        """The newest one; from another thread."""
        self._estimate = estimate

    def at(self, message: Any, t_ns: int) -> Range | None:
        """Of an OPTICAL_FLOW_RAD of t_ns; None: not known."""
        finder = self._finder
        finder_m = finder[1] if finder is not None and abs(t_ns - finder[0]) <= _OLD_NS else math.nan
        return measured_range(message.distance, finder_m) or self._of_filter(t_ns)

    def _of_filter(self, t_ns: int) -> Range | None:
        estimate = self._estimate
        if estimate is None or self._level is None or abs(t_ns - estimate.t_ns) > _OLD_NS:
            return None
        cosine = float(so3.matrix(so3.normalise(estimate.nav[X.Q]))[2, 2])
        ground_m, ground_sigma_m = self._level
        height_m = -float(estimate.nav[X.P][2]) - ground_m
        if cosine < _MOST_TILTED or height_m <= LEAST_RANGE_M:
            return None
        sigma_m = math.hypot(ground_sigma_m, math.sqrt(estimate.covariance[E.P, E.P][2, 2]))
        return Range(height_m / cosine, sigma_m / cosine, "filter") if sigma_m <= _LARGEST_SHARE * height_m else None
