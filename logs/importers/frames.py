"""Foreign axes to NED and FRD: "frd", "flu", "urf"; "ned", "enu".

    x_frd = B x_file,  x_ned = W x_file,  R_nb = W R_file B^T

Left-handed axes are refused.
"""

import numpy as np

from logs.importers.recording import Times
from logs.store.reader import LogError
from models import so3
from models.messages import Array

_BODY = {"f": (1, 0, 0), "b": (-1, 0, 0), "r": (0, 1, 0), "l": (0, -1, 0), "d": (0, 0, 1), "u": (0, 0, -1)}
_WORLD = {"n": (1, 0, 0), "s": (-1, 0, 0), "e": (0, 1, 0), "w": (0, -1, 0), "d": (0, 0, 1), "u": (0, 0, -1)}


def body_axes(letters: str) -> Array:
    """B (3, 3), body axes -> FRD. Raises LogError."""
    return _axes(letters, _BODY, "axes", "frd, flu or urf: of x, y, z each, forward/back, right/left or up/down")


def world_axes(letters: str) -> Array:
    """W (3, 3), world axes -> NED. Raises LogError."""
    return _axes(letters, _WORLD, "world", "ned or enu: of x, y, z each, north/south, east/west or up/down")


def _axes(letters: str, directions: dict[str, tuple[int, int, int]], name: str, expected: str) -> Array:
    if len(letters) != 3 or not set(letters) <= directions.keys():
        raise LogError(f"--{name} {letters}: expected three letters, such as {expected}")
    columns = np.array([directions[c] for c in letters], float).T
    determinant = round(float(np.linalg.det(columns)))
    if determinant != 1:
        wrong = "is left-handed" if determinant else "names one direction twice"
        raise LogError(f"--{name} {letters}: {wrong}; expected something like {expected}")
    return columns


def turned(v: Array, axes: Array) -> Array:
    """axes @ v per row (n, 3), a signed permutation: nan keeps its component."""
    order = np.argmax(np.abs(axes), axis=1)
    return np.asarray(v[:, order] * axes[np.arange(3), order])


def attitude(q_file_wxyz: Array, W: Array, B: Array) -> Array:
    """q_nb_wxyz (n, 4), normalised, of body-to-world attitudes (n, 4); nan stays."""
    q_w, q_b = so3.from_matrix(W), so3.from_matrix(B)
    turn = np.stack([so3.multiply(so3.multiply(q_w, e), so3.conjugate(q_b)) for e in np.eye(4)], axis=1)
    return normalised(q_file_wxyz @ turn.T)


def normalised(q: Array) -> Array:
    """q / |q| per row (n, 4); nan for |q| = 0."""
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    return q / np.where(norm > 0.0, norm, np.nan)


def attitude_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """q_nb_wxyz (n, 4) of roll, pitch, yaw (n,) [rad]: R_nb = Rz(yaw) Ry(pitch) Rx(roll)."""
    half = 0.5 * np.stack([roll, pitch, yaw])
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=1)


def attitude_at(t_ns: Times, known_ns: Times, q_known: Array, gap_ns: int) -> Array:
    """Attitudes (n, 4) at t_ns between neighbours; nan if gap_ns apart; known_ns ascends."""
    q = np.full((len(t_ns), 4), np.nan)
    if len(known_ns) < 2:
        return q
    after = np.clip(np.searchsorted(known_ns, t_ns), 1, len(known_ns) - 1)
    before = after - 1
    span = np.maximum(known_ns[after] - known_ns[before], 1)
    share = ((t_ns - known_ns[before]) / span)[:, np.newaxis]
    sign = np.where(np.sum(q_known[before] * q_known[after], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    between = (share >= 0.0) & (share <= 1.0) & (span < gap_ns)[:, np.newaxis]
    return np.where(between, normalised((1.0 - share) * q_known[before] + share * sign * q_known[after]), np.nan)
