"""A CSV file (or gzipped) as numbers, columns by header name and unit.

Non-numbers: nan; lines of another length: dropped; counted in `notes`.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from logs.importers.recording import EPOCH_NS, Times
from logs.store.reader import LogError
from models.frames import GRAVITY
from models.messages import Array
from models.untrusted.file import content
from models.untrusted.foreign import HEAD_BYTES, foreign
from models.untrusted.gzip import GzipFile

DEG = np.pi / 180.0

_UNIX_S = 100_000_000  # stamps above it (1973) count from 1970, smaller ones from the log's own start
_SAME_STAMP = 100  # rows a stamp: more than any batch of an IMU has; the digits of such stamps were cut off
_VALIDITY = ("header_stamp", "t", "time", "timestamp", "stamp")
_ARRIVAL = ("arrived", "arrival", "t_arrived")
_TIME_UNITS = {"_s": 10**9, "_sec": 10**9, "_ms": 10**6, "_us": 10**3, "_ns": 1, "": 0}  # ns; 0: by its size


_SEPARATORS = {"\t": "tabs", ";": "semicolons", " ": "blanks"}
_DAY_NS, _MINUTE_NS = 86_400 * 10**9, 60 * 10**9


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical quantity: stem + axis + unit, with SI factor."""

    name: str
    stems: tuple[str, ...]
    units: Mapping[str, float]

    def names(self, axis: str) -> dict[str, float]:
        """Headers of the quantity along `axis` ("": scalar), with factors."""
        return {stem + axis + unit: factor for unit, factor in self.units.items() for stem in self.stems}


GYRO = Quantity(
    "angular rate",
    ("g", "g_", "gyro_", "gyro", "w", "w_", "w_rs_s_", "omega_", "angular_velocity_"),
    {"_rad_s": 1.0, "_rad_s_1": 1.0, "": 1.0, "_deg_s": DEG, "_deg_s_1": DEG, "_dps": DEG},
)
ACCEL = Quantity(
    "specific force",
    ("a", "a_", "accel_", "acc_", "accel", "acc", "f", "f_", "a_rs_s_", "linear_acceleration_"),
    {"_m_s2": 1.0, "_m_s_2": 1.0, "_mps2": 1.0, "": 1.0, "_g": GRAVITY},
)
FIELD = Quantity(
    "magnetic field",
    ("m", "m_", "mag_", "mag", "h", "h_", "b_"),
    {"_t": 1.0, "_ut": 1e-6, "_nt": 1e-9, "_gauss": 1e-4, "_ga": 1e-4, "_mgauss": 1e-7},
)
POSITION = Quantity("position", ("p", "p_", "pos_", "p_rs_r_", "position_"), {"_m": 1.0, "": 1.0})
VELOCITY = Quantity("velocity", ("v", "v_", "vel_", "v_rs_r_", "velocity_"), {"_m_s": 1.0, "_m_s_1": 1.0, "_mps": 1.0, "": 1.0})
ATTITUDE = Quantity("attitude", ("q", "q_", "q_rs_", "quat_"), {"": 1.0})
SIGMA_POSITION = Quantity("position sigma", ("std_", "sigma_"), {"_m": 1.0})
SIGMA_VELOCITY = Quantity("velocity sigma", ("std_", "sigma_"), {"_m_s": 1.0, "_mps": 1.0})


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """names: lower case, [unit] as _unit; values (n, columns); t_ns (n,); arrived_ns (n,) or None."""

    file: str
    names: tuple[str, ...]
    values: Array
    t_ns: Times
    arrived_ns: Times | None
    notes: tuple[str, ...]

    def find(self, names: Mapping[str, float] | Iterable[str]) -> Array | None:
        """First existing column (n,) of these names times its factor, or None."""
        factors = names if isinstance(names, Mapping) else dict.fromkeys(names, 1.0)
        for name, factor in factors.items():
            if name in self.names:
                return np.asarray(self.values[:, self.names.index(name)] * factor)
        return None

    def vector(self, quantity: Quantity, axes: str) -> Array | None:
        """Columns (n, len(axes)), None without any. Raises LogError for some missing."""
        columns = [self.find(quantity.names(axis)) for axis in axes]
        found = [c for c in columns if c is not None]
        if not found:
            return None
        missing = [axis for axis, column in zip(axes, columns, strict=True) if column is None]
        if missing:
            raise self._no_column(quantity, missing[0])
        return np.stack(found, axis=1)

    def needed(self, quantity: Quantity, axes: str) -> Array:
        """Columns (n, len(axes)). Raises LogError for one that is missing or holds no number."""
        found = self.vector(quantity, axes)
        if found is None:
            raise self._no_column(quantity, axes[0])
        if len(empty := np.flatnonzero(~np.isfinite(found).any(axis=0))):
            raise LogError(f"{self.file}: no number in the column for {quantity.name} {axes[empty[0]]}")
        return found

    def _no_column(self, quantity: Quantity, axis: str) -> LogError:
        examples = " or ".join(list(quantity.names(axis))[:2])
        return LogError(f"{self.file}: no column for {quantity.name} {axis} (such as {examples}); it has {', '.join(self.names)}")


