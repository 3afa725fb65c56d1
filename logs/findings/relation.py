"""Relation of two measurements of a motion: rotation or reflection, scale."""

from typing import Final, NamedTuple

import numpy as np

from models.messages import Array

_PRIOR: Final = 0.01  # of the first singular value: a direction without motion counts as unturned
_MIRROR_GAIN: Final = 0.5  # a reflection explains the rest this much better than any rotation


class Relation(NamedTuple):
    """b = scale * O @ a + rest; O (k, k) orthogonal; rest, equal: share of b's power left by the fit, and by b = a."""

    O: Array  # noqa: E741  (the group's name)
    scale: float
    rest: float
    equal: float

    @property
    def mirrored(self) -> bool:
        """Is it a reflection?"""
        return float(np.linalg.det(self.O)) < 0.0

    @property
    def angle_deg(self) -> float:
        """Of the rotation."""
        k = len(self.O)
        cosine = (np.trace(self.O) - (k - 2)) / 2.0
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def differs(self, rest: float = 0.35, angle_deg: float = 10.0, scale: float = 1.25) -> bool:
        """The fit explains the motion, equality does not."""
        apart = self.mirrored or self.angle_deg > angle_deg or abs(np.log(max(self.scale, 1e-12))) > np.log(scale)
        return self.rest < rest and self.rest < 0.5 * self.equal and apart


def relation(a: Array, b: Array) -> Relation:
    """Least squares over rows a_i -> b_i, (n, k):

    max tr(O^T C),  C = sum_i b_i a_i^T = U S V^T,  O = U D V^T,  scale = tr(O^T C) / sum |a_i|^2    (Umeyama 1991)

    D makes O a rotation, unless a reflection is much better; unmoved directions are unturned.
    """
    C = b.T @ a
    power_a, power_b = max(float(np.sum(a**2)), 1e-30), max(float(np.sum(b**2)), 1e-30)
    U, S, Vt = np.linalg.svd(C)
    U, S, Vt = np.linalg.svd(C + _PRIOR * S[0] * np.eye(len(C)))
    rotation = U @ np.diag([*np.ones(len(S) - 1), np.sign(np.linalg.det(U @ Vt))]) @ Vt
    best = _fit(rotation, C, power_a, power_b)
    if np.linalg.det(U @ Vt) < 0.0:
        mirror = _fit(U @ Vt, C, power_a, power_b)
        best = mirror if mirror[1] < _MIRROR_GAIN * best[1] else best
        rotation = U @ Vt if best is mirror else rotation
    return Relation(rotation, *best, equal=float(np.sum((b - a) ** 2)) / power_b)


def _fit(O: Array, C: Array, power_a: float, power_b: float) -> tuple[float, float]:  # noqa: E741
    along = float(np.trace(O.T @ C))
    return max(along, 0.0) / power_a, 1.0 - max(along, 0.0) ** 2 / (power_a * power_b)
