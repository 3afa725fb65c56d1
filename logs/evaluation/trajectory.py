"""Trajectories as arrays, ENU, FLU."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from logs.evaluation.metrics import Indices, Mask, Times, rotation
from models.frames import Origin
from models.messages import Array

POSE_TYPES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped")
_DOUBLES = dict(zip(POSE_TYPES, (85, 43, 7), strict=True))  # every message of these types ends with so many
_NOT_GIVEN_RAD2 = 10.0  # an attitude variance from here on says "not given"
_MOVED_M = 1.0  # in a log: a twist of zeros was not filled in
_ABSURD = 1e15  # no length, speed or variance is so large: bytes that are no number of ours
_ENCAPSULATION = 4  # bytes before the CDR body


@dataclass(frozen=True, slots=True)
class Trajectory:
    """n poses by distinct stamps; nan: not given.

    p (n, 3) m; q_wxyz (n, 4) body -> map; v_body (n, 3) m/s; covariance (n, 6, 6), x y z rx ry rz; v_covariance (n, 3, 3).
    """

    t_ns: Times
    arrived_ns: Times
    p: Array
    q_wxyz: Array
    v_body: Array
    covariance: Array
    v_covariance: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: Indices | Mask | slice) -> Self:
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))

    @property
    def v(self) -> Array:
        """Velocity in map axes, (n, 3) m/s."""
        v = np.full_like(self.v_body, np.nan)
        given = self.has_attitude
        if given.any():
            v[given] = rotation(self.q_wxyz[given]).apply(self.v_body[given])
        return v

    @property
    def has_attitude(self) -> Mask:
        """Rows with an attitude, (n,)."""
        return np.asarray(np.isfinite(self.q_wxyz).all(axis=1))


def decode(schema: str, data: Sequence[bytes], arrived_ns: Sequence[int]) -> Trajectory:
    """Trajectory of CDR messages of POSE_TYPES, from their last bytes."""
    size = 8 * _DOUBLES[schema]
    whole = [k for k, d in enumerate(data) if len(d) >= size + 2 * _ENCAPSULATION + 8]
    little = all(data[k][1] & 1 for k in whole)
    stamps = _stamps([data[k] for k in whole])
    x = np.frombuffer(b"".join(data[k][-size:] for k in whole), "<f8" if little else ">f8").astype(float, copy=False)
    return from_rows(stamps, np.array([arrived_ns[k] for k in whole], np.int64), x.reshape(-1, _DOUBLES[schema]))


def _stamps(data: Sequence[bytes]) -> Times:
    little = all(d[1] & 1 for d in data)
    head = b"".join(d[_ENCAPSULATION : _ENCAPSULATION + 8] for d in data)
    sec_nanosec = np.frombuffer(head, [("sec", "<i4"), ("nanosec", "<u4")] if little else [("sec", ">i4"), ("nanosec", ">u4")])
    stamps: Times = sec_nanosec["sec"].astype(np.int64) * 1_000_000_000 + sec_nanosec["nanosec"]
    return stamps


def from_rows(t_ns: Times, arrived_ns: Times, x: Array) -> Trajectory:
    """Trajectory of rows of 3 (position), 7 (pose), 43 (covariance) or 85 (twist) doubles.

    The first of equal stamps counts; quaternions (xyzw) not of length 1 are dropped, and a twist of zeros where positions move.
    """
    t_ns, first = np.unique(t_ns, return_index=True)
    x, arrived_ns = x[first], arrived_ns[first]
    n, width = x.shape
    x[~(np.abs(x) < _ABSURD)] = np.nan
    full = x if width == _DOUBLES[POSE_TYPES[0]] else np.hstack([x, np.full((n, _DOUBLES[POSE_TYPES[0]] - width), np.nan)])
    p, q_xyzw, covariance = full[:, 0:3], full[:, 3:7], full[:, 7:43].reshape(n, 6, 6)
    norm = np.linalg.norm(q_xyzw, axis=1)
    given = (np.abs(norm - 1.0) < 0.5) & ~(np.diagonal(covariance, axis1=1, axis2=2)[:, 3:] >= _NOT_GIVEN_RAD2).any(axis=1)
    q_wxyz = np.full((n, 4), np.nan)
    q_wxyz[given] = np.roll(q_xyzw[given], 1, axis=1) / norm[given, None]
    if n and not full[:, 43:46].any() and np.ptp(p, axis=0).max() > _MOVED_M:
        full[:, 43:] = np.nan
    return Trajectory(t_ns, arrived_ns, p, q_wxyz, full[:, 43:46], covariance, full[:, 49:85].reshape(n, 6, 6)[:, :3, :3])


def decode_geodetic(data: Sequence[bytes], arrived_ns: Sequence[int], origin: Origin) -> Trajectory:
    """Trajectory of NavSatFix CDR messages, in map."""
    rows, stamps, arrivals = [], [], []
    for d, arrived in zip(data, arrived_ns, strict=True):
        start = _ENCAPSULATION + (len(d) - _ENCAPSULATION - 97) // 8 * 8  # doubles are aligned to 8
        if start < _ENCAPSULATION + 16 or not d[1] & 1:
            continue
        status = int(np.frombuffer(d, "i1", 1, _navsat_status(d))[0])
        lla_cov = np.frombuffer(d, "<f8", 12, start)
        if status >= 0 and np.isfinite(lla_cov[:3]).all():
            n, e, down = origin.to_ned(*lla_cov[:3])
            covariance = np.full((6, 6), np.nan)
            covariance[:3, :3] = lla_cov[3:].reshape(3, 3)
            rows.append(np.concatenate([[e, n, -down], np.full(4, np.nan), covariance.ravel()]))
            stamps.append(_stamps([d])[0])
            arrivals.append(arrived)
    return from_rows(np.array(stamps, np.int64), np.array(arrivals, np.int64), np.reshape(rows, (-1, 43)).astype(float))


def _navsat_status(d: bytes) -> int:
    return _ENCAPSULATION + 12 + int(np.frombuffer(d, "<u4", 1, _ENCAPSULATION + 8)[0])


def nearest(t_ns: Times, wanted_ns: Times, tolerance_ns: int) -> tuple[Indices, Mask]:
    """Nearest row of sorted t_ns, and whether within tolerance."""
    if not len(t_ns):
        return np.zeros(len(wanted_ns), np.intp), np.zeros(len(wanted_ns), bool)
    right = np.clip(np.searchsorted(t_ns, wanted_ns), 0, len(t_ns) - 1)
    left = np.maximum(right - 1, 0)
    row = np.where(np.abs(wanted_ns - t_ns[left]) <= np.abs(t_ns[right] - wanted_ns), left, right)
    return row, np.abs(t_ns[row] - wanted_ns) <= tolerance_ns


def interpolate(trajectory: Trajectory, wanted_ns: Times, longest_ns: int) -> tuple[Trajectory, Mask]:
    """The trajectory at wanted stamps, and which are in no hole beyond longest_ns.

    p = (1 - w) p_a + w p_b,   R = R_a exp(w log(R_a' R_b)),   w = (t - t_a) / (t_b - t_a)
    """
    n = len(trajectory)
    if not n:
        return trajectory, np.zeros(len(wanted_ns), bool)
    b = np.clip(np.searchsorted(trajectory.t_ns, wanted_ns), 0, n - 1)
    exact = trajectory.t_ns[b] == wanted_ns
    a = np.where(exact, b, np.maximum(b - 1, 0))
    ta, tb = trajectory.t_ns[a], trajectory.t_ns[b]
    inside = exact | ((ta < wanted_ns) & (wanted_ns < tb) & (tb - ta <= longest_ns))
    a, b, ta, tb, t = a[inside], b[inside], ta[inside], tb[inside], wanted_ns[inside]
    w = np.where(tb > ta, (t - ta) / np.maximum(tb - ta, 1), 0.0)

    def blend(x: Array) -> Array:
        wx = w.reshape(-1, *(1,) * (x.ndim - 1))
        mixed: Array = (1.0 - wx) * x[a] + wx * x[b]
        return mixed

    others = (trajectory.p, trajectory.v_body, trajectory.covariance, trajectory.v_covariance)
    p, v_body, covariance, v_covariance = (blend(x) for x in others)
    arrived = np.maximum(trajectory.arrived_ns[a], trajectory.arrived_ns[b])
    q_wxyz = _slerp(trajectory.q_wxyz[a], trajectory.q_wxyz[b], w)
    return Trajectory(t, arrived, p, q_wxyz, v_body, covariance, v_covariance), inside


def _slerp(q_a: Array, q_b: Array, w: Array) -> Array:
    q = np.full_like(q_a, np.nan)
    given = np.isfinite(q_a).all(axis=1) & np.isfinite(q_b).all(axis=1)
    if given.any():
        start = rotation(q_a[given])
        turn = (start.inv() * rotation(q_b[given])).as_rotvec()
        q[given] = (start * Rotation.from_rotvec(w[given, None] * turn)).as_quat(scalar_first=True)
    return q
