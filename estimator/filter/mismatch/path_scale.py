"""Scale between the paths of fixes z and GNSS g: fixes in a wrong unit (docs/decision.md).

    g_i = b z_i + d t_i + c + e_i,     b = C_zg / C_zz,     s = 1 / b                                     (least squares)
    sigma_b^2 = (C_gg - b C_zg) / ((3 n - 7) C_zz),     C_ab = S_ab - S_a . S_b / n - C_at . C_bt / C_tt

Sums restart each minute. Wrong unit: s > 2 or s < 1/5, b six sigmas from one and zero, a difference of metres beyond e. (Draper
and Smith 1998, ch. 1.)
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.sources.base.aid import Aid
from models.measurements import Measurement, Pose, Position
from models.messages import Array

_FEWEST = 5.0  # pairs
_UNKNOWNS = 7.0  # b, d, c
_SIGMAS = 6.0
_ANEW_S = 60.0  # the sums begin anew
_FRESH_S = 1.0  # an older GNSS reading makes no pair
_NO_UNIT = 0.2, 2.0  # scales between these are none: no unit is so near, and the bend of a pull may look so
_EXPLAINED = 0.4  # correlation of the two paths
_NOISE_M = 4.0  # of GNSS, root mean square: what is left is more where the receiver is pulled off
_LEAST_M = 3.0  # root mean square of the difference that the scale makes
_UNITS = {100.0: "centimetres", 1000.0: "millimetres", 1 / 0.3048: "feet", 0.001: "kilometres"}
_NEAR = 0.1  # ln: a scale that near a unit's is that unit
_XYZ = 3


class Moments(NamedTuple):
    """Sums over the pairs of (1, t, g, z), 8 x 8; t [s], g and z [m] from the first pair."""

    t0_ns: int
    g0: Array
    z0: Array
    sums: Array

    def also(self, t_ns: int, g: Array, z: Array) -> "Moments":
        """With one more pair."""
        row = np.concatenate(([1.0, (t_ns - self.t0_ns) * 1e-9], g - self.g0, z - self.z0))
        return self._replace(sums=self.sums + np.outer(row, row))

    @property
    def scale(self) -> float | None:
        """s where the fit explains the motion and s differs from 1, or 1; else None."""
        n = float(self.sums[0, 0])
        if n < _FEWEST:
            return None
        centred = self.sums[1:, 1:] - np.outer(self.sums[0, 1:], self.sums[0, 1:]) / n
        if not centred[0, 0] > 0.0:
            return None
        c = centred[1:, 1:] - np.outer(centred[0, 1:], centred[0, 1:]) / centred[0, 0]
        c_gg, c_zz, c_zg = (float(np.trace(block)) for block in (c[:_XYZ, :_XYZ], c[_XYZ:, _XYZ:], c[:_XYZ, _XYZ:]))
        if not (c_gg > 0.0 and c_zz > 0.0 and c_zg > _EXPLAINED * math.sqrt(c_gg * c_zz)):
            return None
        b = c_zg / c_zz
        left = max(c_gg - b * c_zg, 0.0)
        sigma = math.sqrt(left / ((_XYZ * n - _UNKNOWNS) * c_zz))
        if _NO_UNIT[0] < 1.0 / b < _NO_UNIT[1]:
            return 1.0
        difference_m = abs(b - 1.0) * math.sqrt(c_zz / n)
        left_m = math.sqrt(left / n)
        is_explained = left_m < _NOISE_M and difference_m > max(_LEAST_M, left_m)
        shown = is_explained and min(abs(b - 1.0), b) > _SIGMAS * sigma
        return 1.0 / b if shown else None


class PathScale(NamedTuple):
    """Newest GNSS reading, moments by topic of fixes, last scales."""

    topic: str = ""
    last: tuple[int, Array] | None = None
    moments: tuple[tuple[str, Moments], ...] = ()
    scales: tuple[tuple[str, float], ...] = ()

    def also(self, aid: Aid, z: Measurement) -> "PathScale":
        """With one more position."""
        if not isinstance(z, Position | Pose) or len(z.rows) < _XYZ or not aid.absolute:
            return self
        if aid.geodetic:
            if self.topic not in {"", aid.topic}:  # the first receiver is the one to compare with
                return self
            return self._replace(topic=aid.topic, last=(aid.t_ns, z.z_n))
        if self.last is None or not 0.0 <= (aid.t_ns - self.last[0]) * 1e-9 <= _FRESH_S:
            return self
        g = self.last[1]
        known = dict(self.moments)
        before = known.get(aid.topic)
        if before is None or not 0.0 <= (aid.t_ns - before.t0_ns) * 1e-9 < _ANEW_S:
            before = Moments(aid.t_ns, g, z.z_n, np.zeros((2 + 2 * _XYZ, 2 + 2 * _XYZ)))
        now = before.also(aid.t_ns, g, z.z_n)
        scales = dict(self.scales)
        if (scale := now.scale) is not None:
            scales[aid.topic] = scale
        return self._replace(moments=tuple({**known, aid.topic: now}.items()), scales=tuple(scales.items()))

    def objection(self, topic: str) -> str:
        """Why the fixes of this topic cannot be in metres; "" where they may be."""
        s = dict(self.scales).get(topic, 1.0)
        if s == 1.0:
            return ""
        unit = next((f": {name}?" for ratio, name in _UNITS.items() if abs(math.log(s / ratio)) < _NEAR), "")
        return f"scale {s:.3g} between {topic} and {self.topic}{unit}"
