"""A smooth horizontal wind with gusts, and a pitot tube's reading.

w(t) = w_0 + sigma sum_i sqrt(2 / N) sin(2 pi t / T_i + phi_i),   T_i from T / 3 to 3 T, in even steps of ln T
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.messages import Array, Reading
from models.sim.ranges import NotNegative, Positive, Rate

_WAVES = 12  # N
_SPREAD = 3.0
_PER_GUST = 6.0  # T over the correlation time: a wave correlates with itself for about a sixth of its period


class Wind(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """speed_m_s: mean, random direction; gust_m_s: north, east, for gust_s."""

    speed_m_s: NotNegative = 5.0
    gust_m_s: NotNegative = 0.5
    gust_s: Positive = 5.0


class Airspeed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A pitot tube along the nose: true airspeed; scale_sigma: drawn once a run."""

    rate_hz: Rate = 10.0
    sigma_m_s: NotNegative = 0.3
    scale_sigma: NotNegative = 0.02


@dataclass(frozen=True, slots=True)
class Air:
    """One realisation: mean_n (2,), waves (2, N): 1/s, rad."""

    mean_n: Array
    gust_m_s: float
    rates: Array
    phases: Array

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Wind (n, 3) m/s and its derivative (n, 3) m/s^2 at t_s (n,)."""
        angle = t_s[:, None, None] * self.rates + self.phases
        size = self.gust_m_s * math.sqrt(2.0 / _WAVES)
        wind, change = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))
        wind[:, :2] = self.mean_n + size * np.sin(angle).sum(axis=2)
        change[:, :2] = size * (self.rates * np.cos(angle)).sum(axis=2)
        return wind, change


def blow(wind: Wind, rng: np.random.Generator) -> Air:
    """A realisation of the wind."""
    toward = rng.uniform(-math.pi, math.pi)
    periods = _PER_GUST * wind.gust_s * np.exp(np.linspace(-math.log(_SPREAD), math.log(_SPREAD), _WAVES))
    rates = 2.0 * math.pi / (periods * rng.uniform(0.9, 1.1, (2, _WAVES)))
    phases = rng.uniform(-math.pi, math.pi, (2, _WAVES))
    return Air(wind.speed_m_s * np.array([math.cos(toward), math.sin(toward)]), wind.gust_m_s, rates, phases)


def read_airspeed(
    tube: Airspeed, air: Air | None, t_ns: NDArray[np.int64], epoch_ns: int, v_n: Array, R_nb: Array, rng: np.random.Generator
) -> list[Reading]:
    """Readings at t_ns (n,) of the motion v_n (n, 3), R_nb (n, 3, 3)."""
    wind = air.at(np.asarray((t_ns - epoch_ns) * 1e-9, np.float64))[0] if air is not None else 0.0
    along = np.einsum("kj,kj->k", R_nb[:, :, 0], v_n - wind)
    scale = 1.0 + tube.scale_sigma * rng.standard_normal()
    period_ns = round(1e9 / tube.rate_hz)
    rows = np.flatnonzero(np.diff((t_ns - epoch_ns) // period_ns, prepend=-1))
    noise = tube.sigma_m_s * rng.standard_normal(len(rows))
    return [
        Reading(int(t), int(t), "/airspeed", "airspeed", (float(scale * a + e),))
        for t, a, e in zip(t_ns[rows], along[rows], noise, strict=True)
    ]
