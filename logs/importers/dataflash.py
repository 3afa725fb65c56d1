"""ArduPilot's .bin logs, by pymavlink.

    IMU (one of IMU2, IMU3 by option)   ->  /imu                         BARO  ->  /baro        MAG  ->  /mag
    ARSP, indicated                 ->  /airspeed                        RFND, downwards  ->  /range
    GPS with GPA, GPS2              ->  /gnss, /gnss/velocity, /gnss2, /gnss2/velocity; Yaw of the first  ->  /heading
    VISP                            ->  /odometry: poses; a new frame at each Rst
    VISO                            ->  /odometry_delta: a camera's steps    OF  ->  /optical_flow
    WENC                            ->  /velocity_body: forward, of the wheels
    SIM with SIM2                   ->  /truth: of ArduPilot's simulator
    XKF1, NKF1 or EKF1              ->  /truth without SIM: the autopilot's estimate, a reference only;
                                        its attitude  ->  /attitude

t_ns of a fix: receiver week time on the log's clock, the fastest fix without delay; common delay: `delay_s`.
"""

import contextlib
from collections.abc import Mapping, Sequence
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink import DFReader
from scipy.ndimage import minimum_filter1d

from logs.importers import frames, recording, sensors, simulator, steps
from logs.importers.recording import DEFAULTS, EPOCH_NS, ImportOptions, Progress, Recording, Stream, Times
from logs.importers.settings import Settings
from logs.store.reader import LogError
from models.messages import Array, Vec3
from models.untrusted.file import opened
from models.untrusted.quiet import silence

_MAGIC, _TEXT = b"\xa3\x95", b"FM"  # "FMT, ..."
_TIME = "time_us"  # since boot; the first column of every table
_FIELDS = {
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GPS": ("Status", "HDop", "Lat", "Lng", "Alt", "Spd", "GCrs", "VZ", "Week", "TimeMS", "GWk", "GMS", "Yaw"),
    "GPA": ("HAcc", "VAcc", "SAcc"),
    "UBX1": ("Instance", "noisePerMS", "agcCnt", "jamInd"),
    "BARO": ("Press",),
    "ARSP": ("Airspeed",),
    "RFND": ("Dist", "Stat", "Orient"),
    "MAG": ("MagX", "MagY", "MagZ"),
    "XKF1": ("Roll", "Pitch", "Yaw", "VN", "VE", "VD", "PN", "PE", "PD"),
    "VISP": ("PX", "PY", "PZ", "R", "P", "Y", "Roll", "Pitch", "Yaw", "Rst"),
    "SIM": ("Lat", "Lng", "Alt", "Q1", "Q2", "Q3", "Q4"),
    "SIM2": ("VN", "VE", "VD"),
    "VISO": ("dt", "AngDX", "AngDY", "AngDZ", "PosDX", "PosDY", "PosDZ", "conf"),
    "OF": ("Qual", "flowX", "flowY", "bodyX", "bodyY"),
    "WENC": ("Dist0", "Qual0", "Dist1", "Qual1"),
    "ORGN": ("Type", "Lat", "Lng", "Alt"),
}
_SENSORS = (  # message, kind, its unit in SI
    ("BARO", "baro", 1.0),
    ("ARSP", "airspeed", 1.0),
    ("MAG", "magnetometer", 1e-3 * sensors.GAUSS_T),
)
_STAMPS = {"TimeUS": 1.0, "T": 1e3, "TimeMS": 1e3}  # us; TimeMS of a GPS row is the receiver's, its T is the log's
_FILTERS = ("XKF1", "NKF1", "EKF1")
_ALIASES = {"IMU2": "IMU", "IMU3": "IMU", "GPS2": "GPS", "NKF1": "XKF1", "EKF1": "XKF1"}  # same fields under another name
_DELAYS = ("GPS1_DELAY_MS", "GPS_DELAY_MS", "EK2_GPS_DELAY", "EKF_POS_DELAY")  # parameters, newest first; 0: not given
_USUAL_DELAY_MS = 200.0
_DOWNWARDS, _GOOD = 25, 4  # ROTATION_PITCH_270; RangeFinder::Status::Good
_WEEK_MS = 7 * 86_400_000
_DRIFT_WINDOW = 601  # fixes (2 min at 5 Hz) over which the autopilot's clock keeps step with GPS time
_FAR_US = 4e15  # beyond any date; a damaged stamp may be
_MISSING = 1.5  # usual periods between two rows of flow: one is missing
_LATE_US = 2_000_000  # a fix later than this has a wrong week time

