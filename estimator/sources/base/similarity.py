"""Whether a path is another one turned and scaled, in the plane (Umeyama 1991, eqs. 40 to 43).

    g_k = a p_k + b + e_k,     a, b complex with the least sum |e|^2:     a = sum g' conj(p') / sum |p'|^2
    turned where      sum |e|^2 < 0.05 sum |d'|^2,     sum |e|^2 < 0.35 sum |g'|^2,     d = g - p
    in a unit where   sum |e|^2 < 0.35 sum |g'|^2,     |sum t' p'|^2 < 0.9 sum t'^2 sum |p'|^2,     |ln |a| k| < 0.15

p', g', d', t': from their means; k: of a unit, of which a metre has k. A receiver that is misled turns no map: where a turn and a
scale explain the difference, the map may be what is wrong, or the unit of p. A receiver that stands still shows neither. On a
straight way of constant speed a drift looks like a scale.
"""

import math

import msgspec

_FEWEST = 25
_LEFT, _STANDS = 0.05, 0.35  # of sum |d'|^2, of sum |g'|^2
_STRAIGHT = 0.9  # of sum |p'|^2 that constant speed explains
_UNITS = {100.0: "centimetres", 1000.0: "millimetres", 1 / 0.3048: "feet", 0.001: "kilometres"}
_NEAR = 0.15  # ln: a scale that near a unit's is that unit


def unit_of(k: float) -> str:
    """The unit of which a metre has k; "" for none."""
    return next((name for ratio, name in _UNITS.items() if abs(math.log(k / ratio)) < _NEAR), "")


class Similarity(msgspec.Struct, frozen=True, eq=False):
    """n pairs; means of p, g [m], complex: north + i east, of t [s]; sums |p'|^2, |g'|^2, g' conj(p'), t'^2, t' p'."""

    n: int = 0
    p: complex = 0j
    g: complex = 0j
    t: float = 0.0
    pp: float = 0.0
    gg: float = 0.0
    gp: complex = 0j
    tt: float = 0.0
    tp: complex = 0j

    def also(self, p: complex, g: complex, t_s: float) -> "Similarity":
        """With one more pair at t_s (Welford 1962)."""
        n = self.n + 1
        p1, g1, t1, share = p - self.p, g - self.g, t_s - self.t, self.n / n
        return Similarity(
            n, self.p + p1 / n, self.g + g1 / n, self.t + t1 / n, self.pp + share * abs(p1) ** 2, self.gg + share * abs(g1) ** 2,
            self.gp + share * g1 * p1.conjugate(), self.tt + share * t1**2, self.tp + share * t1 * p1,
        )  # fmt: skip

    @property
    def a(self) -> complex:
        """Scale times exp(i turn)."""
        return self.gp / self.pp if self.pp > 0.0 else 1.0 + 0j

    @property
    def is_turned(self) -> bool:
        """Turn and scale explain the difference."""
        return self._left < min(_LEFT * (self.gg + self.pp - 2.0 * self.gp.real), _STANDS * self.gg)

    @property
    def unit(self) -> str:
        """The unit of p, which is not metres, by the path; "": not shown."""
        if not self._left < _STANDS * self.gg or abs(self.tp) ** 2 > _STRAIGHT * self.tt * self.pp:
            return ""
        return unit_of(1.0 / abs(self.a))

    @property
    def _left(self) -> float:
        """sum |e|^2, m^2; inf: too few pairs."""
        return self.gg - abs(self.gp) ** 2 / self.pp if self.n >= _FEWEST and self.pp > 0.0 else math.inf
