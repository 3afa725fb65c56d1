"""Smooth true motion of a multirotor or fixed wing, derivatives in closed form.

    p_n(t) = sum_i c_i B_i(t)        degree 7 B-spline, so v, a, jerk, angular rate and angular acceleration are all continuous
    multirotor:  z_b = -f/|f|,  f = a_n - g_n + k u (thrust, less the drag);  y_b ~ z_b x heading;  x_b = y_b x z_b
    fixed wing:  x_b = u/|u|  (no sideslip);                             y_b ~ x_b x f (coordinated);  z_b = x_b x y_b
    u = v - w                                                            velocity through the air, of which w is the wind
    omega_b = (z.y', x.z', y.x')                                                     of the axes' own derivatives

c_i sample straight legs or arcs; the convex hull bounds speeds. (Mellinger & Kumar 2011, section IV.)
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from numba import njit
from scipy.interpolate import BSpline

from models import so3
from models.frames import GRAVITY, GRAVITY_N
from models.messages import Array
from models.sim.air import Air
from models.sim.ranges import NotNegative, Positive, Share, ascending

_DEGREE = 7
_KNOT_S = 0.8  # s between knots: a reversal of leg at 8 m/s becomes a tilt of about 45 degrees
_REST_S = 3.0  # on the ground after a landing


Waypoint: TypeAlias = tuple[float, float, float, float, float]  # t, north, east, down, yaw


class Multirotor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="multirotor"):
    """Take-off, legs between random positions, hovers, independent yaw; starts on the origin at rest.

    speed_m_s, climb_m_s: fastest; area_m: side; height_m: mean above the origin; hover_share: of legs; lands: ends on the origin;
    seed: fixes the course; visits: (t s, north m, east m) of legs beginning after t; drag_1_s: force per mass and airspeed.
    """

    speed_m_s: Positive = 8.0
    climb_m_s: Annotated[float, msgspec.Meta(gt=0.0, le=5.0)] = 3.0  # more would ask for thrust downwards
    area_m: Positive = 120.0
    height_m: Positive = 40.0
    hover_share: Share = 0.2
    lands: bool = False
    visits: tuple[tuple[NotNegative, float, float], ...] = ()
    seed: int | None = None
    drag_1_s: NotNegative = 0.0


class FixedWing(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="fixed_wing"):
    """Straight flight, coordinated turns, climbs within an area; starts in flight over the origin.

    speed_m_s: slowest, fastest; bank_deg: steepest; climb_m_s: fastest; area_m: side beyond which it turns home; height_m: mean;
    seed: fixes the course.
    """

    speed_m_s: tuple[Positive, Positive] = (16.0, 24.0)
    bank_deg: Annotated[float, msgspec.Meta(gt=0.0, le=60.0)] = 35.0
    climb_m_s: Annotated[float, msgspec.Meta(ge=0.0, le=8.0)] = 3.0
    area_m: Positive = 2000.0
    height_m: Positive = 150.0
    seed: int | None = None

    def __post_init__(self) -> None:
        ascending("speed_m_s", self.speed_m_s)


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion at n instants: p_n, v_n, a_n (n, 3), R_nb (n, 3, 3), q_nb_wxyz (n, 4), omega_b (n, 3); SI."""

    p_n: Array
    v_n: Array
    a_n: Array
    R_nb: Array
    q_nb_wxyz: Array
    omega_b: Array


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A path with own yaw (multirotor) or none (fixed wing).

    air: wind; drag_1_s: of a multirotor.
    """

    path: BSpline
    yaw: BSpline | None
    duration_s: float
    air: Air | None = None
    drag_1_s: float = 0.0

    def at(self, t_s: Array) -> Motion:
        """Motion at t_s (n,), 0 <= t_s <= duration_s. Raises ValueError outside."""
        if t_s.size and not (t_s.min() >= 0.0 and t_s.max() <= self.duration_s + 1e-6):
            raise ValueError(f"the trajectory lasts from 0 to {self.duration_s} s")
        v, a, jerk = (self.path(t_s, nu=order) for order in (1, 2, 3))
        wind, change = self.air.at(t_s) if self.air is not None else (0.0, 0.0)
        if self.yaw is None:
            R_nb, omega_b = _coordinated(v - wind, a - change, a, jerk)
        else:
            k = self.drag_1_s
            R_nb, omega_b = _thrust_vectored(a + k * (v - wind), jerk + k * (a - change), self.yaw(t_s), self.yaw(t_s, nu=1))
        return Motion(self.path(t_s), v, a, R_nb, _quaternions(R_nb), omega_b)


def build(vehicle: Multirotor | FixedWing, duration_s: float, rng: np.random.Generator, air: Air | None = None) -> Trajectory:
    """A random trajectory in the air; vehicle.seed replaces rng."""
    if vehicle.seed is not None:
        rng = np.random.default_rng(vehicle.seed)
    if isinstance(vehicle, Multirotor):
        return replace(_multirotor(vehicle, duration_s, rng), air=air, drag_1_s=vehicle.drag_1_s)
    return replace(_fixed_wing(vehicle, duration_s, rng), air=air)


def _multirotor(vehicle: Multirotor, duration_s: float, rng: np.random.Generator) -> Trajectory:
    """Waypoints (t, n, e, d, yaw) joined straight, a sample a knot, 5 cm of wander."""
    times = _knot_times(duration_s)
    rows = [(times[0], 0.0, 0.0, 0.0, rng.uniform(-math.pi, math.pi))]
    rows.append((4.0, *rows[0][1:]))
    place = np.array([0.0, 0.0, -vehicle.height_m])
    homeward_s = vehicle.area_m / vehicle.speed_m_s + 1.3 * vehicle.height_m / vehicle.climb_m_s + _REST_S
    until, visits = duration_s - homeward_s if vehicle.lands else math.inf, list(vehicle.visits)
    while rows[-1][0] < times[-1]:
        t, n, e, d, yaw = rows[-1]
        speed = vehicle.speed_m_s * rng.uniform(0.5, 1.0)
        if visits and t >= visits[0][0]:
            speed, place = vehicle.speed_m_s, np.array([*visits.pop(0)[1:], place[2]])
        leg = place - (n, e, d)
        level, climb = math.hypot(leg[0], leg[1]), abs(leg[2])
        takes = max(level / speed, climb / vehicle.climb_m_s, rng.uniform(4.0, 8.0))
        if t + takes > until:
            break
        rows.append((t + takes, place[0], place[1], place[2], yaw + rng.uniform(-2.0, 2.0)))
        if rng.random() >= vehicle.hover_share:
            side, height = vehicle.area_m, vehicle.height_m
            place = rng.uniform((-side / 2, -side / 2, -1.3 * height), (side / 2, side / 2, -0.7 * height))
    if vehicle.lands:
        rows += _home(vehicle, rows[-1])
    table = np.array(rows)
    points = np.column_stack([np.interp(times, table[:, 0], column) for column in table[:, 1:].T])
    points[:, :3] += 0.05 * rng.standard_normal((len(times), 3))
    return Trajectory(_spline(points[:, :3]), _spline(points[:, 3]), duration_s)


def _home(vehicle: Multirotor, last: Waypoint) -> list[Waypoint]:
    t, n, e, d, yaw = last
    over = t + max(math.hypot(n, e) / vehicle.speed_m_s, 4.0)
    return [(over, 0.0, 0.0, d, yaw), (over + max(-d / vehicle.climb_m_s, 4.0), 0.0, 0.0, 0.0, yaw)]


def _fixed_wing(vehicle: FixedWing, duration_s: float, rng: np.random.Generator) -> Trajectory:
    """Segments of constant turn rate, linear speed and climb, integrated."""
    times = _knot_times(duration_s)
    t, course, place = float(times[0]), rng.uniform(-math.pi, math.pi), np.zeros(2)
    rows = [(t, course, rng.uniform(*vehicle.speed_m_s), 0.0)]
    height = vehicle.height_m
    while t < times[-1]:
        _, course, speed, _ = rows[-1]
        takes, turn = rng.uniform(6.0, 20.0), 0.0
        outside = np.abs(place).max() > vehicle.area_m / 2
        if outside or rng.random() < 0.5:
            rate = GRAVITY * math.tan(math.radians(vehicle.bank_deg * rng.uniform(0.4, 1.0))) / speed
            home = math.remainder(math.atan2(-place[1], -place[0]) - course, 2.0 * math.pi)
            turn = home if outside else rng.choice([-1.0, 1.0]) * rng.uniform(0.5, math.pi)
            takes = max(abs(turn) / rate, 1.0)
        t, target = t + takes, rng.uniform(*vehicle.speed_m_s)
        new_speed = speed + float(np.clip(target - speed, -0.8 * takes, 0.8 * takes))
        climb = vehicle.climb_m_s * rng.uniform(-1.0, 1.0) if 0.6 < height / vehicle.height_m < 1.4 else 0.0
        if climb == 0.0:
            climb = math.copysign(vehicle.climb_m_s, vehicle.height_m - height)
        height += 0.5 * takes * (climb + rows[-1][3])
        place += 0.5 * takes * (speed + new_speed) * np.array([math.cos(course + turn / 2), math.sin(course + turn / 2)])
        rows.append((t, course + turn, new_speed, climb))
    table = np.array(rows)
    course, speed, climb = (np.interp(times, table[:, 0], column) for column in table[:, 1:].T)
    velocity = np.column_stack([speed * np.cos(course), speed * np.sin(course), -climb])
    points = np.cumsum(velocity, axis=0) * _KNOT_S
    return Trajectory(_spline(points - points[_DEGREE // 2] - (0.0, 0.0, vehicle.height_m)), None, duration_s)


def _knot_times(duration_s: float) -> Array:
    """Control points' instants (Greville abscissae), covering 0..duration_s."""
    count = math.ceil(duration_s / _KNOT_S) + _DEGREE + 1
    return np.asarray((np.arange(count) - 0.5 * (_DEGREE - 1)) * _KNOT_S, dtype=np.float64)