Tables = Mapping[str, Mapping[str, Array]]  # message -> field -> column


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in a .bin file. Raises LogError."""
    options.refuse_but("dataflash", "imu")
    name = options.imu.upper() or "IMU"
    with contextlib.closing(_open(source)) as log:
        tables = _tables(source, log, options.imu.upper(), progress)
        timebase_us = round(1e6 * getattr(log.clock, "timebase", 0.0))
        parameters: dict[str, float] = dict(log.params)
        lengths = {number: layout.len for number, layout in log.formats.items()}
    notes: list[str] = [f"{source.name}: damaged in places; the rest was read"] if _is_damaged(source, lengths) else []
    if timebase_us <= 0:
        timebase_us = EPOCH_NS // 1000
        notes.append("the log does not know the date: stamps count from 2023-11-14T22:13:20Z")
    imus = [_imu(source, tables, name, timebase_us, notes)]
    if not options.imu:
        imus += [_imu(source, tables, n, timebase_us, [], f"/imu{n[3:]}") for n in ("IMU2", "IMU3") if n in tables]
    gnss = [s for suffix in ("", "2") for s in _gnss(source, tables, suffix, timebase_us)]
    own, simulated = _own_estimate(tables, timebase_us), _simulated(tables, timebase_us)
    truth, origin = simulated or (own, None)
    notes.append(simulator.about(truth, own, ", ".join(_FILTERS)))
    delay_s = 0.0
    if gnss:
        notes.append("GNSS heights are above sea level; set [map] geoid_m to have them above the ellipsoid")
        notes += _reception(tables.get("UBX1"))
        delay_s = _delay_s(parameters, gnss[0])
        if truth and not origin:
            origin = sensors.origin_of_truth(gnss[0], truth, delay_s, _known_origin(tables))
    settings = Settings(
        gnss_delay_s=delay_s,
        origin=origin,
        altitude="above mean sea level",
        airspeed={"indicated": True},
        wheels="WENC" in tables,
    )
    aids = [*gnss, *_sensors(tables, timebase_us), *_odometry(tables, timebase_us, notes)]
    aids += [*_camera(tables, timebase_us), *_flow(tables, timebase_us, [*imus, *aids], notes), *_wheels(tables, timebase_us)]
    attitude = _attitude(own, tables, timebase_us, parameters.get("COMPASS_USE", 1.0) > 0.0, notes) if own else []
    known = (*attitude, *([truth] if truth else []))
    return Recording.of((*aids, *imus, *known), settings, notes, recording.AUTOPILOT if truth and truth is own else "")


def _open(source: Path) -> Any:
    try:
        with opened(source) as file:
            magic = file.read(len(_MAGIC))
    except OSError as error:
        raise LogError(f"{source}: {error.strerror}") from None
    if magic != _MAGIC:
        text = "a dataflash log written as text: give the .bin that it was made of"
        what = text if magic == _TEXT else "not an ArduPilot dataflash log (.bin)" if magic else "the file is empty"
        raise LogError(f"{source.name}: {what}")
    try:
        with silence():
            return DFReader.DFReader_binary(str(source))
    except Exception as error:  # pymavlink raises whatever a damaged file makes it stumble over
        raise LogError(f"{source.name}: cannot be read as a dataflash log: {error}") from None


def _is_damaged(source: Path, lengths: Mapping[int, int]) -> bool:
    """Whether something else stands where a message should begin; the end may be cut."""
    with source.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        at, end = 0, len(data)
        while at + 2 < end and data[at : at + 2] == _MAGIC and (length := lengths.get(data[at + 2], 0)) > 2:
            at += length
        return at + 2 < end and bool(data[at:].strip(b"\0\xff"))


class _Layout:
    def __init__(self, source: Path, message: Any) -> None:
        there = set(message.get_fieldnames())
        stamp = next((field for field in _STAMPS if field in there), None)
        if stamp is None:
            raise LogError(f"{source.name}: rows without TimeUS or TimeMS: the log is of an ArduPilot before 3.0")
        self._stamp, self._unit_us = stamp, _STAMPS[stamp]
        self._instance = next((field for field in ("I", "C") if field in there), None)
        self.name = message.get_type()
        self.fields = _FIELDS[_ALIASES.get(self.name, self.name)]
        self._present = [field in there for field in self.fields]

    def key(self, message: Any) -> str:
        instance = getattr(message, self._instance) if self._instance else 0
        return f"{self.name}{instance + 1}" if instance else self.name

    def row(self, message: Any) -> list[float]:
        fields = (getattr(message, f) if there else np.nan for f, there in zip(self.fields, self._present, strict=True))
        return [getattr(message, self._stamp) * self._unit_us, *fields]


def _tables(source: Path, log: Any, imu: str, progress: Progress | None) -> Tables:
    wanted = [n for n in (*_FIELDS, *_ALIASES) if not imu or not n.startswith("IMU") or n in ("IMU", imu)]
    layouts: dict[str, _Layout] = {}
    rows: dict[str, tuple[_Layout, list[list[float]]]] = {}
    count = 0
    while (message := log.recv_match(type=wanted)) is not None:
        name = message.get_type()
        layout = layouts.get(name) or layouts.setdefault(name, _Layout(source, message))
        rows.setdefault(layout.key(message), (layout, []))[1].append(layout.row(message))
        count += 1
        if progress and count % 10_000 == 0:
            progress(log.percent / 100.0)
    return {key: dict(zip((_TIME, *lay.fields), np.array(r, float).T, strict=True)) for key, (lay, r) in rows.items()}


def _t_ns(time_us: Array, timebase_us: int) -> Times:
    return (np.rint(np.clip(time_us, 0.0, _FAR_US)).astype(np.int64) + timebase_us) * 1000


def _vector(table: Mapping[str, Array], *fields: str) -> Array:
    return np.stack([table[field] for field in fields], axis=1)


def _imu(source: Path, tables: Tables, name: str, timebase_us: int, notes: list[str], topic: str = "/imu") -> Stream:
    table = tables.get(name)
    if table is None:
        remedy = "try --imu IMU" if name != "IMU" else "in ArduPilot tick IMU, or Fast IMU, in LOG_BITMASK and fly again"
        raise LogError(f"{source.name}: no IMU messages called {name} in it: {remedy}")
    gyro_b, accel_b = _vector(table, "GyrX", "GyrY", "GyrZ"), _vector(table, "AccX", "AccY", "AccZ")
    t_ns = _t_ns(table[_TIME], timebase_us)
    notes += sensors.check_imu(gyro_b, accel_b, source.name) + sensors.check_rate(t_ns, source.name)
    return recording.imu(t_ns, recording.arrival(t_ns), gyro_b, accel_b, topic)


def _gnss(source: Path, tables: Tables, suffix: str, timebase_us: int) -> list[Stream]:
    table, topic = tables.get(f"GPS{suffix}"), f"/gnss{suffix}"
    if table is None:
        return []
    lla = _vector(table, "Lat", "Lng", "Alt")
    sensors.check_place(lla, source.name)
    status = sensors.navsat_status(table["Status"])
    variance, speed_variance = _variances(table, tables.get(f"GPA{suffix}"))
    t_ns, arrived_ns = _t_ns(_receiver_time_us(table), timebase_us), recording.arrival(_t_ns(table[_TIME], timebase_us))
    moving = np.flatnonzero(status >= 0)
    course, speed = np.deg2rad(table["GCrs"]), table["Spd"]
    v_n = np.stack([speed * np.cos(course), speed * np.sin(course), table["VZ"]], axis=1)[moving]
    velocity = recording.gnss_velocity(t_ns[moving], arrived_ns[moving], v_n, speed_variance[moving], f"{topic}/velocity")
    azimuth = np.deg2rad(np.remainder(table["Yaw"] + 180.0, 360.0) - 180.0)[:, np.newaxis]
    rows = np.flatnonzero((table["Yaw"] != 0.0) & np.isfinite(table["Yaw"]))  # 0: the receiver has one antenna
    heading = [recording.sensor("heading", t_ns[rows], arrived_ns[rows], azimuth[rows])] if len(rows) and not suffix else []
    return [recording.gnss(t_ns, arrived_ns, lla, variance, status, topic), velocity, *heading]


def _variances(gps: Mapping[str, Array], gpa: Mapping[str, Array] | None) -> tuple[Array, Array]:
    """(n, 3) m^2, m^2/s^2: GPA, else HDOP and unknown."""
    n = len(gps[_TIME])
    position = sensors.variance_from_dop(gps["HDop"], np.full(n, np.nan))
    velocity = np.full((n, 3), np.nan)
    if gpa is not None:  # written with the same stamp as its GPS row
        _, mine, theirs = np.intersect1d(gps[_TIME], gpa[_TIME], return_indices=True)
        accuracy = _vector(gpa, "HAcc", "VAcc", "SAcc")[theirs] ** 2
        known = (accuracy > 0.0).all(axis=1)
        mine, accuracy = mine[known], accuracy[known]
        position[mine] = accuracy[:, [0, 0, 1]]
        velocity[mine] = accuracy[:, [2, 2, 2]]
    return position, velocity


def _reception(table: Mapping[str, Array] | None) -> list[str]:
    if table is None:
        return []
    columns = _vector(table, *_FIELDS["UBX1"])
    return [n for k in (0, 1) for n in sensors.reception(f"/gnss{k + 1 if k else ''}", *columns[columns[:, 0] == k, 1:].T)]


def _receiver_time_us(table: Mapping[str, Array]) -> Array:
    """Fix times on the log's clock [us]: arrival less excess over the fastest around."""
    arrived_us = table[_TIME]
    week, week_ms = (np.where(np.isnan(table[new]), table[old], table[new]) for new, old in (("GWk", "Week"), ("GMS", "TimeMS")))
    dated = np.flatnonzero(week > 0)
    if len(dated) == 0:
        return arrived_us
    receiver_us = (week[dated] * _WEEK_MS + week_ms[dated]) * 1e3
    ahead_us = arrived_us[dated] - (receiver_us - receiver_us[0])
    latency_us = ahead_us - minimum_filter1d(ahead_us, _DRIFT_WINDOW, mode="nearest")
    t_us = arrived_us.copy()
    t_us[dated] -= np.where(latency_us < _LATE_US, latency_us, 0.0)
    return t_us


