"""The scale between the paths that two absolute sources draw: fixes in a wrong unit, with GNSS.

The positions z of the fixes are fitted to those of GNSS, g, extrapolated to the same time from its last two readings:

    z_i = s g_i + d t_i + c,        s = C_zg / C_gg        (least squares)

C: second moments about the mean, cleared of the part that is linear in time: C_ab = S_ab - S_a . S_b / n - C_at . C_bt / C_tt.
d t takes up a slow pull of the receiver, c an offset between map and datum: neither is a scale. The sums begin anew each minute.
The fixes are in a wrong unit where s is beyond a factor of two, the fit explains nearly all of their motion, and the difference
is one of metres; and so until a fit within that factor explains it. The fixes are at fault: degrees have no unit to mistake.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.sources.source import Aid
from models.measurements import Measurement, Pose, Position
from models.messages import Array

_FEWEST = 5.0  # pairs
_ANEW_S = 60.0  # the sums begin anew
_FRESH_S = 1.0  # GNSS readings further apart are not extrapolated
_FACTOR = 2.0  # by which the scale is off at least
_EXPLAINED = 0.9  # share of the motion of the fixes that the fit explains
_LEAST_M = 5.0  # root mean square of the difference that the scale makes
_UNITS = {100.0: "centimetres", 1000.0: "millimetres", 1 / 0.3048: "feet", 0.001: "kilometres"}
_NEAR = 0.1  # ln: a scale that near a unit's is that unit
_XYZ = 3


class Moments(NamedTuple):
    """Sums over the pairs of (1, t, g, z), 8 x 8; t [s], g and z [m] are from the first pair on."""

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
        """s where the fit explains the motion of the fixes and shows s to be another than 1, or 1; else None."""
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
        s = c_zg / c_gg
        if abs(math.log(s)) < math.log(_FACTOR):
            return 1.0
        return s if abs(s - 1.0) * math.sqrt(c_gg / n) > _LEAST_M else None


class PathScale(NamedTuple):
    """The last two readings of GNSS (time, position), the moments of the fixes of each topic with it, the scales shown last."""

    topic: str = ""
    last: tuple[tuple[int, Array], ...] = ()
    moments: tuple[tuple[str, Moments], ...] = ()
    scales: tuple[tuple[str, float], ...] = ()

    def also(self, aid: Aid, z: Measurement) -> "PathScale":
        """With one more position."""
        if not isinstance(z, Position | Pose) or len(z.rows) < _XYZ or not aid.absolute:
            return self
        if aid.geodetic:
            if self.topic not in {"", aid.topic}:  # the first receiver is the one to compare with
                return self
            return self._replace(topic=aid.topic, last=(*self.last[-1:], (aid.t_ns, z.z_n)))
        g = self._at(aid.t_ns)
        if g is None:
            return self
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

    def _at(self, t_ns: int) -> Array | None:
        """The position of GNSS at t_ns; None where it has none that is near."""
        if len(self.last) < len(("before", "newest")):
            return None
        (t0_ns, g0), (t1_ns, g1) = self.last
        apart_s, ahead_s = (t1_ns - t0_ns) * 1e-9, (t_ns - t1_ns) * 1e-9
        if not (0.0 < apart_s <= _FRESH_S and 0.0 <= ahead_s <= _FRESH_S):
            return None
        return np.asarray(g1 + (g1 - g0) * (ahead_s / apart_s))
