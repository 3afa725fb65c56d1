"""Other sensors and a second source of fixes, with a fault: perturb(flight, size, rng) -> messages in order of arrival."""

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from benchmarks.stress.flights import Flight
from models.messages import Array, Input, OdometryPose, PoseFix, Quat, Reading, vec3
from models.sim.faults import in_order

SINCE_S = 25.0  # of what drifts
ANOTHER = "/another"  # source of fixes
_RATE_HZ, _NOISE_M_S, _NOISE_M = 10.0, 0.05, 0.3
_PA, _PER_M, _POWER = 101_325.0, 2.25577e-5, 5.25588  # of the standard atmosphere


def velocity_scaled(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Velocity along the body's axes, size times the true one."""
    return _with_velocity(flight, rng, lambda v_b, _: size * v_b)


def velocity_biased(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Forward by size m/s too fast."""
    return _with_velocity(flight, rng, lambda v_b, _: v_b + np.array([size, 0.0, 0.0]))


def velocity_drifts(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """From SINCE_S on its forward error grows by size m/s a second."""
    return _with_velocity(flight, rng, lambda v_b, t_s: v_b + np.array([size * max(t_s - SINCE_S, 0.0), 0.0, 0.0]))


def velocity_late(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Stamped size ms after its validity."""
    return _with_velocity(flight, rng, lambda v_b, _: v_b, round(size * 1e6))


def odometry_drifts(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Poses in the map's frame, which drifts by size m/s from SINCE_S on."""
    found = list[Input]()
    for t_ns, k in _times(flight):
        t_s = (t_ns - flight.start_ns) * 1e-9
        p = flight.p_n[k] + np.array([size * max(t_s - SINCE_S, 0.0), 0.0, 0.0]) + 0.005 * rng.standard_normal(3)
        w, x, y, z = Rotation.from_matrix(flight.R_nb[k]).as_quat(scalar_first=True).tolist()
        found.append(OdometryPose(t_ns, t_ns, vec3(p), (w, x, y, z)))
    return in_order([*flight.messages, *found])


def baro_climbs(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Pressure of a height that climbs by size m/s from SINCE_S on."""
    base_m, found = flight.config.origin[2] if flight.config.origin else 0.0, list[Input]()
    for t_ns, k in _times(flight):
        by_s = max((t_ns - flight.start_ns) * 1e-9 - SINCE_S, 0.0)
        height_m = base_m - float(flight.p_n[k, 2]) + size * by_s + _NOISE_M * rng.standard_normal()
        found.append(Reading(t_ns, t_ns, "/baro", "baro", (_PA * (1.0 - _PER_M * height_m) ** _POWER,)))
    return in_order([*flight.messages, *found])


def second_shifted(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Another source of fixes, which comes first and is size m off."""
    return _with_fixes(flight, rng, lambda m: replace(m, p_n=vec3(np.add(m.p_n, (0.8 * size, 0.6 * size, 0.0)))))


def second_turned(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Another source of fixes, which comes first; its map is turned about its origin by size degrees."""
    turn = Rotation.from_euler("z", size, degrees=True)
    return _with_fixes(flight, rng, lambda m: replace(m, p_n=vec3(turn.apply(m.p_n)), q_nb_wxyz=_times_left(turn, m.q_nb_wxyz)))


def second_late(flight: Flight, size: float, rng: np.random.Generator) -> list[Input]:
    """Another source of fixes, stamped and arriving size ms late."""
    by_ns = round(size * 1e6)
    return _with_fixes(flight, rng, lambda m: replace(m, t_ns=m.t_ns + by_ns, arrived_ns=m.arrived_ns + by_ns))


def _with_fixes(flight: Flight, rng: np.random.Generator, fault: Callable[[PoseFix], PoseFix]) -> list[Input]:
    """With a true fix, of noise of its own and with the fault, at the time of each one."""
    found = list[Input]()
    for m in (m for m in flight.messages if isinstance(m, PoseFix)):
        k, noise = flight.row(m.t_ns), np.linalg.cholesky(m.covariance) @ rng.standard_normal(6)
        q = _times_left(Rotation.from_rotvec(noise[3:]), Rotation.from_matrix(flight.R_nb[k]).as_quat(scalar_first=True))
        found.append(fault(replace(m, topic=ANOTHER, p_n=vec3(flight.p_n[k] + noise[:3]), q_nb_wxyz=q)))
    return in_order([*found, *flight.messages])


def _times_left(turn: Rotation, q_wxyz: object) -> Quat:
    w, x, y, z = (turn * Rotation.from_quat(np.asarray(q_wxyz), scalar_first=True)).as_quat(scalar_first=True).tolist()
    return w, x, y, z


def _with_velocity(
    flight: Flight, rng: np.random.Generator, fault: Callable[[Array, float], Array], late_ns: int = 0
) -> list[Input]:
    found = list[Input]()
    for t_ns, k in _times(flight):
        v_b = flight.R_nb[k].T @ flight.v_n[k] + _NOISE_M_S * rng.standard_normal(3)
        values, stamp = vec3(fault(v_b, (t_ns - flight.start_ns) * 1e-9)), t_ns + late_ns
        found.append(Reading(stamp, stamp, "/velocity_body", "velocity_body", values, _NOISE_M_S**2 * np.eye(3)))
    return in_order([*flight.messages, *found])


def _times(flight: Flight) -> list[tuple[int, int]]:
    """Stamps at _RATE_HZ, each at a row of the truth, and the row."""
    wanted = np.arange(flight.t_ns[0], flight.t_ns[-1], round(1e9 / _RATE_HZ))
    rows = [flight.row(int(t)) for t in wanted]
    return [(int(flight.t_ns[k]), k) for k in dict.fromkeys(rows)]
