"""The IMU samples that the filter may still need, in order of their time of validity."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import sampling, so3
from models.messages import Array, ImuSample


class ImuBuffer:
    """Samples in time order: t_ns (capacity,) int64, u (capacity, 6) gyro, accel, `count` valid.

    known (capacity, sampling.SIZE): sampling interval; has_forgotten: older ones were dropped.
    """

    __slots__ = ("count", "has_forgotten", "known", "newest_ns", "previous_ns", "t_ns", "u")

    def __init__(self, capacity: int = 4096) -> None:
        self.t_ns = np.zeros(capacity, np.int64)
        self.u = np.zeros((capacity, 6))
        self.known = np.zeros((capacity, sampling.SIZE))
        self.count = 0
        self.has_forgotten = False
        self.newest_ns = self.previous_ns = -(2**62)

    def insert(self, s: ImuSample) -> bool:
        """Insert a sample; False where one of the same stamp stays: the smaller (as a tuple), whatever the order of arrival."""
        k = self.begin_next()
        end = k + 1
        if s.t_ns <= self.newest_ns:
            k = int(self.t_ns[: self.count].searchsorted(s.t_ns))
            if self.t_ns[k] == s.t_ns:
                if s.gyro_b + s.accel_b >= tuple(self.u[k].tolist()):
                    return False
                end = self.count
            else:
                self.t_ns[k + 1 : end] = self.t_ns[k : self.count]
                self.u[k + 1 : end] = self.u[k : self.count]
        sampling.put(self.t_ns, self.u, self.known, k, end, s.t_ns, *s.gyro_b, *s.accel_b)
        if k == self.count:
            self.end_next(s.t_ns)
        elif end > self.count:
            self.previous_ns, self.count = int(self.t_ns[end - 2]), end
        return True

    def begin_next(self) -> int:
        """Index of the next sample."""
        if self.count == len(self.t_ns):
            self._grow()
        return self.count

    def end_next(self, t_ns: int) -> None:
        """It stands there."""
        self.previous_ns, self.newest_ns = self.newest_ns, t_ns
        self.count += 1

    def cut(self, after_ns: int) -> None:
        """Drop the samples later than after_ns."""
        self.count = k = self.first_after(after_ns)
        newest = [-(2**62)] * 2 + self.t_ns[max(k - 2, 0) : k].tolist()
        self.previous_ns, self.newest_ns = newest[-2:]

    def first_after(self, t_ns: int) -> int:
        """Index of the first sample later than t_ns (count where there is none)."""
        if self.previous_ns <= t_ns:
            return self.count - 1 if t_ns < self.newest_ns else self.count
        return int(_later(self.t_ns, self.count, t_ns))

    def turned(self, q_nb_wxyz: Array, from_ns: int, to_ns: int) -> Array:
        """Attitude of from_ns turned on to to_ns: q <- q * exp(gyro dt), each raw sample for the time before it."""
        q, since_ns = q_nb_wxyz, from_ns
        for k in range(self.first_after(from_ns), min(self.first_after(to_ns) + 1, self.count)):
            until_ns = min(int(self.t_ns[k]), to_ns)
            q = so3.multiply(q, so3.quat_exp(self.u[k, :3] * ((until_ns - since_ns) * 1e-9)))
            since_ns = until_ns
        return q

    def forget_before(self, t_ns: int) -> None:
        """Drop samples older than t_ns, once they are half of all (amortised cost)."""
        if self.t_ns[(self.count - 1) // 2] >= t_ns:  # nearly every call
            return
        k = int(self.t_ns[: self.count].searchsorted(t_ns))
        if 2 * k >= self.count:
            self.t_ns[: self.count - k] = self.t_ns[k : self.count]
            self.u[: self.count - k] = self.u[k : self.count]
            self.known[: self.count - k] = self.known[k : self.count]
            self.count -= k
            self.has_forgotten |= k > 0

    def _grow(self) -> None:
        self.t_ns = np.concatenate([self.t_ns, np.zeros_like(self.t_ns)])
        self.u = np.concatenate([self.u, np.zeros_like(self.u)])
        self.known = np.concatenate([self.known, np.zeros_like(self.known)])


@njit(cache=True)
def _later(t_ns: NDArray[np.int64], count: int, than_ns: int) -> int:
    """Index of the first of the `count` stamps that is later; numpy takes twice as long for a single one."""
    first, end = 0, count
    while first < end:
        middle = (first + end) // 2
        if t_ns[middle] <= than_ns:
            first = middle + 1
        else:
            end = middle
    return first
