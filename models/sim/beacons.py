"""Ranges to known beacons: z = |b - p - R_nb l| + s + n, s constant a run."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.messages import Array, Reading, Vec3
from models.sim.ranges import NotNegative, Positive, Rate


class Beacons(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """at_n_m: north, east, down of each; reach_m: range; antenna_b_m: lever arm."""

    at_n_m: tuple[Vec3, ...] = ((40.0, 40.0, -5.0), (-40.0, 40.0, -5.0), (0.0, -40.0, -5.0))
    rate_hz: Rate = 5.0
    sigma_m: NotNegative = 0.1
    slow_sigma_m: NotNegative = 0.1
    reach_m: Positive = 300.0
    antenna_b_m: Vec3 = (0.0, 0.0, 0.0)


def topic_of(k: int) -> str:
    """Of the k-th beacon, from 0 on."""
    return f"/beacon/{k + 1}"


def measure_ranges(
    beacons: Beacons, t_ns: NDArray[np.int64], epoch_ns: int, p_n: Array, R_nb: Array, rng: np.random.Generator
) -> list[Reading]:
    """Ranges at t_ns (n,) of the motion p_n (n, 3), R_nb (n, 3, 3), rate_hz a beacon."""
    antenna = p_n + R_nb @ np.array(beacons.antenna_b_m)
    readings: list[Reading] = []
    period_ns = round(1e9 / beacons.rate_hz)
    for k, at in enumerate(beacons.at_n_m):
        lag_ns = k * period_ns // len(beacons.at_n_m)
        rows = np.flatnonzero(np.diff((t_ns - epoch_ns - lag_ns) // period_ns, prepend=-1))
        true = np.linalg.norm(antenna[rows] - at, axis=1)
        stays = beacons.slow_sigma_m * rng.standard_normal()
        found = true + stays + beacons.sigma_m * rng.standard_normal(len(rows))
        heard = true < beacons.reach_m
        readings += [
            Reading(t, t, topic_of(k), "beacon", (max(z, 0.0),))
            for t, z in zip(t_ns[rows][heard].tolist(), found[heard].tolist(), strict=True)
        ]
    return readings
