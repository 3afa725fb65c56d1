"""Axes and unit of fixes, by the accelerations that the IMU feels; the unit by the path of a receiver (docs/decision.md).

    d = (p_2 - p_1) / h_2 - (p_1 - p_0) / h_1,     a = s_2 / h_2 - s_1 / h_1 + u_1,     d = k M a + c + e

h: between fixes at least a second apart, s; u, s: first and second integral of R f + g, R from the attitude of the fix and the
gyroscope. M: signed permutation of north, east, down; k = 1, or a unit's. The attitude may be in ENU and FLU: T R F.

    RSS(k M) = S_dd - 2 k tr(M^T S_da) + k^2 S_aa        (Umeyama 1991)

Another frame: n ln RSS(I) / RSS(k M) > 20, and no linear map is better: n ln RSS(k M) / RSS < 5. A turn about the vertical alone
shows nothing: the heading may be what is wrong.
"""

import itertools
import math

import msgspec
import numpy as np
from msgspec.structs import replace
from numba import njit

from estimator.filter.imu_buffer import ImuBuffer
from estimator.sources.base.faults import LONG_S
from estimator.sources.base.similarity import Similarity, unit_of
from models import imu, so3
from models.frames import ENU_FROM_NED, FLU_FROM_FRD, GRAVITY_N
from models.messages import Array
from models.state import XYZ, X

_SPACING_NS, _LONGEST_NS = 1_000_000_000, 3_000_000_000  # of two fixes that are compared
_PAIRS = 4  # a verdict after each so many, from the second time on
_EVIDENCE, _WORSE = 20.0, 5.0  # ln of the ratio of two frames; of a frame to any linear map
_LEFT = np.array([0.6, 0.35])[:, None, None]  # share of the power that the frame may leave unexplained: k = 1, another
_TURN_LEFT = 0.35  # share of the rotation that the attitudes may
_HEAVY_M_S = 3.0  # mean of a, downwards: the attitude is not that of gravity
_NO_UNIT = 0.5, 2.0  # no unit is so near to a metre
_MAPS = np.array(
    [np.diag(s) @ np.eye(3)[list(p)] for p in ((0, 1, 2), (1, 0, 2)) for s in itertools.product((1.0, -1.0), repeat=3)]
)
_CHANGES = 3.0 - np.trace(_MAPS, axis1=1, axis2=2)  # of two that are as good, the one with fewer
_TURNS = (_CHANGES > 0.0) & (_MAPS[:, 2, 2] > 0.0) & (np.linalg.det(_MAPS) > 0.0)  # about the vertical
_NAMES = (("north", "south"), ("east", "west"), ("down", "up"))
_CONSTANTS = imu.constants(imu.ImuNoise(), imu.Coast(), None)
_AT_REST = np.eye(1, X.SIZE, X.Q.start)[0]
_NO_PAIR = np.zeros((2, 7))
_TINY = 1e-12
_XV, _XQ, _XG = X.V.start, X.Q.start, X.BG.start  # compiled code reads plain integers


class Moments(msgspec.Struct, frozen=True, eq=False):
    """Sums over pairs of ways since t0_ns: of (1, a, d), (2, 7, 7); turned (3,): squared rotation, what attitudes leave of it.

    A way from one fix to the next, (2, 2, 7): what a pair has of its second way, and less of its first, with each attitude.
    """

    t0_ns: int
    sums: Array
    turned: Array

    def also(self, before: Array | None, way: Array, turned: Array) -> "Moments":
        """With one more way, and its pair with the one before."""
        row = way[0] - before[1] if before is not None else _NO_PAIR
        return Moments(self.t0_ns, self.sums + row[:, :, None] * row[:, None], self.turned + turned)

    @property
    def verdict(self) -> tuple[int, Array, float] | None:
        """Attitude, M and k by which the IMU explains the fixes, and no other does; None: not shown."""
        n = self.sums[0, 0, 0]
        if n < 2 * _PAIRS or n % _PAIRS:
            return None
        centred = self.sums[:, 1:, 1:] - self.sums[:, 1:, :1] * self.sums[:, :1, 1:] / n
        s_a, s_da, s_d = centred[:, :XYZ, :XYZ], centred[:, XYZ:, :XYZ], max(float(centred[0, XYZ:, XYZ:].trace()), _TINY)
        s_aa = np.maximum(s_a.trace(axis1=1, axis2=2), _TINY)[:, None]
        along = s_da.reshape(2, -1) @ _MAPS.reshape(len(_MAPS), -1).T
        k = np.maximum(along, 0.0) / s_aa
        k = np.array((np.ones(k.shape), np.where((k > _NO_UNIT[0]) & (k < _NO_UNIT[1]), 1.0, k)))
        left = (s_d - 2.0 * k * along + k * k * s_aa) / s_d  # (k, attitude, M)
        cost = n * np.log(np.maximum(left, _TINY)) + _CHANGES
        wrong = (self.turned[1:] > _TURN_LEFT * self.turned[0]) | (np.abs(self.sums[:, 0, XYZ]) > _HEAVY_M_S * n)
        is_explained = (left < _LEFT) & ~wrong[:, None]
        at = np.unravel_index(int(np.where(is_explained, cost, math.inf).argmin()), left.shape)
        best, asked = float(cost[at]), float(cost[0, 0, 0])
        cost[:, at[1], at[2]] = math.inf
        other = asked if any(at) else float(cost.min())
        is_turn = not at[0] and not at[1] and _TURNS[at[2]]
        if not is_explained[at] or is_turn or other - best <= _EVIDENCE:
            return None
        free = 1.0 - float(np.trace(s_da[at[1]] @ np.linalg.pinv(s_a[at[1]], hermitian=True) @ s_da[at[1]].T)) / s_d
        is_worse = best > n * math.log(max(free, _TINY)) + _CHANGES[at[2]] + _WORSE
        return None if is_worse else (int(at[1]), _MAPS[at[2]], float(k[at]))


