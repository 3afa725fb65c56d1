"""Fast path: the next IMU sample where nothing else happens, one compiled call a filter.

Weights, mode and limits are computed once after the last other message; any event ends it (History.quiet).
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimator.filter.bounds import is_within
from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses.mixture import mix, scale, shares
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.tracker import Tracker
from models import imu, sampling
from models.messages import Array, ImuSample
from models.state import E, X, sound

_N, _XN, _P = E.SIZE, X.SIZE, E.P.start  # compiled code reads plain integers
_NOTHING = np.zeros((3, 3))
_NO_FACTORS = 0.0, 0.0  # another hypothesis follows


class Quiet:
    """A publishing tracker at the newest sample, nothing to process for `left` samples and until_ns."""

    __slots__ = ("_added", "_filters", "_is_whole", "left", "mode", "samples", "tracker", "until_ns")

    def __init__(self, tracker: Tracker, samples: ImuBuffer, left: int) -> None:
        self.tracker, self.samples, self.left, self._filters = tracker, samples, left, list[tuple[Eskf, Array]]()
        bank = tracker.alignment.bank
        assert bank is not None
        self.mode, self.until_ns = tracker.mode_until(samples.newest_ns)
        members, weights = tracker.alignment.members, shares(bank.members)
        weights += [0.0] * (len(members) - len(bank.members))  # of those without the sensor of the heading
        self._is_whole, factor, root = tracker.shows_mixture, bank.lead.variance_factor, 0.0
        ratio, limits = tracker.lasting_ratio if self._is_whole else 1.0, tracker.limits
        shown = [(m.filter, share) for m, share in zip(members, weights, strict=True) if share or not self._is_whole]
        for eskf, share in shown:  # the others follow when they are asked: Tracker.propagate
            factors = (factor, ratio) if eskf is shown[-1][0] else _NO_FACTORS
            self._filters.append((eskf, np.array((*limits, share, root, *factors))))
            root = math.sqrt(factor)
        added = tracker.added if self._is_whole else None
        self._added = _NOTHING if added is None else added

    def take(self, sample: ImuSample) -> tuple[Array, Array] | None:
        """Append the sample and propagate: nav (16,) and covariance (15, 15) to publish; None: out of bounds."""
        samples, t_ns, lead = self.samples, sample.t_ns, self._filters[0][0]
        index, nav, covariance = samples.begin_next(), np.empty(_XN), np.empty((_N, _N))
        buffer, read = (samples.t_ns, samples.u, samples.known), (*sample.gyro_b, *sample.accel_b)
        for eskf, rules in self._filters:
            slow = eskf.slow
            eskf.sound = _take(
                eskf.x, eskf.cov, *buffer, index, eskf.t_ns, t_ns, *read, eskf.constants, slow.tau_s, slow.psd, rules,
                self._added, nav, covariance,
            )  # fmt: skip
            eskf.t_ns = t_ns
        self.tracker.core.t_ns = t_ns
        samples.end_next(t_ns)
        self.left -= 1
        if not lead.sound:  # or out of bounds
            lead.sound = sound(lead.x, lead.cov)
            return None
        return nav, covariance if self._is_whole else self.tracker.shown_covariance(covariance)


@njit(cache=True, error_model="numpy")
def _take(
    x: Array, cov: Array, t_ns: NDArray[np.int64], u: Array, known: Array, i: int, from_ns: int, to_ns: int,
    wx: float, wy: float, wz: float, fx: float, fy: float, fz: float, c: Array, tau: Array, psd: Array,
    rules: Array, added: Array, nav: Array, covariance: Array,
) -> bool:  # fmt: skip
    """x, P (n, n) of a hypothesis to sample i (w, f) at to_ns; whether the state is sound.

    rules (8,): the four limits of bounds.is_within, share, root, factor, ratio; one array, for each argument costs time. root: 0
    of the leading one, which comes first: it puts the sample into the buffer, nav <- x, covariance <- share P of the 15.
    False: or it may be out of bounds. Of another one f^1/2: its share of the covariance is added (mixture.mix). factor: 0 but of
    the last one, then f: covariance <- ratio f covariance, added (3, 3) to the position's. The rest as imu.propagate and
    bounds.is_within.
    """
    share, root, factor, ratio = rules[4], rules[5], rules[6], rules[7]
    leads = root == 0.0
    if leads:
        sampling.put(t_ns, u, known, i, i + 1, to_ns, wx, wy, wz, fx, fy, fz)
    good: bool = imu.advance(x, cov, np.empty((0, 0)), t_ns, u, known, i + 1, i, from_ns, to_ns, c, tau, psd)
    if leads:
        for k in range(_XN):
            nav[k] = x[k]
        for k in range(_N):
            for j in range(_N):
                covariance[k, j] = share * cov[k, j]
        good = good and is_within(x, cov, rules[0], rules[1], rules[2], rules[3])
    elif share > 0.0:
        mix(covariance, share, cov, nav, x, root)
    if factor > 1.0:
        scale(covariance, factor)
    if factor > 0.0:
        for k in range(_N):
            for j in range(_N):
                covariance[k, j] *= ratio
        for k in range(3):
            for j in range(3):
                covariance[_P + k, _P + j] += added[k, j]
    return good
