"""Is `landfix forecast` right? Its 95 % radius along a route against the errors of simulated flights on the same route and map.

    inside = share of flight seconds with |estimate - truth| <= forecast radius at that second           wanted: 0.95
    ratio  = RMS error / RMS of the forecast's sigma, sigma = radius / 2.448                                wanted: 1

    python -m benchmarks.maps.forecast_flights --flights 40

Each flight draws its own IMU, GNSS and fix errors, the error of each landmark in the map, and which images give a fix. The
forecast draws the last from a seed of its own, so the two differ most where fixes are rare. A radius is compared where the
forecast's is at most 100 m. No images are rendered: docs/vision_pose.md judges fixes.
"""

import argparse
import math
from itertools import product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.tables import Table, number
from estimator.config import Config
from estimator.map_files.store import load
from estimator.tools.maps.forecast import Camera, Sensors, fly_along, forecast
from estimator.tools.maps.route import RATE_HZ, Flight, fly
from models import so3
from models.frames import Origin
from models.imu import ImuNoise
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array, AttitudePrior, GnssFix, GnssVelocity, ImuSample, LandmarkFix, vec3
from models.sim.sensors import GRADES

_ORIGIN: Final = (47.4, 8.5, 400.0)
_LARGEST_M: Final = 100.0
_CHI_95: Final = math.sqrt(5.991)  # of two axes
_TURN_ON: Final = GRADES["flight_controller"]
_COLUMNS = (
    "map",
    "IMU",
    "images with a fix",
    "compared",
    "inside the radius",
    "ratio",
    "radius m, median",
    "error m, median",
    "lost",
)


class NoisySensors(Sensors):
    """One flight's errors: noise and walk of the IMU as `noise` says, biases at the start, GNSS 1 m, fixes as they report."""

    def __init__(self, the_map: LandmarkMap, flight: Flight, found: float, noise: ImuNoise, seed: int) -> None:
        super().__init__(flight, Origin(*the_map.origin), found, seed)
        rng = self._errors = np.random.default_rng([1, seed])
        n, dt = len(flight.t_s), 1.0 / RATE_HZ
        self._gyro = _drift(n, _TURN_ON.gyro_turn_on, noise.gyro_noise, noise.gyro_walk, dt, rng)
        turn = so3.matrix(np.asarray(self.quat)).T @ the_map.frame.earth_rate_n
        self._gyro += turn
        self._accel = flight.accel_b + _drift(n, _TURN_ON.accel_turn_on, noise.accel_noise, noise.accel_walk, dt, rng)
        self._z = {name: rng.standard_normal(3) for name in the_map.columns.ids}
        self._shift = rng.standard_normal(6)

    def gnss(self, k: int, t_ns: int) -> tuple[AttitudePrior, GnssFix, GnssVelocity]:
        """1 m, 1.5 m in height; 0.1 m/s."""
        p = self._flight.p_n[k] + np.array([1.0, 1.0, 1.5]) * self._errors.standard_normal(3)
        v = self._flight.v_n[k] + 0.1 * self._errors.standard_normal(3)
        fix = GnssFix(t_ns, t_ns, *self._origin.to_geodetic(p), np.diag([1.0, 1.0, 2.25]))
        return super().gnss(k, t_ns)[0], fix, GnssVelocity(t_ns, t_ns, vec3(v), 0.01 * np.eye(3))

    def imu(self, k: int, t_ns: int) -> ImuSample:
        """With bias and noise."""
        return ImuSample(t_ns, t_ns, vec3(self._gyro[k]), vec3(self._accel[k]))

    def fix(self, fix: LandmarkFix) -> LandmarkFix | None:
        """New errors, those of its landmarks in the map, and the map's shift."""
        if super().fix(fix) is None:
            return None
        assert fix.landmark_errors is not None
        assert fix.covariance_rig is not None
        e = np.sqrt(np.diag(fix.covariance)) * self._errors.standard_normal(6)
        e += np.sqrt(np.diag(fix.covariance_rig)) * self._shift
        for name, errors in zip(fix.landmarks, fix.landmark_errors, strict=True):
            e += errors @ self._z[name]
        q = so3.multiply(so3.quat_exp(e[3:]), np.asarray(fix.q_nb_wxyz))
        w, x, y, z = q.tolist()
        return msgspec.structs.replace(fix, p_n=vec3(np.asarray(fix.p_n) + e[:3]), q_nb_wxyz=(w, x, y, z))


