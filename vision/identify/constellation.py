"""Open regions of earlier images, decided with the next ones.

    z = p_n(then) + r,   error of z = dp - [r]x dtheta + drift,   drift ~ N(0, P_now - P_then)

Each object counts once; hypothesis weights are not carried over.
"""

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from models.messages import Array
from models.prior import Prior
from vision.identify.catalogue import Sighting

_SURER = 0.8  # the prior's variance fell below this part: something was fused in between, its error is another one


class MemoryConfig(msgspec.Struct, frozen=True):
    """memory_s: how long an open region waits; most: number; same_m, same_size: limits of one object."""

    memory_s: float = 5.0
    most: int = 12
    same_m: float = 2.0
    same_size: float = 0.3
    drift_floor_m: float = 0.05


@dataclass(frozen=True, slots=True)
class _Held:
    t_ns: int
    p_n: Array  # of the prior then
    sighting: Sighting
    variance: Array  # (3,) of the prior's position then


class Constellation:
    """Recent unidentified regions."""

    def __init__(self, config: MemoryConfig | None = None) -> None:
        self._config = config or MemoryConfig()
        self._held: list[_Held] = []

    def clear(self) -> None:
        """Forget after a fix: the prior's error has changed."""
        self._held = []

    def recall(self, seen: list[Sighting], t_ns: int, prior: Prior) -> list[Sighting]:
        """Remembered regions as seen from the prior now, without those in view again."""
        variance = np.diag(prior.covariance)[:3]
        c = self._config
        self._held = [
            h
            for h in self._held
            if 0 < t_ns - h.t_ns <= c.memory_s * 1e9 and float(variance.sum()) >= _SURER * float(h.variance.sum())
        ]
        remembered = [self._now(h, prior, variance) for h in self._held]
        return [r for r in remembered if not any(self._same(r, s) for s in seen)]

    def hold(self, seen: list[Sighting], remembered: list[Sighting], t_ns: int, prior: Prior) -> None:
        """Keep the regions seen whole, and recalled ones as far as there is room."""
        kept = [h for h in self._held if any(r.size_m2 == h.sighting.size_m2 for r in remembered)]
        variance = np.diag(prior.covariance)[:3].copy()
        new = [_Held(t_ns, np.asarray(prior.p_n, np.float64).copy(), s, variance) for s in seen if s.partial is None]
        self._held = (new + kept)[: self._config.most]

    def _now(self, held: _Held, prior: Prior, variance: Array) -> Sighting:
        drift = np.maximum(variance - held.variance, 0.0) + self._config.drift_floor_m**2
        s = held.sighting
        return replace(s, covariance_n=s.covariance_n + np.diag(drift), moved_n=held.p_n - prior.p_n, now=False)

    def _same(self, a: Sighting, b: Sighting) -> bool:
        apart = a.moved_n + a.arm_n - b.moved_n - b.arm_n
        spread = a.covariance_n + b.covariance_n
        spread += a.depth_sigma**2 * np.outer(a.arm_n, a.arm_n) + b.depth_sigma**2 * np.outer(b.arm_n, b.arm_n)
        near = float(np.linalg.norm(apart)) < self._config.same_m + 3.0 * float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
        cut = a.partial is not None or b.partial is not None  # how large it is, is not known
        return near and (cut or abs(np.log(a.size_m2 / b.size_m2)) < 2.0 * self._config.same_size)
