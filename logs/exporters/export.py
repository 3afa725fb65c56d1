"""A trajectory file for other programs, format by name.

    csv       all columns, a header line, empty: unknown
    parquet   the same columns, typed (needs pyarrow)
    tum       t x y z qx qy qz qw; s and m, map ENU, body FLU
    kml       a line for each stretch of one mode
    gpx       one track, a new segment at each gap

Formats: TUM RGB-D benchmark; OGC 07-147r2 (KML 2.2); Topografix GPX 1.1.
"""

from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Final

import msgspec

from logs.evaluation.collected import ODOMETRY_TOPIC
from logs.exporters import text
from logs.exporters.columns import Table, table
from logs.store.reader import LogError, check_output

_MAP_RATE_HZ: Final = 2.0  # a line on a map needs no more
_READ: Final = 0.7  # share of the time


class Format(StrEnum):
    """Output formats."""

    CSV = "csv"
    PARQUET = "parquet"
    TUM = "tum"
    KML = "kml"
    GPX = "gpx"


class Exported(msgspec.Struct, frozen=True):
    """What was written; left_out: rows without position or attitude."""

    out: str
    format: Format
    topic: str
    rows: int
    left_out: int

    def __str__(self) -> str:
        rest = f", {self.left_out} left out: no attitude or position is known there" if self.left_out else ""
        return f"{self.rows} rows of {self.topic} as {self.format}{rest}"


def format_of(out: Path) -> Format:
    """By the file's name. Raises LogError."""
    try:
        return Format(out.suffix.removeprefix(".").lower())
    except ValueError:
        raise LogError(f"{out}: its format is not known by its name; end it in .{', .'.join(Format)}, or give --format") from None


def export(
    log: Path,
    out: Path,
    kind: Format | None = None,
    *,
    topic: str = ODOMETRY_TOPIC,
    rate_hz: float | None = None,
    geoid_m: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Exported:
    """Write a topic's poses; rate_hz: 0: all, None: all, two for kml and gpx. Raises LogError.

    geoid_m: for kml and gpx, None: the log's.
    """
    check_output(out, log)
    kind = kind or format_of(out)
    on_map = kind in {Format.KML, Format.GPX}
    if kind is Format.PARQUET:
        _pyarrow()
    rate = (_MAP_RATE_HZ if on_map else 0.0) if rate_hz is None else rate_hz
    rows = table(log, topic, rate, (lambda f: progress(_READ * f)) if progress else None)
    if on_map and rows.origin is None:
        raise LogError(f"{log}: its estimate has no place on Earth, which {kind} needs; give [map] origin and replay it")
    kept = rows[text.complete(rows, attitude=kind is Format.TUM)] if on_map or kind is Format.TUM else rows
    if not len(kept):
        raise LogError(f"{log}: {topic} has no row with {'position and attitude' if kind is Format.TUM else 'position'}")
    if kind is Format.PARQUET:
        _write_parquet(kept, out)
    else:
        lines = text.lines(kind.value, kept, log.stem, kept.geoid_m if geoid_m is None else geoid_m)
        try:
            with out.open("w", encoding="utf-8", newline="\n") as file:
                for done, block in lines:
                    file.write(block)
                    if progress:
                        progress(_READ + (1.0 - _READ) * done)
        except OSError as error:
            raise LogError(f"{out}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None
    return Exported(str(out), kind, topic, len(kept), len(rows) - len(kept))


def _pyarrow() -> None:
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415  (an extra)
    except ImportError:
        raise LogError("Parquet needs pyarrow: pip install 'landfix[export]'") from None


def _write_parquet(rows: Table, out: Path) -> None:
    import pyarrow as pa  # noqa: PLC0415  (an extra)
    import pyarrow.parquet as pq  # noqa: PLC0415

    about: Mapping[str, str] = {
        "topic": rows.topic,
        "origin_lat_lon_alt": msgspec.json.encode(rows.origin).decode(),
        "frames": "map ENU at the origin; quaternion of the body FLU; roll, pitch, heading of the body FRD in NED",
    }
    try:
        pq.write_table(pa.table(dict(rows.columns)).replace_schema_metadata(about), out)
    except OSError as error:
        raise LogError(f"{out}: cannot be written ({error})") from None
