"""Forecast of the 95 % radius on a route without GPS: the estimator flies it with a perfect IMU.

Fixes by landmarks with whole roofs in view, unless ambiguous within the present radius:

    usable(i):  nearest similar landmark > 2 r95,  or three in view whose arrangement repeats no nearer than 2 r95

A share `found` of images has a fix; largest radius of three draws.
"""

import math
from collections.abc import Callable, Iterator
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.fusion import Fusion, FusionConfig
from estimator.tools.maps.ambiguity import SIMILAR, look_alikes, marks
from estimator.tools.maps.route import HOVER_S, RATE_HZ, Flight
from models import so3
from models.frames import Origin
from models.maps import outline as polygon
from models.maps.landmarks import LandmarkMap
from models.maps.table import Alike, MapError
from models.messages import Array, AttitudePrior, Estimate, GnssFix, GnssVelocity, ImuSample, LandmarkFix, Mode, vec3
from models.radius import horizontal_radius
from models.state import E, X

_EPOCH_NS: Final = 1_700_000_000_000_000_000
_GNSS_EVERY: Final = round(RATE_HZ / 5.0)  # samples
_ROW_EVERY: Final = round(RATE_HZ)
_ATTITUDE_PRIOR: Final = np.diag(np.deg2rad([2.0, 2.0, 4.0]) ** 2)
_DRAWS: Final = 3  # of the images that give a fix
_GROUP: Final = 3  # landmarks that make an arrangement
_REACHES_M: Final = (400.0, 200.0, 100.0, 50.0)  # for look-alikes, the first that the map's density allows


class Camera(msgspec.Struct, frozen=True):
    """view_deg: full angle of the smaller side; found: share with a fix; sigma_share: of one landmark's fix, sigma / distance."""

    view_deg: float = 60.0
    images_hz: float = 1.0
    found: float = 0.5
    sigma_share: float = 0.01
    sigma_deg: float = 0.5


class Row(msgspec.Struct, frozen=True):
    """A second of the flight. state: fix, alike (ambiguous), none (no landmark)."""

    t_s: float
    way_m: float
    lat_deg: float
    lon_deg: float
    radius95_m: float
    in_view: int
    state: str


class Stretch(msgspec.Struct, frozen=True):
    """A part of the route beyond the limit, and its lack."""

    from_m: float
    to_m: float
    worst_radius95_m: float
    reason: str


class Forecast(msgspec.Struct, frozen=True):
    """fit: radius below the limit everywhere; fixes: fewest of the draws."""

    fit: bool
    limit_m: float
    length_m: float
    worst_radius95_m: float
    fixes: int
    longest_without_fix_s: float
    unfit: tuple[Stretch, ...]
    rows: tuple[Row, ...]


class Moment(msgspec.Struct, frozen=True):
    """k: sample; p_n: estimate [m]; fixed: a fix came."""

    k: int
    radius95_m: float
    p_n: tuple[float, float, float]
    in_view: int
    state: str
    fixed: bool


class Sensors:
    """Measurements without errors."""

    def __init__(self, flight: Flight, origin: Origin, found: float, seed: int = 0) -> None:
        self._flight, self._origin, self._found, self._rng = flight, origin, found, np.random.default_rng(seed)
        w, x, y, z = so3.from_euler(0.0, 0.0, flight.heading_rad).tolist()
        self.quat = (w, x, y, z)

    def gnss(self, k: int, t_ns: int) -> tuple[AttitudePrior, GnssFix, GnssVelocity]:
        """Attitude, position and velocity of sample k."""
        fix = GnssFix(t_ns, t_ns, *self._origin.to_geodetic(self._flight.p_n[k]), None)
        velocity = GnssVelocity(t_ns, t_ns, vec3(self._flight.v_n[k]), None)
        return AttitudePrior(t_ns, t_ns, self.quat, _ATTITUDE_PRIOR), fix, velocity

    def imu(self, k: int, t_ns: int) -> ImuSample:
        """Sample k."""
        return ImuSample(t_ns, t_ns, (0.0, 0.0, 0.0), vec3(self._flight.accel_b[k]))

    def fix(self, fix: LandmarkFix) -> LandmarkFix | None:
        """A possible fix as received, or None."""
        return fix if self._rng.random() < self._found else None