class Frame(msgspec.Struct, frozen=True, eq=False):
    """Of one source: its last fix, the way to it, the sums; says: what it gives instead, "" right, None not shown.

    path: against that of a receiver, in the last minute.
    """

    t_ns: int
    p_n: Array
    q_nb_wxyz: Array
    way: Array | None
    moments: Moments
    says: str | None = None
    path: Similarity = Similarity()

    @classmethod
    def of(cls, t_ns: int, p_n: Array, q_nb_wxyz: Array) -> "Frame":
        """At its first fix."""
        return cls(t_ns, p_n, q_nb_wxyz, None, _nothing(t_ns))

    def also(self, t_ns: int, p_n: Array, q_nb_wxyz: Array, samples: ImuBuffer) -> "Frame":
        """With one more fix."""
        between_ns = t_ns - self.t_ns
        if self.says == "" or 0 <= between_ns < _SPACING_NS:
            return self
        i = samples.first_after(self.t_ns)
        if not 0 < between_ns <= _LONGEST_NS or i == 0:
            return replace(self, t_ns=t_ns, p_n=p_n, q_nb_wxyz=q_nb_wxyz, way=None)
        x = imu.moved(_AT_REST, samples.t_ns, samples.u, samples.count, i, self.t_ns, t_ns, _CONSTANTS)
        way, turned = _way(x, between_ns * 1e-9, self.p_n, self.q_nb_wxyz, p_n, q_nb_wxyz)
        moments = self.moments if (t_ns - self.moments.t0_ns) * 1e-9 < LONG_S else _nothing(t_ns)
        moments = moments.also(self.way, way, turned)
        found = moments.verdict
        says = self.says if found is None else _words(*found)
        return Frame(t_ns, p_n, q_nb_wxyz, way, moments, self.says if self.says and says else says, self.path)

    def compared(self, t_ns: int, p_n: Array, g_n: Array) -> "Frame":
        """With a fix at p_n while a receiver is at g_n, (3,) [m]."""
        p, g, t_s = complex(*p_n[:2].tolist()), complex(*g_n[:2].tolist()), t_ns * 1e-9
        path = (self.path if t_s - self.path.t < 0.5 * LONG_S else Similarity()).also(p, g, t_s)
        if self.says is not None or not path.unit:
            return replace(self, path=path)
        return replace(self, path=path, says=f"against the receiver its positions are in {path.unit}, not in metres")

    def is_turned(self, t_ns: int) -> bool:
        """Whether a receiver's path in the last minute is that of these fixes, which are used, turned or scaled."""
        return not self.says and t_ns * 1e-9 - self.path.t < LONG_S and self.path.is_turned


def _words(attitude: int, m: Array, k: float) -> str:
    axes = [_NAMES[a][int(m[row, a] < 0.0)] for row, a in enumerate(np.abs(m).argmax(axis=1))]
    words = [f"positions are ({', '.join(axes)})"] if axes != ["north", "east", "down"] else []
    words += ["attitudes are in ENU and FLU"] if attitude else []
    if k != 1.0:
        name = unit_of(k)
        words.append(f"positions are {k:.3g} times the metres{f': {name}?' if name else ''}")
    return f"against the IMU its {', its '.join(words)}, not (north, east, down) in metres" if words else ""


def _nothing(t_ns: int) -> Moments:
    return Moments(t_ns, np.zeros((2, 7, 7)), np.zeros(XYZ))


@njit(cache=True, error_model="numpy")
def _way(x: Array, h: float, p: Array, q: Array, p_next: Array, q_next: Array) -> tuple[Array, Array]:
    """Way (2, 2, 7) and turned (3,) of Moments, from a fix (p, q) to the next; x (16,): moved by the IMU alone from rest."""
    by_imu, by_fixes = so3.quat_log(x[_XQ:_XG]), so3.quat_log(so3.multiply(so3.conjugate(q), q_next))
    r, way, turned, s, u = so3.matrix(q), np.zeros((2, 2, 7)), np.zeros(3), np.empty(3), np.empty(3)
    for k in range(3):
        s[k], u[k] = x[k] / h - 0.5 * h * GRAVITY_N[k], x[_XV + k] - h * GRAVITY_N[k]
        turned[0] += by_imu[k] ** 2
    for attitude in range(2):
        if attitude == 1:
            r, by_fixes = so3.product(so3.product(ENU_FROM_NED, r), FLU_FROM_FRD), so3.applied(FLU_FROM_FRD, by_fixes)
        mean, gained = so3.applied(r, s), so3.applied(r, u)
        way[0, attitude, 0] = 1.0
        for k in range(3):
            way[:, attitude, 4 + k] = (p_next[k] - p[k]) / h
            way[0, attitude, 1 + k] = mean[k] + 0.5 * h * GRAVITY_N[k]
            way[1, attitude, 1 + k] = way[0, attitude, 1 + k] - (gained[k] + h * GRAVITY_N[k])
            turned[1 + attitude] += (by_fixes[k] - by_imu[k]) ** 2
    return way, turned
