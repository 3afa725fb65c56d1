"""Whether a path is another one turned and scaled, in the plane (Umeyama 1991, eqs. 40 to 43).

    g_k = a p_k + b + e_k,     a, b complex with the least sum |e|^2:     a = sum g' conj(p') / sum |p'|^2
    turned where sum |e|^2 < 0.05 sum |d'|^2,     d = g - p

p', g', d': from their means. A receiver that is misled turns no map: where a turn and a scale explain the difference, the map may
be what is wrong. On a straight way of constant speed a drift looks the same.
"""

import msgspec

_FEWEST = 25
_LEFT = 0.05  # of sum |d'|^2
_LEAST = 0.5  # |a|: a receiver that stands still has 0


class Similarity(msgspec.Struct, frozen=True, eq=False):
    """n pairs; means of p and g [m], complex: north + i east; sums |p'|^2, |g'|^2, g' conj(p')."""

    n: int = 0
    p: complex = 0j
    g: complex = 0j
    pp: float = 0.0
    gg: float = 0.0
    gp: complex = 0j

    def also(self, p: complex, g: complex) -> "Similarity":
        """With one more pair (Welford 1962)."""
        n = self.n + 1
        p1, g1, share = p - self.p, g - self.g, self.n / n
        return Similarity(
            n, self.p + p1 / n, self.g + g1 / n, self.pp + share * abs(p1) ** 2, self.gg + share * abs(g1) ** 2,
            self.gp + share * g1 * p1.conjugate(),
        )  # fmt: skip

    @property
    def a(self) -> complex:
        """Scale times exp(i turn)."""
        return self.gp / self.pp if self.pp > 0.0 else 1.0 + 0j

    @property
    def is_turned(self) -> bool:
        """Turn and scale explain the difference."""
        if self.n < _FEWEST or self.pp == 0.0:
            return False
        left, differ = self.gg - abs(self.gp) ** 2 / self.pp, self.gg + self.pp - 2.0 * self.gp.real
        return left < _LEFT * differ and abs(self.a) > _LEAST
