"""The gyroscope against other attitudes and the magnetic field."""

from itertools import permutations, product
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from logs.findings.relation import Relation, relation
from logs.findings.streams import ATTITUDE, ODOMETRY, Cause, Stream
from models.messages import Array

_STEP_S: Final = 0.4  # between the attitudes that are compared, at least
_LONGEST_S: Final = 2.0
_LEAST_STEPS: Final = 20
_LEAST_RAD: Final = 0.06  # RMS of a step's turn; noise of a fix is 0.02
_SAME: Final = 0.35  # share of the turns that equality leaves
_LATE_S: Final = [s for s in np.arange(-1.5, 1.55, 0.1) if abs(s) > 0.25]
_OFFSET_RAD_S: Final = 0.12  # biases of small gyroscopes are less
_ORDERS: Final = (
    ((1.0, 1.0, 1.0, 1.0), [3, 0, 1, 2], "its quaternions are in the order x, y, z, w"),
    ((1.0, -1.0, -1.0, -1.0), [0, 1, 2, 3], "its attitude is inverse, that of the world in the body"),
    ((1.0, -1.0, -1.0, -1.0), [3, 0, 1, 2], "its quaternions are in the order x, y, z, w, and inverse"),
)
_FIELD_STEP_S: Final = 0.4
_FIELD_REST: Final = 0.5  # of the field's changes, that the right axes leave
_FIELD_GAIN: Final = 0.5
_FIELD_BAND_T: Final = (5e-6, 3e-4)  # Earth's is 22 to 67 uT, a vehicle adds to it
_FIELD_UNITS: Final = (("gauss", 1e-4), ("uT", 1e-6), ("mgauss", 1e-7), ("nT", 1e-9))
_SIGNED: Final = [
    np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
]  # the 48 ways to exchange and mirror axes


class Turned:
    """Gyroscope integral, (3,) rad, within the stream; nan outside."""

    def __init__(self, imu: Stream) -> None:
        ordered = imu.in_order()
        self._t = ordered.t_s
        rate = ordered.values[:, :3]
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(self._t)[:, None]
        self._angle = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def at(self, t_s: Array) -> Array:
        """(n, 3)."""
        return np.stack([np.interp(t_s, self._t, angle, np.nan, np.nan) for angle in self._angle.T], axis=1)


def attitude_relation(turned: Turned, stream: Stream) -> Relation | None:
    """log(q_i^-1 q_i+1) by the gyroscope's integral; None: too little turning."""
    turns = _turns(turned, stream)
    return None if turns is None else relation(*turns[:2])


def reordered(turned: Turned, stream: Stream, most: float = _SAME) -> Cause | None:
    """Quaternions that fit the gyroscope in another order, or inverse; most: share of the turns left so."""
    for sign, order, what in _ORDERS:
        q = stream.values[:, -4:][:, order] * sign
        found = attitude_relation(turned, stream._replace(values=np.hstack([stream.values[:, :-4], q])))
        if found is not None and found.equal < min(most, _SAME):
            return Cause(what, float(stream.arrived_s[0]), "give w first, and the attitude of the body in the world")
    return None


def late(turned: Turned, stream: Stream, equal: float) -> Cause | None:
    """Attitudes that fit the gyroscope at other times, of which equality leaves less than half."""
    tried = [(s, attitude_relation(turned, stream._replace(t_s=stream.t_s - s))) for s in _LATE_S]
    late_s, best = min(((s, r.equal) for s, r in tried if r is not None), key=lambda item: item[1], default=(0.0, np.inf))
    if best > min(_SAME, 0.5 * equal):
        return None
    what = f"its stamps are {abs(late_s):.1f} s {'late' if late_s > 0.0 else 'early'} against the gyroscope"
    return Cause(what, float(stream.arrived_s[0]), "set its delay_s, or mend the stamps")


def offset(turned: Turned, stream: Stream) -> Array | None:
    """Mean of (log(q_i^-1 q_i+1) - turn) / h, (3,) rad/s; None: nothing out of the ordinary."""
    turns = _turns(turned, stream)
    if turns is None:
        return None
    a, b, h = turns
    mean = np.asarray(np.median((b - a) / h[:, None], axis=0))
    spread = 1.5 * np.median(np.abs((b - a) / h[:, None] - mean), axis=0) / np.sqrt(len(h))
    far = np.linalg.norm(mean) > _OFFSET_RAD_S and np.linalg.norm(mean) > 5.0 * np.linalg.norm(spread)
    return -mean if far else None


