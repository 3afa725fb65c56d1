"""Poses against the accelerometer: frame, stamps and attitude (docs/troubleshooting.md).

W = int int R_nb f dt dt [m],   D2 x = (x_2 - x_1) / h_2 - (x_1 - x_0) / h_1,   D2 p = D2 W + g (h_1 + h_2) / 2
"""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from logs.findings.position import of_scale
from logs.findings.relation import Relation, relation
from logs.findings.streams import POSE, Cause, Stream
from models.frames import GRAVITY
from models.messages import Array

_STEP_S: Final = 1.0  # between the positions that are compared, at least
_LONGEST_S: Final = 3.0
_LEAST_STEPS: Final = 15
_LEAST_M_S: Final = 0.3  # RMS of a change of velocity; noise of a fix makes 0.1
_UP_DEG: Final = 20.0  # further off, its vertical is another
_OUTLIER: Final = 4.0  # times the median
_WRONG: Final = 0.7  # share of the changes that equality leaves; 0.4 with good poses
_EXPLAINED, _UNEXPLAINED = 0.45, 0.7  # by axes and scale
_SIGMAS: Final = 3.0
_SCALE: Final = 1.4
_LATE_S: Final = [s for s in np.arange(-1.2, 1.25, 0.1) if abs(s) > 0.25]
_LATE_WRONG, _LATE_GAIN = 0.45, 0.6
_AXES: Final = ("north", "east", "down")
_ADVICE: Final = "let the source give north, east, down (ROS: east, north, up) in metres, position and attitude alike"


def pulled(imu: Stream, poses: Stream) -> Cause | None:
    """What is wrong with the frame, stamps or attitude of poses, or None."""
    found = _changes(imu, poses)
    if found is None:
        return None
    up, force, change = found
    since_s = float(poses.arrived_s[0])
    off_deg = float(np.degrees(np.arccos(np.clip(-up[2] / np.linalg.norm(up), -1.0, 1.0))))
    if off_deg > _UP_DEG and poses.kind == POSE:
        return Cause(f"its down is {off_deg:.0f} degrees from gravity", since_s, _ADVICE)
    if off_deg > _UP_DEG or np.sqrt(np.mean(np.sum(force**2, axis=1))) < _LEAST_M_S:
        return None
    here = relation(force, change)
    if here.rest < _EXPLAINED and not here.mirrored and here.angle_deg < 30.0 and _scaled(here):
        return Cause(f"its positions, against the accelerometer, are {of_scale(here.scale, here.rest)}", since_s, _ADVICE)
    if here.equal < _LATE_WRONG:
        return None
    if here.equal > _WRONG and here.rest < _EXPLAINED and here.differs(rest=_EXPLAINED, angle_deg=30.0, scale=2.0):
        return Cause(_words(here), since_s, _ADVICE)
    late_s, then = min(((s, _equal(imu, poses, s)) for s in _LATE_S), key=lambda item: item[1])
    if then < _LATE_GAIN * here.equal:
        side = "late" if late_s > 0.0 else "early"
        return Cause(
            f"its stamps are {abs(late_s):.1f} s {side} against the accelerometer", since_s, "set its delay_s, or mend the stamps"
        )
    if here.equal > _WRONG and here.rest > _UNEXPLAINED and _contradicts(force, change):
        what = "its attitude does not fit: with it the accelerometer contradicts its positions"
        return Cause(what, since_s, "give the attitude of the body, or mark it as not given (variance of 10 rad^2)")
    return None


def _contradicts(a: Array, b: Array) -> bool:
    """Is the slope of b on a below 1 by 3 sigma, which noise of the positions leaves at 1?

    k = sum a.b / sum |a|^2,   sigma^2 = sum |b - k a|^2 / ((3 n - 1) sum |a|^2)
    """
    power = float(np.sum(a**2))
    k = float(np.sum(a * b)) / power
    return 1.0 - k > _SIGMAS * float(np.sqrt(np.sum((b - k * a) ** 2) / ((a.size - 1) * power)))


def _scaled(found: Relation) -> bool:
    """Is the scale, which noise makes smaller by up to 1 - rest, another?"""
    return found.scale > _SCALE or found.scale < (1.0 - found.rest) / _SCALE


def _equal(imu: Stream, poses: Stream, late_s: float) -> float:
    found = _changes(imu, poses, late_s)
    return np.inf if found is None else relation(*found[1:]).equal


def _words(found: Relation) -> str:
    at = np.abs(found.O).argmax(axis=1)
    if np.abs(found.O).max(axis=1).min() > 0.8 and (found.mirrored or found.angle_deg > 30.0):
        moved = " and ".join(_AXES[k] for k in range(3) if at[k] != k)
        signs = " and ".join(_AXES[k] for k in range(3) if at[k] == k and found.O[k, k] < 0.0)
        parts = [f"{moved} are exchanged" if moved else "", f"{signs} reversed" if signs else ""]
        return f"its positions against the accelerometer: {', '.join(p for p in parts if p)}"
    if found.mirrored or found.angle_deg > 30.0:
        how = "mirrored" if found.mirrored else f"turned by {found.angle_deg:.0f} degrees"
        return f"its positions are {how} against the accelerometer"
    return f"its positions, against the accelerometer, are {of_scale(found.scale, found.rest)}"


def _changes(imu: Stream, poses: Stream, late_s: float = 0.0) -> tuple[Array, Array, Array] | None:
    """Mean R_nb f (3,); D2 W + g (h_1 + h_2) / 2 and D2 p, (n, 3) m/s; None: too few."""
    samples, ordered = imu.in_order(), poses.in_order()
    sound = np.linalg.norm(ordered.values[:, -4:], axis=1) > 0.1
    t, p, q = ordered.t_s[sound] - late_s, ordered.values[sound, :3], ordered.values[sound, -4:]
    if len(t) < _LEAST_STEPS:
        return None
    inside = (samples.t_s >= t[0]) & (samples.t_s <= t[-1])
    t_f = samples.t_s[inside]
    if len(t_f) < _LEAST_STEPS:
        return None
    force = Slerp(t, Rotation.from_quat(q[:, [1, 2, 3, 0]]))(t_f).apply(samples.values[inside, 3:6])
    dt = np.diff(t_f, prepend=t_f[0])[:, None]
    way = np.cumsum(np.cumsum(force * dt, axis=0) * dt, axis=0)
    _, rows = np.unique(np.floor((t - t[0]) / _STEP_S), return_index=True)
    t, p = t[rows], p[rows]
    at = np.stack([np.interp(t, t_f, w, np.nan, np.nan) for w in way.T], axis=1)
    h = np.diff(t)
    near = (h[1:] < _LONGEST_S) & (h[:-1] < _LONGEST_S)
    a, b = (np.diff(np.diff(x, axis=0) / h[:, None], axis=0) for x in (at, p))
    a[:, 2] += 0.5 * GRAVITY * (h[1:] + h[:-1])
    off = np.linalg.norm(b - a, axis=1)
    near &= np.isfinite(off)
    near &= off <= _OUTLIER * np.median(off[near]) if near.any() else False  # a false fix is no frame
    return (force.mean(axis=0), a[near], b[near]) if near.sum() >= _LEAST_STEPS else None