def read_table(path: Path, t0_ns: int | None = None) -> Table:
    """The table of a CSV file; relative stamps from t0_ns (None: EPOCH_NS). Raises LogError."""
    text, torn = _text(path)
    lines = text.splitlines()
    while len(lines) > 1 and lines[0].startswith("#") and lines[0].count(",") != lines[1].count(","):
        lines = lines[1:]  # a remark above the header
    if not lines:
        raise LogError(f"{path.name}: the file is empty")
    if "," not in lines[0] and (other := next((word for mark, word in _SEPARATORS.items() if mark in lines[0]), "")):
        raise LogError(f"{path.name}: columns are separated by {other}; commas are wanted")
    names = tuple(_plain(cell) for cell in lines[0].split(","))
    if 2 * sum(bool(re.match("(?!nan$|inf$)[a-z]", name)) for name in names) < len(names):
        raise LogError(
            f"{path.name}: no header; the first line must name the columns (t_s, gx_rad_s, ...); it begins {lines[0][:40]!r}"
        )
    notes = [f"{path.name}: torn; read as far as it goes"] if torn else []
    rows = [line for line in lines[1:] if line.strip()]
    if not rows:
        raise LogError(f"{path.name}: no line after the header")
    try:
        values = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
        if values.shape[1] != len(names):
            raise ValueError
    except ValueError:
        rows, note = _whole(rows, len(names))
        notes += [f"{path.name}: {note}"] if note else []
        if not rows:
            raise LogError(f"{path.name}: no line with {len(names)} cells, as the header has") from None
        values = np.array([[_number(cell) for cell in row.split(",")] for row in rows]).reshape(-1, len(names))
    t_ns = _times(path.name, names, rows, _VALIDITY, t0_ns)
    if t_ns is None:
        raise LogError(f"{path.name}: no column of time (t_s or timestamp_ns); it has {', '.join(names)}")
    stamped = t_ns >= 0
    if not stamped.all():
        notes.append(f"{path.name}: {np.count_nonzero(~stamped)} lines without a time left out")
        rows = [row for row, keep in zip(rows, stamped.tolist(), strict=True) if keep]
    if not stamped.any():
        raise LogError(f"{path.name}: no line with a time; if it is in ms, us or ns, name the column t_ms, t_us or t_ns")
    arrived_ns = _times(path.name, names, rows, _ARRIVAL, t0_ns)
    t_ns, midnights = _over_midnight(t_ns[stamped])
    _check_digits(path.name, t_ns)
    if midnights:
        notes.append(f"{path.name}: seconds of the day begin again {midnights} times: taken for midnight")
        arrived_ns = None if arrived_ns is None else _over_midnight(arrived_ns)[0]
    return Table(path.name, names, values[stamped], t_ns, arrived_ns, tuple(notes))


