"""Heights of a receiver, a barometer and a velocity against each other."""

from itertools import combinations
from typing import Final

import numpy as np

from logs.findings.position import of_scale
from logs.findings.streams import Cause, Stream, Streams
from models.messages import Array

_STEP_S: Final = 5.0
_LEAST_M: Final = 2.0  # RMS of a step
_ALIKE: Final = 0.8  # correlation
_SCALE: Final = 1.4
_UNIT: Final = 2.8  # a barometer in the wind of its vehicle reaches 2.55; feet are 3.28


def odd(streams: Streams) -> tuple[str, Cause] | None:
    """The one of three whose height changes are another multiple of the others', which agree."""
    known = {name: h for name, s in streams.items() if (h := _height(s)) is not None}
    if len(known) < 3:
        return None
    first, last = max(t[0] for t, _ in known.values()), min(t[-1] for t, _ in known.values())
    at = np.arange(first, last, _STEP_S)
    if len(at) < 8:
        return None
    climbs = {name: np.diff(np.interp(at, *h)) for name, h in known.items()}
    climbs = {name: c for name, c in climbs.items() if np.sqrt(np.mean(c**2)) > _LEAST_M}
    for a, b in combinations(climbs, 2):
        if not _agree(climbs[a], climbs[b]):
            continue
        for name in climbs.keys() - {a, b}:
            r, scale = _relation(0.5 * (climbs[a] + climbs[b]), climbs[name])
            if abs(r) < _ALIKE or (r > 0.0 and 1.0 / _UNIT < scale < _UNIT):
                continue
            wrong = "falls where it rises" if r < 0.0 else f"is {of_scale(scale)}"
            what = f"its height {wrong} by {a} and {b}"
            return name, Cause(what, float(streams[name].arrived_s[0]), "see the sign and the unit of its height")
    return None


def _agree(a: Array, b: Array) -> bool:
    r, scale = _relation(a, b)
    return r > _ALIKE and 1.0 / _SCALE < scale < _SCALE


def _relation(a: Array, b: Array) -> tuple[float, float]:
    """Correlation; b / a."""
    power_a, power_b = float(a @ a), float(b @ b)
    return float(a @ b) / max((power_a * power_b) ** 0.5, 1e-30), (power_b / max(power_a, 1e-30)) ** 0.5


def _height(stream: Stream) -> tuple[Array, Array] | None:
    s = stream.in_order()
    if len(s.t_s) < 8:
        return None
    match s.kind:
        case "gnss":
            return s.t_s, s.values[:, 2]
        case "pose_fix":
            return s.t_s, -s.values[:, 2]
        case "baro":
            return s.t_s, 44_330.0 * (1.0 - np.maximum(s.values[:, 0] / 101_325.0, 0.0) ** 0.1903)
        case "gnss_velocity":
            return s.t_s, -np.concatenate([[0.0], np.cumsum(0.5 * (s.values[1:, 2] + s.values[:-1, 2]) * np.diff(s.t_s))])
    return None
