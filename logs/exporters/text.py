"""Text formats: blocks of lines with the share done."""

from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any, Final, TypeAlias
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from logs.exporters.columns import Columns, Table

Blocks: TypeAlias = Iterator[tuple[float, str]]

_ROWS: Final = 10_000  # a block
_LONGEST_GAP_NS: Final = 5_000_000_000  # in a track; behind a longer one a new segment begins
_DIGITS: Final = {"t_ns": "%d", "t_s": "%.9f", "lat_deg": "%.9f", "lon_deg": "%.9f", "qx": "%.8f", "qy": "%.8f", "qz": "%.8f",
                  "qw": "%.8f", "mode": "%s"}  # fmt: skip
_COLOURS: Final = {  # aabbggrr; dark enough for a map, light enough for an aerial image
    "aided": "ff50b000", "odometry": "ffd09000", "dead_reckoning": "ff2040e8", "coasting": "ff9020c0", "": "ffe07020",
}  # fmt: skip


def complete(rows: Table, *, attitude: bool) -> NDArray[np.bool_]:
    """Rows with position (and attitude)."""
    names = ("east_m", "north_m", "up_m", *(("qw",) if attitude else ()))
    return np.asarray(np.isfinite([rows.columns[name] for name in names]).all(axis=0))


def lines(kind: str, rows: Table, name: str, geoid_m: float) -> Blocks:
    """File of a format; name: of the track; geoid_m: geoid above the ellipsoid."""
    writers: Mapping[str, Callable[[], Blocks]] = {
        "csv": lambda: _csv(rows.columns),
        "tum": lambda: _tum(rows.columns),
        "kml": lambda: _kml(rows.columns, name, geoid_m),
        "gpx": lambda: _gpx(rows.columns, name, geoid_m),
    }
    return writers[kind]()


def _blocks(form: str, columns: list[NDArray[Any]], empty: str = "nan") -> Blocks:
    n = len(columns[0])
    for start in range(0, n, _ROWS):
        part = zip(*(column[start : start + _ROWS].tolist() for column in columns), strict=True)
        block = "".join([form % row for row in part])
        yield min(1.0, (start + _ROWS) / n), block if empty == "nan" else block.replace("nan", empty)


def _csv(columns: Columns) -> Blocks:
    yield 0.0, ",".join(columns) + "\n"
    yield from _blocks(",".join(_DIGITS.get(name, "%.4f") for name in columns) + "\n", list(columns.values()), empty="")


def _tum(columns: Columns) -> Blocks:
    names = ("east_m", "north_m", "up_m", "qx", "qy", "qz", "qw")
    seconds, rest = np.divmod(columns["t_ns"], 1_000_000_000)  # a double would round a stamp of today to 0.2 us
    yield 0.0, "# timestamp tx ty tz qx qy qz qw: s, m; map is ENU, the body FLU\n"
    yield from _blocks("%d.%09d %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", [seconds, rest, *(columns[name] for name in names)])


def _kml(columns: Columns, name: str, geoid_m: float) -> Blocks:
    modes = columns.get("mode", np.full(len(columns["t_ns"]), ""))
    styles = "".join(
        f'<Style id="mode_{mode or "none"}"><LineStyle><color>{colour}</color><width>3</width></LineStyle></Style>\n'
        for mode, colour in _COLOURS.items()
    )
    yield (
        0.0,
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n'
            f"<name>{escape(name)}</name>\n{styles}"
        ),
    )
    ends = [0, *(np.flatnonzero(modes[1:] != modes[:-1]) + 1).tolist(), len(modes)]
    for start, end in pairwise(ends):
        mode = str(modes[start])
        rows = slice(start, min(end + 1, len(modes)))  # up to where the next one begins
        times = [_time(int(columns["t_ns"][k])) for k in (start, rows.stop - 1)]
        points = [columns["lon_deg"][rows], columns["lat_deg"][rows], columns["alt_m"][rows] - geoid_m]
        line = "".join(block for _, block in _blocks("%.9f,%.9f,%.3f\n", points))
        yield (
            end / len(modes),
            (
                f"<Placemark><name>{escape(mode or name)}</name>"
                f"<TimeSpan><begin>{times[0]}</begin><end>{times[1]}</end></TimeSpan>"
                f"<styleUrl>#mode_{mode if mode in _COLOURS and mode else 'none'}</styleUrl>\n"
                f"<LineString><tessellate>0</tessellate><altitudeMode>absolute</altitudeMode><coordinates>\n{line}</coordinates>"
                "</LineString></Placemark>\n"
            ),
        )
    yield 1.0, "</Document>\n</kml>\n"


def _gpx(columns: Columns, name: str, geoid_m: float) -> Blocks:
    t_ns = columns["t_ns"]
    yield (
        0.0,
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="landfix" xmlns="http://www.topografix.com/GPX/1/1">\n'
            f"<metadata><time>{_time(int(t_ns[0]))}</time></metadata>\n<trk><name>{escape(name)}</name>\n"
        ),
    )
    ends = [0, *(np.flatnonzero(np.diff(t_ns) > _LONGEST_GAP_NS) + 1).tolist(), len(t_ns)]
    for start, end in pairwise(ends):
        rows = slice(start, end)
        stamps = np.array([_time(int(t)) for t in t_ns[rows]])
        points = [columns["lat_deg"][rows], columns["lon_deg"][rows], columns["alt_m"][rows] - geoid_m, stamps]
        yield start / len(t_ns), "<trkseg>\n"
        form = '<trkpt lat="%.9f" lon="%.9f"><ele>%.3f</ele><time>%s</time></trkpt>\n'
        yield end / len(t_ns), "".join(block for _, block in _blocks(form, points)) + "</trkseg>\n"
    yield 1.0, "</trk>\n</gpx>\n"


def _time(t_ns: int) -> str:
    """UTC to the millisecond (XML Schema): 2026-01-31T12:00:00.250Z."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=t_ns // 1_000_000)
    return moment.strftime("%Y-%m-%dT%H:%M:%S.") + f"{moment.microsecond // 1000:03d}Z"