def _check_digits(file: str, t_ns: Times) -> None:
    distinct = len(np.unique(t_ns))
    if len(t_ns) >= _SAME_STAMP * distinct:
        values = "one value" if distinct == 1 else f"{distinct} values"
        raise LogError(f"{file}: {len(t_ns)} stamps have {values}; write the time with all its digits (nanoseconds, or float64)")


def _over_midnight(t_ns: Times) -> tuple[Times, int]:
    falls = np.abs(np.diff(t_ns) + _DAY_NS) < _MINUTE_NS
    return t_ns + _DAY_NS * np.concatenate([[0], np.cumsum(falls)]), int(np.count_nonzero(falls))


def _plain(header: str) -> str:
    """Turn "w_RS_S_x [rad s^-1]" into "w_rs_s_x_rad_s_1", "field.latitude" into "latitude"."""
    return re.sub(r"[^a-z0-9]+", "_", header.strip().lower().removeprefix("field.")).strip("_")


def _text(path: Path) -> tuple[str, bool]:
    try:
        if path.suffix != ".gz":
            data, torn = content(path), False
        else:
            with GzipFile(path) as file:
                data, torn = file.readall(), file.torn
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LogError(f"{path.name}: {error}") from None
    if what := foreign((data or b"")[:HEAD_BYTES]):
        raise LogError(f"{path.name}: {what}")
    try:
        return (data or b"").decode("utf-8-sig").replace('"', ""), torn
    except UnicodeDecodeError:
        raise LogError(f"{path.name}: not a CSV text file") from None


def _whole(rows: list[str], cells: int) -> tuple[list[str], str]:
    whole = [row for row in rows if row.count(",") + 1 == cells]
    left_out = len(rows) - len(whole)
    return whole, f"{left_out} lines without {cells} cells left out" if left_out else ""


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _times(file: str, names: tuple[str, ...], rows: list[str], stems: tuple[str, ...], t0_ns: int | None) -> Times | None:
    """ns since 1970, exact; -1: no number; None: no column."""
    units = {stem + unit: ns for unit, ns in _TIME_UNITS.items() for stem in stems}
    name = next((n for n in units if n in names), None)
    if name is None:
        return None
    k = names.index(name)
    cells = [row.split(",", k + 1)[k] for row in rows]
    first = next((t for t in map(_decimal, cells) if t is not None), None)
    if first is None:
        raise LogError(f"{file}: no number in column {name}")
    unit_ns = units[name] or _unit_by_size(float(first))
    shift = 0 if abs(first) * unit_ns > _UNIX_S * 10**9 else EPOCH_NS if t0_ns is None else t0_ns
    t_ns = _float_times(cells, unit_ns)
    return _exact_times(cells, unit_ns, shift) if t_ns is None else t_ns + shift


def _float_times(cells: list[str], unit_ns: int) -> Times | None:
    """Stamps by float64 where exact: all below 2^53 ns."""
    try:
        stamps = np.array(cells, dtype=np.float64) * unit_ns
    except ValueError:
        return None
    return np.rint(stamps).astype(np.int64) if (np.abs(stamps) < 2.0**53).all() else None


def _exact_times(cells: list[str], unit_ns: int, shift: int) -> Times:
    stamps = (None if t is None else round(t * unit_ns) + shift for t in map(_decimal, cells))
    return np.array([t if t is not None and 0 <= t < 2**63 else -1 for t in stamps], dtype=np.int64)


def _decimal(cell: str) -> Decimal | None:
    try:
        value = Decimal(cell.strip())
    except InvalidOperation:
        return None
    return value if value.is_finite() else None


def _unit_by_size(stamp: float) -> int:
    """ns per unit of a stamp, by its size since 1970, else of seconds."""
    for smallest, unit_ns in ((1e17, 1), (1e14, 10**3), (1e11, 10**6)):
        if stamp > smallest:
            return unit_ns
    return 10**9
