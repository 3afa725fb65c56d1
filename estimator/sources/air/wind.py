"""The wind: two states behind the 15, shared by all air sensors.

    w' = n_w,   var(w_0) = sigma^2,   g' = -g / tau + n_g

w, north and east: estimated random walk; gust g: considered.
"""

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import SlowError
from models import so3
from models.messages import Array
from models.state import X

WIND, GUST = "wind", "gust"
OF_AIR = (WIND, GUST, ".scale", ".tilt", ".sideslip")  # how the blocks of air sensors end
STAYS = 1e-10  # variance per second of what is estimated and does not change


class WindConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[wind]: estimated with [inputs] airspeed or [drag]."""

    sigma_m_s: Annotated[float, Meta(ge=0.1, le=100, description="m/s: north and east, before anything is known of it")] = 5.0
    walk_m_s_sqrt_s: Annotated[float, Meta(ge=1e-4, le=10, description="m/s/sqrt(s): by which it changes")] = 0.05
    gust_m_s: Annotated[float, Meta(ge=0, le=50, description="m/s: of gusts, north and east; 0: none")] = 1.2
    gust_s: Annotated[float, Meta(ge=0.1, le=1e3, description="s: duration of a gust")] = 4.0


def wind_errors(config: WindConfig, rows: int) -> tuple[SlowError, ...]:
    """Wind and gusts as errors of the first `rows` components of R^T (v - w)."""

    def by_wind(x: Array) -> Array:
        """d z / d w, (rows, 2)."""
        return -so3.matrix(x[X.Q]).T[:rows, :2]

    walk = np.full(2, config.walk_m_s_sqrt_s**2)
    wind = SlowError(WIND, config.sigma_m_s**2 * np.eye(2), math.inf, by_wind, walk, starts_at_zero=True)
    gust = SlowError(GUST, config.gust_m_s**2 * np.eye(2), config.gust_s, by_wind)
    return (wind, gust) if config.gust_m_s else (wind,)


def estimated(block: str, sigma: Array, jacobian: Array) -> SlowError:
    """A constant estimated sensor error s (k,), of sigma (k,), from zero; jacobian: d z / d s (m, k)."""
    return SlowError(block, np.diag(np.square(sigma)), math.inf, jacobian, np.full(len(sigma), STAYS), starts_at_zero=True)
