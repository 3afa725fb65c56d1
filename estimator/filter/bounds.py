"""Plausibility bounds of the published state, by kind of vehicle: speed, height, uncertainty.

A state beyond them is not published, and the estimator begins again.
"""

import math
from functools import lru_cache
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit

from models import so3
from models.messages import Array
from models.state import E, X

_Speed: TypeAlias = Annotated[float, Meta(ge=0.1, le=2000)]
_Height: TypeAlias = Annotated[float, Meta(ge=-12_000, le=100_000)]
Vehicle: TypeAlias = Literal["any", "multirotor", "fixed_wing", "rover", "boat"]


_TILT_SIGMA = math.radians(60.0)  # the error state's attitude is a small angle; gravity shows roll and pitch better than this


_LIMITS: dict[Vehicle, tuple[float, float, float]] = {  # speed [m/s], height above the ellipsoid [m], lowest and highest
    "any": (200.0, -1000.0, 20_000.0),
    "multirotor": (60.0, -1000.0, 9000.0),
    "fixed_wing": (150.0, -1000.0, 20_000.0),
    "rover": (70.0, -1000.0, 6000.0),
    "boat": (40.0, -200.0, 4000.0),
}


class BoundsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[bounds]: an estimate beyond them is not published; the estimator begins again."""

    vehicle: Annotated[
        Vehicle, Meta(description="any, multirotor, fixed_wing, rover or boat: sets speed and height where they are not given")
    ] = "any"
    speed_m_s: Annotated[_Speed | None, Meta(description="m/s: fastest; none: by vehicle (any 200, multirotor 60)")] = None
    lowest_m: Annotated[_Height | None, Meta(description="m: lowest height above the ellipsoid; none: by vehicle")] = None
    highest_m: Annotated[_Height | None, Meta(description="m: highest height above the ellipsoid; none: by vehicle")] = None
    sigma_m: Annotated[float, Meta(ge=10, le=1e6, description="m: largest standard deviation of the position, per axis")] = (
        50_000.0
    )

    def violation(self, x: Array, cov: Array, origin_m: float) -> str:
        """What of x (16,) and P (n, n) is out of bounds; '' for nothing.

        origin_m: ellipsoid height of n's origin, 0 where unknown.
        """
        fastest, least_down, most_down, sigma = limits(self, origin_m)
        if is_within(x, cov, fastest, least_down, most_down, sigma):  # nearly every call
            return ""
        lowest, highest = origin_m - most_down, origin_m - least_down
        state, variances = x.tolist(), cov.diagonal().tolist()
        speed = math.hypot(*state[X.V])
        if not speed <= fastest:
            return f"speed of {speed:.0f} m/s exceeds [bounds] speed_m_s = {fastest:g}"
        height = origin_m - state[X.P][2]
        if not lowest <= height <= highest:
            return f"height of {height:.0f} m is outside [bounds] lowest_m = {lowest:g} to highest_m = {highest:g}"
        variance = max(variances[E.P])
        if not variance <= sigma**2:
            return f"position sigma of {math.sqrt(variance):.3g} m exceeds [bounds] sigma_m = {self.sigma_m:g}"
        theta, down_b = cov[E.THETA, E.THETA], so3.matrix(x[X.Q])[2]  # heading may be unknown, tilt is not
        tilt = 0.5 * float(np.trace(theta) - down_b @ theta @ down_b)
        if not tilt <= _TILT_SIGMA**2:
            return f"roll and pitch are known to {math.degrees(math.sqrt(tilt)):.0f} deg only"
        return ""


@lru_cache(maxsize=8)
def limits(config: BoundsConfig, origin_m: float) -> tuple[float, float, float, float]:
    """Of is_within, with those of the vehicle where they are not given; origin_m: see BoundsConfig."""
    own = zip((config.speed_m_s, config.lowest_m, config.highest_m), _LIMITS[config.vehicle], strict=True)
    fastest, lowest, highest = [float(of_kind if given is None else given) for given, of_kind in own]
    return fastest, origin_m - highest, origin_m - lowest, float(config.sigma_m)


_XP, _XV, _P, _T, _G = X.P.start, X.V.start, E.P.start, E.THETA.start, E.BG.start  # compiled code reads plain integers


@njit(cache=True, error_model="numpy")
def is_within(x: Array, cov: Array, fastest: float, least_down: float, most_down: float, sigma: float) -> bool:
    """Sufficient test: speed, down position and variances of position and attitude are within bounds."""
    good = math.sqrt(x[_XV] ** 2 + x[_XV + 1] ** 2 + x[_XV + 2] ** 2) <= fastest and least_down <= x[_XP + 2] <= most_down
    for i in range(_P, _P + 3):
        good = good and cov[i, i] <= sigma**2
    for i in range(_T, _G):
        good = good and cov[i, i] <= _TILT_SIGMA**2
    return good
