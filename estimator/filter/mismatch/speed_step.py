"""Steps of a receiver's speed that the IMU contradicts: its positions may go with them (docs/decision.md).

    step = (z_k - h(f(x_k-1))) - (z_k-1 - h(x_k-1)),     net = sum of the steps beyond 5 sigma and 0.8 m/s
    P <- P + j net net^T j^T,     j = (t I, I) of position and velocity

f: the state moved by the IMU; t: since the first step, or the last fix of another source. Steps back to less than 0.8 m/s, or
such a fix while the receiver agrees, end it. It counts once the estimate follows: a reading is fused.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.filter.hypotheses import Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.sources.base.aid import Aid
from models import imu
from models.measurements import Velocity
from models.messages import Array
from models.state import E, X

_LEAST_M_S, _SIGMAS = 0.8, 5.0
_SHORTEST_S, _LONGEST_S = 0.15, 1.2  # between the two readings
_OF_IMU = 4  # steps in a row are noise, or the IMU's
_NOISY = 9.0  # times the variance
_TIMING_S = 0.1  # of stamps and filters of receivers: what acceleration makes of it is no step


class SpeedStep(NamedTuple):
    """The newest reading of a receiver, the state x (16,) after it, nu (3,) [m/s] from there; agrees: it was fused."""

    t_ns: int
    x: Array
    nu: Array
    variance: Array
    agrees: bool
    net: Array = np.zeros(3)
    in_a_row: int = 0
    since_ns: int = 0
    followed: bool = False

    def after(self, t_ns: int, nu: Array, x: Array, variance: Array) -> "SpeedStep":
        """With what the next reading shows: nu (3,) from the state x (16,) that the IMU has moved since the last."""
        step, dt_s = nu - self.nu, (t_ns - self.t_ns) * 1e-9
        accel = (x[X.V] - self.x[X.V]) / dt_s
        sigma2 = variance + self.variance + (_TIMING_S * accel) ** 2
        if math.hypot(*step.tolist()) < _LEAST_M_S or float((step**2 / sigma2).sum()) < _SIGMAS**2:
            return self._replace(in_a_row=0)
        net, in_a_row = self.net + step, self.in_a_row + 1
        if math.hypot(*net.tolist()) < _LEAST_M_S or in_a_row >= _OF_IMU:
            return self._replace(net=np.zeros(3), in_a_row=in_a_row, followed=False)
        return self._replace(net=net, in_a_row=in_a_row, since_ns=self.since_ns if self.net.any() else self.t_ns)

    @property
    def covariance(self) -> Array | None:
        """(15, 15), where the estimate follows it."""
        if not self.followed:
            return None
        moved = np.zeros(E.SIZE)
        moved[E.P], moved[E.V] = (self.t_ns - self.since_ns) * 1e-9 * self.net, self.net
        return np.outer(moved, moved)


Steps = dict[str, SpeedStep]  # by receiver; never changed in place


def noted(
    steps: Steps, aid: Aid, z: Velocity, gyro_b: Array, lead: Hypothesis, samples: ImuBuffer, *, fused: bool, scatter: float
) -> Steps:
    """With a velocity that the leading hypothesis has judged; scatter: factor of its noise, much of which is no speed."""
    if scatter > _NOISY:
        return {topic: step for topic, step in steps.items() if topic != aid.witness}
    before, variance = steps.get(aid.witness), z.noise.diagonal()
    since_s = (aid.t_ns - before.t_ns) * 1e-9 if before is not None else math.inf
    if before is not None and since_s < _SHORTEST_S:
        return steps
    x = lead.filter.x.copy()
    now = SpeedStep(aid.t_ns, x, z.evaluate(x, gyro_b)[0], variance, fused)
    if before is not None:
        if since_s < _LONGEST_S and not lead.doubts_imu:
            index, constants = samples.first_after(before.t_ns), lead.filter.constants
            moved = imu.moved(before.x, samples.t_ns, samples.u, samples.count, index, before.t_ns, aid.t_ns, constants)
            before = before.after(aid.t_ns, z.evaluate(moved, gyro_b)[0], moved, variance)
        followed = before.followed or (fused and bool(before.net.any()))
        now = now._replace(net=before.net, in_a_row=before.in_a_row, since_ns=before.since_ns, followed=followed)
    return {**steps, aid.witness: now}


def positioned(steps: Steps, aid: Aid) -> Steps:
    """A position has been fused: its own receiver is followed; by another source those that agree are cleared."""
    if not any(step.net.any() for step in steps.values()):
        return steps
    if aid.geodetic:
        return {topic: s._replace(followed=bool(s.net.any())) if topic == aid.topic else s for topic, s in steps.items()}
    return {
        topic: s._replace(net=np.zeros(3), followed=False) if s.agrees else s._replace(since_ns=aid.t_ns)
        for topic, s in steps.items()
    }


def remarks(steps: Steps) -> list[str]:
    """A sentence for each that is followed."""
    return [
        f"the speed of {topic} stepped by {np.linalg.norm(s.net):.1f} m/s, against the IMU: the covariance allows for it"
        for topic, s in sorted(steps.items())
        if s.followed
    ]
