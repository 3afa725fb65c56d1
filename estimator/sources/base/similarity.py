"""Whether a path is another one turned and scaled, in the plane (Umeyama 1991, eqs. 40 to 43), rather than drifting off.

    g_k = p_k + e_k + b + (a - 1) p_k   or   g_k = p_k + e_k + b + v t_k,      a, b, v complex with the least sum |e|^2
    a = sum g' conj(p') / sum |p'|^2,     v = sum d' t' / sum t'^2,     d = g - p

p', g', d', t': from their means. A receiver that is misled turns no map: where turn and scale explain a difference far better
than a drift, the map may be what is wrong.
"""

from typing import NamedTuple

_FEWEST = 25
_EXPLAINED, _BETTER = 0.95, 4.0  # of sum |d'|^2; times the sum |e|^2 of a drift
_LEAST, _MOST = 0.03, 2.0  # |a - 1|; |a|, 1 / |a|


class Similarity(NamedTuple):
    """n pairs at times t; means of t [s], p and g [m], complex: north + i east; sums |p'|^2, |g'|^2, g' conj(p'), t'^2, d' t'."""

    n: int = 0
    t: float = 0.0
    p: complex = 0j
    g: complex = 0j
    pp: float = 0.0
    gg: float = 0.0
    gp: complex = 0j
    tt: float = 0.0
    dt: complex = 0j

    def also(self, t_s: float, p: complex, g: complex) -> "Similarity":
        """With one more pair (Welford 1962)."""
        n = self.n + 1
        t1, p1, g1, share = t_s - self.t, p - self.p, g - self.g, self.n / n
        return Similarity(
            n, self.t + t1 / n, self.p + p1 / n, self.g + g1 / n, self.pp + share * abs(p1) ** 2, self.gg + share * abs(g1) ** 2,
            self.gp + share * g1 * p1.conjugate(), self.tt + share * t1**2, self.dt + share * (g1 - p1) * t1,
        )  # fmt: skip

    @property
    def a(self) -> complex:
        """Scale times exp(i turn)."""
        return self.gp / self.pp if self.pp > 0.0 else 1.0 + 0j

    @property
    def is_turned(self) -> bool:
        """Turn and scale explain the difference."""
        if self.n < _FEWEST or self.pp == 0.0 or self.tt == 0.0:
            return False
        differ = self.gg + self.pp - 2.0 * self.gp.real
        turned, drifting = self.gg - abs(self.gp) ** 2 / self.pp, differ - abs(self.dt) ** 2 / self.tt
        explains = turned < (1.0 - _EXPLAINED) * differ and _BETTER * turned < drifting
        return explains and abs(self.a - 1.0) > _LEAST and 1.0 / _MOST < abs(self.a) < _MOST