def _turns(turned: Turned, stream: Stream) -> tuple[Array, Array, Array] | None:
    """The gyroscope's turns, the stream's (n, 3) rad, their durations (n,) s."""
    ordered = stream.in_order()
    rows = _apart(ordered.t_s, _STEP_S)
    if len(rows) < _LEAST_STEPS:
        return None
    q = ordered.values[rows, -4:]
    sound = np.linalg.norm(q, axis=1) > 0.1
    rows, q = rows[sound], q[sound]
    t = ordered.t_s[rows]
    R = Rotation.from_quat(q[:, [1, 2, 3, 0]])
    b = (R[:-1].inv() * R[1:]).as_rotvec()
    a, h = np.diff(turned.at(t), axis=0), np.diff(t)
    near = (h < _LONGEST_S) & np.isfinite(a).all(axis=1) & (np.linalg.norm(b, axis=1) < 2.0)
    a, b = a[near], b[near]
    if len(a) < _LEAST_STEPS or np.sqrt(np.mean(np.sum(b**2, axis=1))) < _LEAST_RAD:
        return None
    return a, b, h[near]


def misturned(found: Relation, stream: Stream, name: str) -> Cause | None:
    """Cause of a relation to the gyroscope; name: of the IMU."""
    if not found.differs():
        return None
    since_s = float(stream.arrived_s[0])
    if found.mirrored:
        return Cause(f"its turns are mirrored against those of {name}", since_s, "one axis has the wrong sign")
    if found.angle_deg > 10.0:
        roll, pitch, yaw = Rotation.from_matrix(found.O).as_euler("xyz", degrees=True) + 0.0
        what = f"its axes are turned by {found.angle_deg:.0f} degrees against those of {name}"
        rpy = f"roll {roll:.0f}, pitch {pitch:.0f}, yaw {yaw:.0f} deg"
        kind = "odometry" if stream.kind == ODOMETRY else "autopilot" if stream.kind == ATTITUDE else "source"
        body = f"let the {kind} give the pose of the body, forward-left-up, not of its camera"
        return Cause(f"{what} ({rpy})", since_s, f"{body}; if it is that of the IMU's own axes, leave out [imu] mounting_rpy_deg")
    return Cause(
        f"it turns {found.scale:.3g} times as much as {name}", since_s, "see its units: rad, or the scale of the gyroscope"
    )


def field(turned: Turned, stream: Stream) -> Cause | None:
    """Field changes m_b against the turn phi, for each axis exchange and mirror S:

    S dm = (exp(-phi) - 1) (S m - b),   b: hard iron, by least squares
    """
    since_s, length = float(stream.arrived_s[0]), float(np.median(np.linalg.norm(stream.values, axis=1)))
    if not _FIELD_BAND_T[0] < length < _FIELD_BAND_T[1]:
        what = f"the field is {1e6 * length:.3g} uT strong, Earth's is 22 to 67: "
        unit = next((u for u, f in _FIELD_UNITS if 2e-5 < f * length < 2e-4), "")
        return Cause(what + (f"it is in {unit}, not in tesla" if unit else "wrong unit"), since_s, "send tesla")
    ordered = stream.in_order()
    rows = _apart(ordered.t_s, _FIELD_STEP_S)
    t, m = ordered.t_s[rows], ordered.values[rows]
    phi = np.diff(turned.at(t), axis=0)
    near = (np.diff(t) < _LONGEST_S) & np.isfinite(phi).all(axis=1)
    if near.sum() < _LEAST_STEPS:
        return None
    back = Rotation.from_rotvec(-phi[near]).as_matrix() - np.eye(3)
    before, change = m[:-1][near], np.diff(m, axis=0)[near]
    rest = [_field_rest(back, before @ S.T, change @ S.T) for S in _SIGNED]
    here, best = rest[0], min(rest)
    if best > _FIELD_REST or best > _FIELD_GAIN * here:
        return None
    # of those that explain it nearly as well, the one that changes least
    S = min((S for S, r in zip(_SIGNED, rest, strict=True) if r < 1.2 * best + 0.02), key=lambda S: float(np.sum(np.eye(3) != S)))
    flipped = " and ".join("xyz"[k] for k in range(3) if S[k, k] < 0.0)
    what = f"mirrored in {flipped}" if np.count_nonzero(np.diag(S)) == 3 else "exchanged"
    advice = "turn it by [magnetometer] mounting_rpy_deg" if np.linalg.det(S) > 0.0 else "mend the sign of the axis in its driver"
    return Cause(f"its axes are {what} against those of the gyroscope", since_s, advice)


def _field_rest(back: Array, m: Array, change: Array) -> float:
    left = change - np.einsum("nij,nj->ni", back, m)
    A = -back.reshape(-1, 3)
    b, *_ = np.linalg.lstsq(A.T @ A + 1e-3 * np.trace(A.T @ A) * np.eye(3), A.T @ left.ravel(), rcond=None)
    return float(np.sum((left.ravel() - A @ b) ** 2) / max(float(np.sum(change**2)), 1e-30))


def _apart(t_s: Array, step_s: float) -> Array:
    _, first = np.unique(np.floor((t_s - t_s[0]) / step_s) if len(t_s) else t_s, return_index=True)
    return np.asarray(first)