def _delay_s(parameters: Mapping[str, float], gnss: Stream) -> float:
    delay_ms = next((parameters[name] for name in _DELAYS if parameters.get(name, 0.0) > 0.0), _USUAL_DELAY_MS)
    already_ms = float(np.median(gnss.arrived_ns - gnss.t_ns)) * 1e-6
    return max(0.0, delay_ms - already_ms) * 1e-3


def _sensors(tables: Tables, timebase_us: int) -> list[Stream]:
    streams = []
    for name, kind, unit in _SENSORS:
        table = tables.get(name)
        if table is None or np.isnan(table[_FIELDS[name][0]]).all():
            continue
        t_ns = _t_ns(table[_TIME], timebase_us)
        streams.append(recording.sensor(kind, t_ns, recording.arrival(t_ns), unit * _vector(table, *_FIELDS[name])))
    return [*streams, *_range(tables, timebase_us)]


def _range(tables: Tables, timebase_us: int) -> list[Stream]:
    table = tables.get("RFND")
    if table is None:
        return []
    rows = np.flatnonzero((table["Orient"] == _DOWNWARDS) & np.isfinite(table["Dist"]))
    t_ns, z_m, status = _t_ns(table[_TIME], timebase_us)[rows], table["Dist"][rows], table["Stat"][rows]
    z_m = np.where((status == _GOOD) & (z_m > 0.0), z_m, np.inf)
    return [recording.sensor("range", t_ns, recording.arrival(t_ns), z_m[:, np.newaxis])] if len(rows) else []


