"""Vehicles that rest and then move, and what the optional sensors read on board, with their faults."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from models.earth_field import field_n, year_of
from models.frames import Origin
from models.messages import Array, ImuSample, Input, Reading, vec3
from models.sim.aids import Gnss, receive_gnss
from models.sim.scenario import EPOCH_NS, Truth
from models.sim.sensors import Imu, measure
from models.sim.trajectory import Trajectory

HOME = Origin(47.3977, 8.5456, 488.0)
_KNOT_S, _DEGREE = 0.5, 5


@dataclass(frozen=True, slots=True)
class Ride:
    """What GNSS and IMU say on board, in order of arrival, and the truth."""

    messages: list[Input]
    truth: Truth


def ride(
    rest_s: float,
    moving_s: float,
    *,
    seed: int = 0,
    yaw: float | None = None,
    path: Callable[[Array], Array] | None = None,
    imu: Imu | None = None,
    gnss: Gnss | None = None,
) -> Ride:
    """At rest, then along `path`: t (n,) since it moves -> n, e, d, yaw less the first (n, 4); default: loops of 10 m/s."""
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-math.pi, math.pi) if yaw is None else yaw
    imu = imu or Imu(grade="flight_controller", rate_hz=50.0)
    total = rest_s + moving_s
    knots = (np.arange(math.ceil(total / _KNOT_S) + 2 * (_DEGREE + 1)) - _DEGREE) * _KNOT_S
    at = np.maximum(knots[: -_DEGREE - 1] + 0.5 * (_DEGREE + 1) * _KNOT_S - rest_s, 0.0)
    points = (path or loops)(at) + np.array([0.0, 0.0, 0.0, yaw])
    course = Trajectory(
        BSpline(knots, points[:, :3], _DEGREE, extrapolate=False), BSpline(knots, points[:, 3], _DEGREE, extrapolate=False), total
    )
    t_ns = EPOCH_NS + np.arange(0, round(total * 1e9), round(1e9 / imu.rate_hz))
    motion = course.at(np.asarray((t_ns - EPOCH_NS) * 1e-9, np.float64))
    record = measure(imu, motion, HOME, 1.0 / imu.rate_hz, rng)
    samples: list[Input] = [
        ImuSample(int(t), int(t), vec3(g), vec3(a)) for t, g, a in zip(t_ns, record.gyro_b, record.accel_b, strict=True)
    ]
    fixes = receive_gnss(gnss or Gnss(rate_hz=5.0), course, HOME, EPOCH_NS, rng)
    truth = Truth(
        t_ns, motion.p_n, motion.v_n, motion.q_nb_wxyz, motion.R_nb, motion.omega_b,
        record.true_gyro_b, record.true_accel_b, record.gyro_bias, record.accel_bias,
    )  # fmt: skip
    return Ride(sorted([*samples, *fixes], key=lambda m: m.arrived_ns), truth)


def loops(t: Array) -> Array:
    """Loops of 20 s, 30 m across, the nose turning on its own."""
    w = 2.0 * math.pi / 20.0
    ramp = np.minimum(t / 5.0, 1.0) ** 2
    return np.column_stack(
        [30.0 * ramp * np.sin(w * t), 30.0 * ramp * (1.0 - np.cos(w * t)), -2.0 * ramp, 0.8 * ramp * np.sin(0.2 * t)]
    )


def heading(
    truth: Truth,
    *,
    seed: int = 0,
    rate_hz: float = 5.0,
    off_deg: float = 0.0,
) -> list[Input]:
    """Two antennas along the nose: 0.5 degrees of noise and 0.5 that stay."""
    rng = np.random.default_rng(seed)
    step = max(1, round(1e9 / rate_hz / float(truth.t_ns[1] - truth.t_ns[0])))
    stays = off_deg + 0.5 * rng.standard_normal()
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), step):
        t = int(truth.t_ns[k])
        r = truth.R_nb[k]
        yaw = math.atan2(r[1, 0], r[0, 0]) + math.radians(stays + 0.5 * rng.standard_normal())
        readings.append(Reading(t, t, "/heading", "heading", (math.remainder(yaw, 2.0 * math.pi),)))
    return readings


def magnetometer(
    truth: Truth,
    *,
    seed: int = 0,
    rate_hz: float = 10.0,
    iron_ut: float = 1.5,
    turned: Array | None = None,
) -> list[Input]:
    """The Earth's field on board: hard iron of iron_ut per axis, soft iron of 2 %, noise of 0.3 uT."""
    rng = np.random.default_rng(seed)
    field = np.array(field_n(HOME, round(year_of(EPOCH_NS), 1)))
    iron = iron_ut * 1e-6 * rng.standard_normal(3)
    soft = np.eye(3) + 0.02 * rng.standard_normal((3, 3))
    step = max(1, round(1e9 / rate_hz / float(truth.t_ns[1] - truth.t_ns[0])))
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), step):
        t = int(truth.t_ns[k])
        m_b = soft @ truth.R_nb[k].T @ field + iron + 0.3e-6 * rng.standard_normal(3)
        m_b = m_b if turned is None else turned @ m_b
        readings.append(Reading(t, t, "/mag", "magnetometer", vec3(m_b)))
    return readings


def velocity_body(truth: Truth, *, seed: int = 0, wheels: bool = False) -> list[Input]:
    """Along the body's axes, 10 Hz, noise of 0.05 m/s; wheels: forward alone is given."""
    rng = np.random.default_rng(seed)
    step = round(1e8 / float(truth.t_ns[1] - truth.t_ns[0]))
    variances = np.array([0.05**2, 1e6, 1e6]) if wheels else np.full(3, 0.05**2)
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), step):
        t = int(truth.t_ns[k])
        v_b = truth.R_nb[k].T @ truth.v_n[k] + 0.05 * rng.standard_normal(3)
        readings.append(Reading(t, t, "/velocity_body", "velocity_body", vec3(v_b), np.diag(variances)))
    return readings


def range_down(truth: Truth, *, seed: int = 0) -> list[Input]:
    """To flat ground 3 m below the origin, 10 Hz, noise of 0.05 m."""
    rng = np.random.default_rng(seed)
    step = round(1e8 / float(truth.t_ns[1] - truth.t_ns[0]))
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), step):
        t = int(truth.t_ns[k])
        distance_m = (3.0 - truth.p_n[k, 2]) / truth.R_nb[k][2, 2] + 0.05 * rng.standard_normal()
        readings.append(Reading(t, t, "/range", "range", (float(distance_m),)))
    return readings


def barometer(truth: Truth, *, seed: int = 0) -> list[Input]:
    """Pressure of the standard atmosphere, 10 Hz, noise of 0.3 m."""
    rng = np.random.default_rng(seed)
    step = round(1e8 / float(truth.t_ns[1] - truth.t_ns[0]))
    heights = HOME.alt_m - truth.p_n[::step, 2] + 0.3 * rng.standard_normal(len(truth.t_ns[::step]))
    pressures = 101_325.0 * (1.0 - heights / 44_330.8) ** (1.0 / 0.190263)
    return [
        Reading(t, t, "/baro", "baro", (pressure,))
        for t, pressure in zip(truth.t_ns[::step].tolist(), pressures.tolist(), strict=True)
    ]
