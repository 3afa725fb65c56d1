"""Steps of a receiver's speed that the IMU contradicts: its positions may go with them (docs/decision.md).

    step = (z_k - h(f(x_k-1))) - (z_k-1 - h(x_k-1)),     net = sum of the steps beyond 5 sigma and 0.8 m/s
    P <- P + j net net^T j^T,     j = (t I, I) of position and velocity

f: the state moved by the IMU; sigma: what the readings claim, or how they usually step; t: since the first step, or the last fix
of another source. Steps back to less than 0.8 m/s, a speed 2 s later that fits the state before, or such a fix while the receiver
agrees end it. It counts once the estimate follows: a reading is fused. Across an impact nothing is compared.
"""

import math

import msgspec
import numpy as np
from msgspec.structs import replace

from estimator.filter.hypotheses import Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.sources.base.aid import Aid
from models import imu
from models.measurements import Velocity
from models.messages import Array
from models.state import XYZ, E, X

_LEAST_M_S, _SIGMAS = 0.8, 5.0
_SHORTEST_S, _LONGEST_S = 0.15, 1.2  # between the two readings
_CONFIRMED_NS, _CONFIRMED = 2_000_000_000, 0.6  # so long after a step, of its size
_FEWEST, _USUAL_S = 5, 5.0  # readings to know the usual steps from, and over which time these are averaged
_NOTHING = np.zeros(3)
_OF_IMU = 4  # steps in a row are noise, or the IMU's
_NOISY = 9.0  # times the variance
_IMPACT_M_S2 = 30.0
_TIMING_S = 0.1  # of stamps and filters of receivers: what acceleration makes of it is no step


class SpeedStep(msgspec.Struct, frozen=True, eq=False):
    """A receiver's newest reading, the state x (16,) after it, nu (3,) [m/s] from there; agrees: it was fused.

    scatter2: mean square of the usual steps, of `usual` readings; before: time and state before an unconfirmed step.
    """

    t_ns: int
    x: Array
    nu: Array
    variance: Array
    agrees: bool
    net: Array = _NOTHING
    since_ns: int = 0
    followed: bool = False
    in_a_row: int = 0
    scatter2: float = 0.0
    usual: int = 0
    before: tuple[int, Array] | None = None

    def after(self, t_ns: int, nu: Array, x: Array, variance: Array) -> "SpeedStep":
        """With what the next reading shows: nu (3,) from the state x (16,) that the IMU has moved since the last."""
        step, dt_s = nu - self.nu, (t_ns - self.t_ns) * 1e-9
        if self.usual >= _FEWEST and math.hypot(*step.tolist()) >= _LEAST_M_S:
            accel = (x[X.V] - self.x[X.V]) / dt_s
            sigma2 = np.maximum(variance + self.variance, self.scatter2) + (_TIMING_S * accel) ** 2
            if float((step**2 / sigma2).sum()) >= _SIGMAS**2:
                return self._stepped(step)
        usual = self.usual + 1
        share = max(1.0 / usual, -math.expm1(-dt_s / _USUAL_S))
        scatter2 = self.scatter2 + share * (float(step @ step) / XYZ - self.scatter2)
        return replace(self, in_a_row=0, usual=usual, scatter2=scatter2)

    def _stepped(self, step: Array) -> "SpeedStep":
        net, in_a_row = self.net + step, self.in_a_row + 1
        if math.hypot(*net.tolist()) < _LEAST_M_S or in_a_row >= _OF_IMU:
            return replace(self.ended, in_a_row=in_a_row)
        since_ns = self.since_ns if self.is_open else self.t_ns
        return replace(self, net=net, since_ns=since_ns, in_a_row=in_a_row, before=self.before or (self.t_ns, self.x))

    def confirmed(self, nu: Array) -> "SpeedStep":
        """nu (3,): of a reading 2 s after the step, from the state before it; small: the readings before were off."""
        size = math.hypot(*nu.tolist())
        if size < max(_LEAST_M_S, _CONFIRMED * math.hypot(*self.net.tolist())):
            return self.ended
        return replace(self, net=nu, before=None)

    @property
    def is_open(self) -> bool:
        """A step has not ended."""
        return self.net is not _NOTHING

    @property
    def ended(self) -> "SpeedStep":
        """Without a step."""
        return replace(self, net=_NOTHING, followed=False, before=None)

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
    before = steps.get(aid.witness)
    if scatter > _NOISY:
        return {topic: step for topic, step in steps.items() if topic != aid.witness}
    variance = z.noise.diagonal()
    since_s = (aid.t_ns - before.t_ns) * 1e-9 if before is not None else math.inf
    if before is not None and since_s < _SHORTEST_S:
        return steps
    x = lead.filter.x.copy()
    nu = z.evaluate(x, gyro_b)[0]
    if before is None:
        return {**steps, aid.witness: SpeedStep(aid.t_ns, x, nu, variance, fused)}
    if since_s < _LONGEST_S and not lead.doubts_imu and not _shaken(samples, before.t_ns):
        moved = _moved(before.t_ns, before.x, aid.t_ns, samples, lead)
        before = before.after(aid.t_ns, z.evaluate(moved, gyro_b)[0], moved, variance)
        if before.before is not None and aid.t_ns - before.before[0] >= _CONFIRMED_NS:
            before = before.confirmed(z.evaluate(_moved(*before.before, aid.t_ns, samples, lead), gyro_b)[0])
    followed = before.followed or (fused and before.is_open)
    now = replace(before, t_ns=aid.t_ns, x=x, nu=nu, variance=variance, agrees=fused, followed=followed)
    return {**steps, aid.witness: now}


def _shaken(samples: ImuBuffer, from_ns: int) -> bool:
    """Whether the IMU has felt an impact since then, which its samples need not hold whole."""
    force = samples.u[samples.first_after(from_ns) : samples.count, XYZ:]
    return len(force) > 0 and bool(np.abs(force).max() > _IMPACT_M_S2)


def _moved(from_ns: int, x: Array, to_ns: int, samples: ImuBuffer, lead: Hypothesis) -> Array:
    index = samples.first_after(from_ns)
    return imu.moved(x, samples.t_ns, samples.u, samples.count, index, from_ns, to_ns, lead.filter.constants)


def positioned(steps: Steps, aid: Aid) -> Steps:
    """A position has been fused: its own receiver is followed; by another source those that agree are cleared."""
    if not any(step.is_open for step in steps.values()):
        return steps
    if aid.geodetic:
        return {topic: replace(s, followed=s.is_open) if topic == aid.topic else s for topic, s in steps.items()}
    return {topic: s.ended if s.agrees else replace(s, since_ns=aid.t_ns) for topic, s in steps.items()}


def remarks(steps: Steps) -> list[str]:
    """A sentence for each that is followed."""
    return [
        f"the speed of {topic} stepped by {np.linalg.norm(s.net):.1f} m/s, against the IMU: the covariance allows for it"
        for topic, s in sorted(steps.items())
        if s.followed
    ]