def _spline(points: Array) -> BSpline:
    knots = (np.arange(len(points) + _DEGREE + 1) - float(_DEGREE)) * _KNOT_S
    return BSpline(knots, points, _DEGREE, extrapolate=False)


def _thrust_vectored(a: Array, jerk: Array, yaw: Array, yaw_rate: Array) -> tuple[Array, Array]:
    z, dz = _unit(GRAVITY_N - a, -jerk)
    zero = np.zeros_like(yaw)
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), zero])
    dheading = yaw_rate[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), zero])
    y, dy = _unit(*_cross(z, dz, heading, dheading))
    x, dx = _cross(y, dy, z, dz)
    return _frame(x, dx, y, dy, z, dz)


def _coordinated(through_air: Array, change: Array, a: Array, jerk: Array) -> tuple[Array, Array]:
    x, dx = _unit(through_air, change)
    y, dy = _unit(*_cross(x, dx, a - GRAVITY_N, jerk))
    z, dz = _cross(x, dx, y, dy)
    return _frame(x, dx, y, dy, z, dz)


def _unit(u: Array, du: Array) -> tuple[Array, Array]:
    """e = u/|u|, e' = (u' - e (e.u')) / |u|, row by row."""
    norm = np.linalg.norm(u, axis=1, keepdims=True)
    e = u / norm
    return e, (du - e * np.sum(e * du, axis=1, keepdims=True)) / norm


def _cross(u: Array, du: Array, w: Array, dw: Array) -> tuple[Array, Array]:
    """u x w and its derivative."""
    return np.cross(u, w), np.cross(du, w) + np.cross(u, dw)


def _frame(x: Array, dx: Array, y: Array, dy: Array, z: Array, dz: Array) -> tuple[Array, Array]:
    """R_nb = [x y z], and omega_b from R' = R [omega]x."""
    omega_b = np.column_stack([np.sum(z * dy, axis=1), np.sum(x * dz, axis=1), np.sum(y * dx, axis=1)])
    return np.stack([x, y, z], axis=2), omega_b


@njit(cache=True)
def _quaternions(R_nb: Array) -> Array:
    q = np.empty((R_nb.shape[0], 4))
    for k in range(R_nb.shape[0]):
        of_k = so3.from_matrix(R_nb[k])
        for i in range(4):
            q[k, i] = of_k[i]
    return q