def fly_along(the_map: LandmarkMap, flight: Flight, config: FusionConfig, camera: Camera, sensors: Sensors) -> Iterator[Moment]:
    """The flight from the end of GPS. Raises MapError where the map is too dense."""
    alike, reach_m = _alike(the_map)
    fusion = Fusion(msgspec.structs.replace(config, origin=the_map.origin))
    seen = _Seen(the_map, alike, reach_m, camera)
    radius, state, in_view, place = math.inf, "none", 0, (math.nan, math.nan, math.nan)
    every = max(1, round(RATE_HZ / camera.images_hz))
    for k, t_s in enumerate(flight.t_s.tolist()):
        t_ns, fixed = _EPOCH_NS + round(1e9 * t_s), False
        if t_s < HOVER_S and k % _GNSS_EVERY == 0:
            for message in sensors.gnss(k, t_ns):
                fusion.handle(message)
        if t_s >= HOVER_S and k % every == 0:
            usable, in_view = seen.from_above(flight.p_n[k], radius)
            state = "fix" if len(usable) else "alike" if in_view else "none"
            fix = sensors.fix(seen.fix(t_ns, flight.p_n[k], sensors.quat, usable)) if len(usable) else None
            if fix is not None:
                fusion.handle(fix)
                fixed = True
        for output in fusion.handle(sensors.imu(k, t_ns)):
            if isinstance(output, Estimate) and output.mode is not Mode.ALIGNING_HEADING:
                radius = float(horizontal_radius(output.covariance[None, E.P, E.P][:, :2, :2])[0])
                place = vec3(output.nav[X.P])
        if t_s >= HOVER_S and (k % every == 0 or k % _ROW_EVERY == 0):
            yield Moment(k, radius, place, in_view, state, fixed)


def forecast(
    the_map: LandmarkMap,
    flight: Flight,
    config: FusionConfig,
    camera: Camera,
    limit_m: float,
    progress: Callable[[float], None] | None = None,
) -> Forecast:
    """Fly it. Raises MapError without an estimate, or where the map is too dense."""
    place = Origin(*the_map.origin)
    runs: list[list[Moment]] = []
    for seed in range(_DRAWS):
        runs.append([])
        for moment in fly_along(the_map, flight, config, camera, Sensors(flight, place, camera.found, seed)):
            runs[-1].append(moment)
            if progress:
                progress((seed + moment.k / len(flight.t_s)) / _DRAWS)
    rows: list[Row] = []
    for several in zip(*runs, strict=True):
        worst_of = max(several, key=lambda m: m.radius95_m)
        if (k := worst_of.k) % _ROW_EVERY == 0:
            lat, lon, _ = place.to_geodetic(flight.p_n[k])
            way, t_s = float(flight.s_m[k]), float(flight.t_s[k]) - HOVER_S
            rows.append(Row(t_s, way, lat, lon, worst_of.radius95_m, worst_of.in_view, worst_of.state))
    fixed_s = [[HOVER_S, *(float(flight.t_s[m.k]) for m in run if m.fixed), float(flight.t_s[-1])] for run in runs]
    longest_s = max(float(np.diff(times).max()) for times in fixed_s)
    fixes = min(map(len, fixed_s)) - 2
    if not rows or not math.isfinite(rows[0].radius95_m):
        raise MapError("the estimate does not begin with this configuration; try the default one, without -c")
    unfit = _stretches(rows, limit_m)
    worst = max(row.radius95_m for row in rows)
    return Forecast(not unfit, limit_m, float(flight.s_m[-1]), worst, fixes, longest_s, tuple(unfit), tuple(rows))


