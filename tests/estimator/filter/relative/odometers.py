"""Odometry of a simulated flight, for tests: increments and poses made of the truth, with the errors that odometry has."""

from collections.abc import Callable, Iterator

import numpy as np

from models import so3
from models.messages import Array, OdometryDelta, OdometryPose, Quat, Vec3, vec3
from models.relative_pose import between
from models.sim.scenario import EPOCH_NS, Simulation

TOPIC = "/odometry"
_SECOND = 10**9


def pose_at(simulation: Simulation, t_ns: int) -> Array:
    """The true pose (7,) at the IMU sample of that time, or the first after it."""
    k = int(np.searchsorted(simulation.truth.t_ns, t_ns))
    return np.concatenate((simulation.truth.p_n[k], simulation.truth.q_nb_wxyz[k]))


def quat(q: Array) -> Quat:
    """As a message has it."""
    w, x, y, z = q.tolist()
    return w, x, y, z


def increments(
    simulation: Simulation,
    start_s: float,
    end_s: float,
    *,
    step_s: float = 0.5,
    seed: int = 0,
    scale: Callable[[float], float] = lambda _: 1.0,
    sigma: tuple[float, float, float] = (0.01, 0.01, 1e-3),
) -> Iterator[OdometryDelta]:
    """Chained increments; sigma: m, share of the length, rad, all white; scale: of the time since the start of the flight, s."""
    rng = np.random.default_rng(seed)
    step_ns = round(step_s * _SECOND)
    for t0_ns in range(EPOCH_NS + round(start_s * 1e9), EPOCH_NS + round(end_s * 1e9) - step_ns + 1, step_ns):
        step = between(pose_at(simulation, t0_ns), pose_at(simulation, t0_ns + step_ns))
        spread = float(np.hypot(sigma[0], sigma[1] * np.linalg.norm(step[:3])))
        dp = scale((t0_ns - EPOCH_NS) * 1e-9) * step[:3] + spread * rng.standard_normal(3)
        q = so3.multiply(step[3:], so3.quat_exp(sigma[2] * rng.standard_normal(3)))
        covariance = np.diag([spread**2] * 3 + [sigma[2] ** 2] * 3)
        yield OdometryDelta(t0_ns + step_ns, t0_ns + step_ns, t0_ns, vec3(dp), quat(q), covariance, topic=TOPIC)


def poses(
    simulation: Simulation,
    start_s: float,
    end_s: float,
    *,
    rate_hz: float = 10.0,
    frame: Callable[[float], str] = lambda _: "odom",
) -> Iterator[OdometryPose]:
    """True poses in a frame that is turned and shifted against the map."""
    turn = so3.from_euler(0.0, 0.0, 1.0)
    R, shift = so3.matrix(turn), np.array([5.0, -3.0, 1.0])
    for t_s in np.arange(start_s, end_s, 1.0 / rate_hz):
        t_ns = EPOCH_NS + round(float(t_s) * 100.0) * (_SECOND // 100)
        pose = pose_at(simulation, t_ns)
        p: Vec3 = vec3(R @ pose[:3] + shift)
        yield OdometryPose(t_ns, t_ns, p, quat(so3.multiply(turn, pose[3:])), frame(float(t_s)), TOPIC)