def _drift(n: int, turn_on: float, noise: float, walk: float, dt: float, rng: np.random.Generator) -> Array:
    steps = walk * math.sqrt(dt) * rng.standard_normal((n, 3))
    steps[0] = turn_on * rng.standard_normal(3)
    return np.cumsum(steps, axis=0) + noise / math.sqrt(dt) * rng.standard_normal((n, 3))


def village(seed: int, houses: int) -> LandmarkMap:
    """Houses of 6 to 25 m at random in a square of 800 m, known to 0.5 m."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(houses):
        n, e = rng.uniform(-400.0, 400.0, 2)
        a, b = rng.uniform(6.0, 25.0), rng.uniform(6.0, 14.0)
        c, s = math.cos(angle := rng.uniform(0.0, math.pi)), math.sin(angle)
        ring = [(n + c * x - s * y, e + s * x + c * y) for x, y in ((0.0, 0.0), (0.0, b), (a, b), (a, 0.0))]
        made.append(Landmark.of(f"{k}", ring, height_m=5.0, sigma_m=0.5, height_sigma_m=0.5))
    return LandmarkMap.from_landmarks(_ORIGIN, made)


def route(the_map: LandmarkMap, height_m: float, speed_m_s: float) -> Flight:
    """A zigzag through the square of 800 m."""
    corners = [(-350.0, -350.0), (-350.0, 350.0), (0.0, 350.0), (0.0, -350.0), (350.0, -350.0), (350.0, 350.0)]
    places = np.array([the_map.frame.to_geodetic((n, e, 0.0))[:2] for n, e in corners])
    return fly(places, the_map.frame, height_m, speed_m_s)


def flown(the_map: LandmarkMap, flight: Flight, config: Config, camera: Camera, noise: ImuNoise, seed: int) -> Array:
    """Horizontal error at each second [m] (n,)."""
    moments = fly_along(the_map, flight, config.fusion(), camera, NoisySensors(the_map, flight, camera.found, noise, seed))
    rows = [m for m in moments if m.k % round(RATE_HZ) == 0]
    return np.array([math.hypot(*(np.asarray(m.p_n) - flight.p_n[m.k])[:2]) for m in rows])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--map", type=Path, help="a map of your own; the zigzag goes through its origin")
    args = parser.parse_args()
    as_mounted, bare = ImuNoise(), GRADES["flight_controller"].noise
    imus = {
        "as configured (default)": (Config(), as_mounted),
        "better than configured": (Config(), bare),
        "data sheet, configured so": (msgspec.structs.replace(Config(), imu=bare), bare),
    }
    maps = {"own map": load(args.map)} if args.map else {"120 houses": village(1, 120), "25 houses": village(2, 25)}
    rows: list[tuple[str, ...]] = []
    for (name, the_map), (imu, (config, noise)), found in product(maps.items(), imus.items(), (0.5, 0.1)):
        flight, camera = route(the_map, 80.0, 10.0), Camera(found=found)
        radius = np.array([row.radius95_m for row in forecast(the_map, flight, config.fusion(), camera, 20.0).rows])
        seeds = track(range(args.flights), f"{name}, IMU {imu}, {100 * found:.0f} %", console=Console(stderr=True))
        errors = np.array([flown(the_map, flight, config, camera, noise, seed) for seed in seeds])
        rows.append((name, imu, f"{100 * found:.0f} %", *summary(radius, errors)))
        print(*rows[-1], sep=" | ", flush=True)
    print(Table(f"Forecast and {args.flights} flights a row", _COLUMNS, rows).markdown())


def summary(radius: Array, errors: Array) -> tuple[str, ...]:
    """Columns from "compared" on. radius (n,), errors (flights, n)."""
    near = radius <= _LARGEST_M
    r, e = radius[near], errors[:, near]
    lost = int((~np.isfinite(errors)).any(axis=1).sum())
    inside = 100.0 * float(np.mean(e <= r))
    ratio = math.sqrt(float(np.mean((e / (r / _CHI_95)) ** 2)) / 2.0)
    return (
        f"{100.0 * float(np.mean(near)):.0f} %",
        f"{inside:.1f} %",
        number(ratio),
        number(float(np.median(r))),
        number(float(np.median(e))),
        str(lost),
    )


if __name__ == "__main__":
    main()
