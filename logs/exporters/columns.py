"""A trajectory as columns with units; nan: unknown.

map is ENU, body FLU; roll, pitch, heading: FRD in NED, clockwise from north.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pymap3d
from numpy.typing import NDArray

from logs.evaluation.collected import ODOMETRY_TOPIC, HealthPoint, read
from logs.evaluation.metrics import Times, rotation
from logs.evaluation.trajectory import Trajectory
from logs.store.reader import Attachment, LogError
from logs.store.recorder import CONFIG_ATTACHMENT
from models.frames import ENU_FROM_NED, FLU_FROM_FRD, Origin
from models.messages import Array
from models.radius import horizontal_radius
from models.untrusted import toml_text

Columns: TypeAlias = Mapping[str, NDArray[Any]]  # name -> (n,), all of one length; t_ns is integer, mode is text

_NOT_GIVEN_M2: Final = 9e4  # a variance from here on says "not given"


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of a topic. origin: (lat_deg, lon_deg, alt_m)."""

    topic: str
    columns: Columns
    origin: tuple[float, float, float] | None
    geoid_m: float

    def __len__(self) -> int:
        return len(self.columns["t_ns"])

    def __getitem__(self, rows: NDArray[Any]) -> "Table":
        return replace(self, columns={name: column[rows] for name, column in self.columns.items()})


def table(log: Path, topic: str = ODOMETRY_TOPIC, rate_hz: float = 0.0, progress: Callable[[float], None] | None = None) -> Table:
    """Estimate or other poses; rate_hz: at most, 0: all. Raises LogError."""
    if topic == ODOMETRY_TOPIC:
        collected = read(log, progress=progress)
        trajectory, health = collected.estimate, collected.health
    else:
        collected = read(log, topic, progress)
        trajectory, health = collected.truth, ()
    if not len(trajectory):
        raise LogError(f"{log}: holds no {topic}")
    if rate_hz > 0.0:
        trajectory = trajectory[_thinned(trajectory.t_ns, rate_hz)]
    origin = collected.origin
    columns = _columns(trajectory, origin, health)
    return Table(topic, columns, origin.lla if origin else None, _geoid_m(collected.attachments))


def _geoid_m(attachments: Iterable[Attachment]) -> float:
    texts = [a.data.decode(errors="replace") for a in attachments if a.name == CONFIG_ATTACHMENT]
    try:
        return float(toml_text.table(texts[-1])["map"]["geoid_m"])
    except (IndexError, KeyError, TypeError, ValueError):
        return 0.0


def _thinned(t_ns: Times, rate_hz: float) -> NDArray[np.bool_]:
    slot = np.floor((t_ns - t_ns[0]) * (1e-9 * rate_hz) + 1e-6).astype(np.int64)
    kept: NDArray[np.bool_] = np.concatenate([[True], np.diff(slot) > 0])
    return kept


def _columns(trajectory: Trajectory, origin: Origin | None, health: tuple[HealthPoint, ...]) -> Columns:
    t_ns, p, v, P = trajectory.t_ns, trajectory.p, trajectory.v, trajectory.covariance
    sigma = _sigma(P)
    columns: dict[str, NDArray[Any]] = {"t_ns": t_ns, "t_s": (t_ns - t_ns[0]) * 1e-9}
    if origin is not None:
        columns |= zip(("lat_deg", "lon_deg", "alt_m"), pymap3d.enu2geodetic(*p.T, *origin.lla), strict=True)
    columns |= zip(("east_m", "north_m", "up_m"), p.T, strict=True)
    columns |= zip(("v_east_m_s", "v_north_m_s", "v_up_m_s"), v.T, strict=True)
    columns |= zip(("qx", "qy", "qz", "qw"), np.roll(trajectory.q_wxyz, -1, axis=1).T, strict=True)
    columns |= zip(("roll_deg", "pitch_deg", "heading_deg"), _angles(trajectory).T, strict=True)
    columns |= zip(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigma[:, :3].T, strict=True)
    columns["radius95_m"] = np.where(np.isfinite(sigma[:, :2]).all(axis=1), horizontal_radius(P[:, :2, :2]), np.nan)
    columns["sigma_heading_deg"] = np.rad2deg(sigma[:, 5])
    if health:
        begins = np.array([h.t_ns for h in health], np.int64)
        row = np.maximum(np.searchsorted(begins, t_ns, side="right") - 1, 0)
        columns["mode"] = np.array([h.mode for h in health])[row]
    return columns


def _sigma(P: Array) -> Array:
    variances = np.diagonal(P, axis1=1, axis2=2)
    given = (variances >= 0.0) & (variances < _NOT_GIVEN_M2)
    return np.sqrt(np.where(given, variances, np.nan))


def _angles(trajectory: Trajectory) -> Array:
    """Degrees (n, 3): R_nb = C_ned,enu R_map,flu C_flu,frd = Rz(heading) Ry(pitch) Rx(roll)."""
    angles, given = np.full((len(trajectory), 3), np.nan), trajectory.has_attitude
    if given.any():
        R_nb = ENU_FROM_NED.T @ rotation(trajectory.q_wxyz[given]).as_matrix() @ FLU_FROM_FRD
        yaw, roll = np.arctan2(R_nb[:, 1, 0], R_nb[:, 0, 0]), np.arctan2(R_nb[:, 2, 1], R_nb[:, 2, 2])
        pitch = -np.arcsin(np.clip(R_nb[:, 2, 0], -1.0, 1.0))
        angles[given] = np.rad2deg(np.column_stack([roll, pitch, np.mod(yaw, 2.0 * np.pi)]))
    return angles