def _odometry(tables: Tables, timebase_us: int, notes: list[str]) -> list[Stream]:
    table = tables.get("VISP")
    if table is None:
        return []
    t_ns = _t_ns(table[_TIME], timebase_us)
    angles = ("R", "P", "Y") if np.isfinite(table["R"]).any() else ("Roll", "Pitch", "Yaw")  # by version
    q = frames.attitude_from_euler(*(np.deg2rad(table[angle]) for angle in angles))
    notes.append("poses from outside (VISP) are /odometry; the configuration says how to use them")
    run = np.nan_to_num(table["Rst"])
    return [recording.odometry(t_ns, recording.arrival(t_ns), _vector(table, "PX", "PY", "PZ"), q, run)]


def _camera(tables: Tables, timebase_us: int) -> list[Stream]:
    table = tables.get("VISO")
    if table is None:
        return []
    rows = np.flatnonzero((table["conf"] > 0.0) & np.isfinite(table["dt"]))
    t_ns, dt_ns = _t_ns(table[_TIME], timebase_us)[rows], np.rint(table["dt"][rows] * 1e6).astype(np.int64) * 1000
    turn, moved = _vector(table, "AngDX", "AngDY", "AngDZ")[rows], _vector(table, "PosDX", "PosDY", "PosDZ")[rows]
    return steps.camera(t_ns, recording.arrival(t_ns), dt_ns, turn, moved)


