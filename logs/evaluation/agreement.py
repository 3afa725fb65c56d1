"""Whether a receiver agrees with estimate or reference."""

from typing import Final

import numpy as np

from logs.evaluation.collected import Collected
from logs.evaluation.metrics import Mask, Times
from logs.evaluation.trajectory import Trajectory, interpolate
from models.messages import Array

_POSITION: Final = "gnss_position"
_LONGEST_STEP_NS: Final = 1_000_000_000
_LEAST, _LEAST_M, _RATIO = 10, 2.0, 3.0  # fixes; of the larger distance, and of the larger to the smaller


def contradiction(collected: Collected) -> str:
    """A sentence with both median horizontal distances [m]; "" where alike or unknown.

    It names the disagreement only: a fused fix is no independent witness.
    """
    name = collected.yardstick
    for topic in sorted({a.topic for a in collected.aids if a.kind == _POSITION} & collected.fixes.keys()):
        fixes = collected.fixes[topic]
        ours, covered = _distances(collected.estimate, fixes.t_ns, fixes.p)
        theirs, known = _distances(collected.truth, fixes.t_ns, fixes.p)
        both = covered & known
        if np.count_nonzero(both) < _LEAST:
            continue
        of_landfix, of_reference = float(np.median(ours[both])), float(np.median(theirs[both]))
        if max(of_landfix, of_reference) > max(_LEAST_M, _RATIO * min(of_landfix, of_reference)):
            side = "landfix" if of_landfix < of_reference else f"the {name}"
            distances = f"{of_landfix:.1f} m from the estimate, {of_reference:.1f} m from the {name}"
            return f"{name} or landfix: {topic} agrees with {side}: its median distance is {distances}"
    return ""


def _distances(trajectory: Trajectory, t_ns: Times, p: Array) -> tuple[Array, Mask]:
    distance = np.full(len(t_ns), np.nan)
    if not len(trajectory):
        return distance, np.zeros(len(t_ns), bool)
    at, covered = interpolate(trajectory, t_ns, _LONGEST_STEP_NS)
    distance[covered] = np.linalg.norm(at.p[:, :2] - p[covered, :2], axis=1)
    return distance, np.asarray(np.isfinite(distance))