def _alike(the_map: LandmarkMap) -> tuple[Alike, float]:
    for reach_m in _REACHES_M:
        try:
            pairs, distances, _ = look_alikes(the_map, reach_m, SIMILAR)
        except ValueError:  # too many pairs
            continue
        return marks(the_map, pairs, distances), reach_m
    raise MapError("the map is too dense to search for landmarks that look alike: cut it to the route (landfix map get --km)")


class _Seen:
    def __init__(self, the_map: LandmarkMap, alike: Alike, reach_m: float, camera: Camera) -> None:
        self._map, self._alike, self._reach_m, self._camera = the_map, alike, reach_m, camera
        d = the_map.description
        self._half = 0.5 * np.hypot(d[:, polygon.WIDTH], d[:, polygon.LENGTH])
        self._place = d[:, [polygon.NORTH, polygon.EAST]]

    def from_above(self, p_n: Array, radius95_m: float) -> tuple[NDArray[np.int64], int]:
        c = self._map.columns
        half = math.tan(math.radians(0.5 * self._camera.view_deg))
        widest = half * float(-p_n[2] - c.base_d.min() + 1000.0)
        rows = self._map.rows_near(float(p_n[0]), float(p_n[1]), min(widest, 3000.0))
        above = (c.base_d[rows] - c.height_m[rows]) - p_n[2]
        far = np.hypot(*(self._place[rows] - p_n[:2]).T) + self._half[rows]
        rows = rows[(above > 1.0) & (far <= half * above)]
        if 2.0 * radius95_m > self._reach_m:
            return rows[:0], len(rows)
        alone = self._alike.nearest_m[rows] > 2.0 * radius95_m
        together = (len(rows) >= _GROUP) & (self._alike.repeats_m[rows] > 2.0 * radius95_m)
        return rows[alone | together], len(rows)

    def fix(self, t_ns: int, p_n: Array, q: tuple[float, float, float, float], rows: NDArray[np.int64]) -> LandmarkFix:
        """m landmarks have 1/m of an error."""
        c, m = self._map.columns, len(rows)
        distance = float(np.mean(c.base_d[rows] - c.height_m[rows])) - float(p_n[2])
        sigma, turn = self._camera.sigma_share * distance / math.sqrt(m), math.radians(self._camera.sigma_deg)
        errors = np.zeros((m, 6, 3))
        errors[:, 0, 0] = errors[:, 1, 1] = c.sigma_m[rows] / m
        errors[:, 2, 2] = c.height_sigma_m[rows] / m
        common = np.einsum("mik,mjk->ij", errors, errors)
        shift = np.diag([self._map.common_sigma_m[0]] * 2 + [self._map.common_sigma_m[1]] + [0.0] * 3) ** 2
        names = tuple(c.ids[row] for row in rows.tolist())
        covariance = np.diag([sigma**2] * 3 + [turn**2] * 3)
        return LandmarkFix(t_ns, t_ns, vec3(p_n), q, covariance, common + shift, names, 0.9, 0.5, errors, shift)


def _stretches(rows: list[Row], limit_m: float) -> list[Stretch]:
    found: list[Stretch] = []
    begin = 0  # of the time without a fix that leads there
    k = 0
    while k < len(rows):
        if rows[k].state == "fix":
            begin = k + 1
        if rows[k].radius95_m <= limit_m:
            k += 1
            continue
        end = next((j for j in range(k, len(rows)) if rows[j].radius95_m <= limit_m), len(rows))
        states = [row.state for row in rows[min(begin, k) : end] if row.state != "fix"]
        alike = states.count("alike") > states.count("none")
        reason = "landmarks in view may be taken for others" if alike else "no landmark in view" if states else "too few fixes"
        found.append(Stretch(rows[k].way_m, rows[end - 1].way_m, max(row.radius95_m for row in rows[k:end]), reason))
        k = end
    return found