def _flow(tables: Tables, timebase_us: int, streams: Sequence[Stream], notes: list[str]) -> list[Stream]:
    """The turn about z is the IMU's."""
    table = tables.get("OF")
    if table is None or len(table[_TIME]) <= 1:
        return []
    t_ns = _t_ns(table[_TIME], timebase_us)
    dt_ns = np.diff(t_ns)
    rows = 1 + np.flatnonzero((table["Qual"][1:] > 0) & (dt_ns > 0) & (dt_ns < _MISSING * np.median(dt_ns)))
    dt_ns, nothing = dt_ns[rows - 1], np.full(len(rows), np.nan)
    seen, turn = (
        _vector(table, *names)[rows] * dt_ns[:, np.newaxis] * 1e-9 for names in (("flowX", "flowY"), ("bodyX", "bodyY"))
    )
    turn = np.column_stack([turn, nothing])
    return steps.flow(t_ns[rows], recording.arrival(t_ns)[rows], dt_ns, seen, turn, nothing, streams, notes)


def _wheels(tables: Tables, timebase_us: int) -> list[Stream]:
    """Way [m] and quality of each wheel; quality always 0: absent."""
    table = tables.get("WENC")
    if table is None:
        return []
    there = [k for k in (0, 1) if (table[f"Qual{k}"] > 0).any()]
    ways = [np.where(table[f"Qual{k}"] > 0, table[f"Dist{k}"], np.nan) for k in there]
    t_ns = _t_ns(table[_TIME], timebase_us)
    return steps.wheels(t_ns, recording.arrival(t_ns), np.stack(ways, axis=1)) if there else []


def _simulated(tables: Tables, timebase_us: int) -> tuple[Stream, Vec3] | None:
    table, fast = tables.get("SIM"), tables.get("SIM2")
    if table is None:
        return None
    lla, q_nb = _vector(table, "Lat", "Lng", "Alt"), _vector(table, "Q1", "Q2", "Q3", "Q4")
    v_n = np.full_like(lla, np.nan)
    if fast is not None:
        between = 0.5 * (fast[_TIME][1:] + fast[_TIME][:-1])
        v_n = _vector(fast, "VN", "VE", "VD")[np.searchsorted(between, table[_TIME])]
    return simulator.truth(_t_ns(table[_TIME], timebase_us), lla, v_n, q_nb, _known_origin(tables))


def _own_estimate(tables: Tables, timebase_us: int) -> Stream | None:
    table = next((tables[name] for name in _FILTERS if name in tables), None)
    if table is None:
        return None
    q_nb = frames.attitude_from_euler(*(np.deg2rad(table[angle]) for angle in ("Roll", "Pitch", "Yaw")))
    return recording.truth(
        _t_ns(table[_TIME], timebase_us), _vector(table, "PN", "PE", "PD"), _vector(table, "VN", "VE", "VD"), q_nb
    )


def _attitude(own: Stream, tables: Tables, timebase_us: int, uses_compass: bool, notes: list[str]) -> list[Stream]:
    """From the EKF's first origin on: before, heading is magnetic. None with a dead compass, or without."""
    *_, q_nb = own.columns
    field = tables.get("MAG")
    if not uses_compass or (field is not None and not _vector(field, "MagX", "MagY", "MagZ").any()):
        notes.append("the autopilot's attitude is left out: it has no compass, or a dead one, and the heading may be anything")
        return []
    first = _origin_rows(tables)[:1]
    since_ns = _t_ns(tables["ORGN"][_TIME][first], timebase_us)[0] if len(first) else 0
    return [recording.attitude(own.t_ns, own.arrived_ns, np.where((own.t_ns >= since_ns)[:, np.newaxis], q_nb, np.nan))]


def _origin_rows(tables: Tables) -> NDArray[np.intp]:
    table = tables.get("ORGN")
    return np.flatnonzero(table["Type"] == 0) if table else np.array([], int)


def _known_origin(tables: Tables) -> Vec3 | None:
    rows = _origin_rows(tables)
    if len(rows) == 0:
        return None
    lat, lon, alt = (float(tables["ORGN"][field][rows[-1]]) for field in ("Lat", "Lng", "Alt"))
    return lat, lon, alt
