"""A folder of CSV files (or .csv.gz); all but imu.csv are optional; columns by header (csv_table.py):

    imu.csv     t_s, gx_rad_s gy_rad_s gz_rad_s, ax_m_s2 ay_m_s2 az_m_s2          (gyro_x_deg_s, ax_g ... are converted)
    gps.csv     t_s, lat_deg lon_deg alt_m, vn_m_s ve_m_s vd_m_s, status or fix_type, std_n_m std_e_m std_u_m std_v_m_s or hdop
    baro.csv    t_s, pressure_pa or baro_alt_m
    airspeed.csv t_s, tas_m_s or ias_m_s (true, indicated; also in airdata.csv)
    mag.csv     t_s, mx_ut my_ut mz_ut, axes of imu.csv      (T, nT, gauss, mgauss are converted)
    truth.csv   t_s, pn_m pe_m pd_m (NED) or px_m py_m pz_m (ENU unless --world says), vn_m_s.. or vx_m_s.., qw qx qy qz
    vision.csv  as truth.csv: fixes or odometry, on request

Optional arrived_s; relative stamps count from `t0_unix_ns` in checks.json, else EPOCH_NS.
"""

import json
import os
from pathlib import Path

import numpy as np

from logs.importers import csv_table, frames, recording, sensors
from logs.importers.csv_table import Quantity, Table, read_table
from logs.importers.recording import DEFAULTS, ImportOptions, Progress, Recording, Stream, Times
from logs.importers.settings import DataSet, Settings, data_set
from logs.store.reader import LogError
from models.messages import Array, Vec3

VISION_SIGMA_M = 0.1  # per axis; what the vision.csv of EuRoC was found to have, 0.02-0.13
VISION_SIGMA_RAD = np.deg2rad(1.0)  # per axis; found 0.3-1.6 degrees

_NED = "ned"
_NO_IMU_S = 1.0  # between samples: no IMU is as slow
_LAT = ("lat_deg", "latitude_deg", "lat", "latitude")
_LON = ("lon_deg", "longitude_deg", "lon", "lng", "longitude", "lng_deg")
_TRUE_AIRSPEED = ("tas_m_s", "true_airspeed_m_s", "airspeed_m_s")
_INDICATED_AIRSPEED = ("ias_m_s", "indicated_airspeed_m_s", "eas_m_s", "cas_m_s")
_ELLIPSOID = ("alt_ellipsoid_m", "height_ellipsoid_m", "alt_hae_m", "ellipsoid_height_m")
_ALT = (*_ELLIPSOID, "alt_m", "altitude_m", "height_m", "alt", "altitude", "height", "alt_msl_m", "alt_amsl_m")


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in a folder. Raises LogError."""
    if not source.is_dir():
        raise LogError(f"{source}: not a folder; csv needs the folder that holds imu.csv")
    notes: list[str] = []
    known = data_set(Path(os.path.realpath(source)))
    checks = _checks(source)
    reader = _Reader(source, checks.get("t0_unix_ns"), notes)
    B = frames.body_axes(options.axes or known.axes)
    imu = _imu(reader, options.imu or "imu", B)
    if progress:
        progress(0.5)
    aids = [*_gnss(reader), *_baro(reader), *_field(reader, B)]
    airspeed, is_indicated = _airspeed(reader)
    aids += airspeed
    if options.pose_fix_hz > 0.0:
        aids.append(_pose_fixes(reader, options, B))
    if options.odometry:
        aids.append(_odometry(reader, options, B))
    truth = _truth(reader, options, B)
    if not any(s.topic in ("/gnss", "/pose_fix") for s in aids):
        hint = "; --pose-fix-hz takes some from vision.csv" if reader.has("vision") else ""
        notes.append(f"{source.name}: neither GNSS nor pose fixes, so the estimator has nothing to start from{hint}")
    settings = _settings(known, checks, aids, truth, {"indicated": True} if is_indicated else {})
    return Recording.of((*aids, imu, *([truth] if truth else [])), settings, notes)


class _Reader:
    def __init__(self, folder: Path, t0_ns: object, notes: list[str]) -> None:
        self.folder = folder
        self.notes = notes
        self._t0_ns = t0_ns if isinstance(t0_ns, int) else None

    def table(self, *stems: str) -> Table | None:
        path = self._path(*stems)
        if path is None:
            return None
        table = read_table(path, self._t0_ns)
        self.notes.extend(table.notes)
        return table

    def has(self, stem: str) -> bool:
        return self._path(stem) is not None

    def _path(self, *stems: str) -> Path | None:
        paths = (self.folder / f"{stem}{ending}" for stem in stems for ending in (".csv", ".csv.gz"))
        return next((p for p in paths if p.is_file()), None)


def _checks(folder: Path) -> dict[str, object]:
    path = folder / "checks.json"
    try:
        checks = json.loads(path.read_text()) if path.is_file() else {}
    except ValueError as error:
        raise LogError(f"{path.name}: not valid JSON: {error}") from None
    return checks if isinstance(checks, dict) else {}


def arrived(table: Table) -> Times:
    """Arrivals: given, else file order."""
    if table.arrived_ns is None:
        return recording.arrival(table.t_ns)
    return np.where(table.arrived_ns >= 0, table.arrived_ns, table.t_ns)


def _imu(reader: _Reader, stem: str, B: Array) -> Stream:
    table = reader.table(stem.removesuffix(".gz").removesuffix(".csv"))
    if table is None:
        there = ", ".join(sorted(p.name for p in reader.folder.iterdir())[:20]) or "nothing"
        raise LogError(f"{reader.folder}: no {stem}.csv or {stem}.csv.gz in it (there is: {there})")
    gyro_b = frames.turned(table.needed(csv_table.GYRO, "xyz"), B)
    accel_b = frames.turned(table.needed(csv_table.ACCEL, "xyz"), B)
    step_s = float(np.median(np.diff(table.t_ns))) * 1e-9 if len(table.t_ns) > 1 else 0.0
    if step_s >= _NO_IMU_S:
        raise LogError(
            f"{table.file}: {step_s:g} s from one sample to the next; if its time is in ms or us, name the column t_ms or t_us"
        )
    reader.notes += sensors.check_imu(gyro_b, accel_b, table.file) + sensors.check_rate(table.t_ns, table.file)
    return recording.imu(table.t_ns, arrived(table), gyro_b, accel_b)


def _gnss(reader: _Reader) -> list[Stream]:
    table = reader.table("gps", "gnss")
    if table is None:
        return []
    columns = [table.find(_LAT), table.find(_LON), table.find(_ALT)]
    present = [c for c in columns if c is not None]
    if len(present) < 3:
        raise LogError(f"{table.file}: needs lat_deg, lon_deg and alt_m; it has {', '.join(table.names)}")
    lla = np.stack(present, axis=1)
    sensors.check_place(lla, table.file)
    if table.find(_ELLIPSOID) is None:
        reader.notes.append(f"{table.file}: heights are taken as they are; if above sea level, set [map] geoid_m")
    variance = _position_variance(table)
    fixes = recording.gnss(table.t_ns, arrived(table), lla, variance, _status(table))
    v_n = _ned(table, csv_table.VELOCITY)
    if v_n is None:
        return [fixes]
    valid = np.asarray(fixes.columns[2]) >= 0
    rows = np.flatnonzero(valid)
    variance_v = _velocity_variance(table)
    return [fixes, recording.gnss_velocity(table.t_ns[rows], arrived(table)[rows], v_n[rows], variance_v[rows])]


def _ned(table: Table, quantity: Quantity) -> Array | None:
    if table.find(quantity.names("u")) is None:
        return table.vector(quantity, "ned")
    neu = table.vector(quantity, "neu")
    return None if neu is None else neu * np.array([1.0, 1.0, -1.0])


def _position_variance(table: Table) -> Array:
    """(n, 3) m^2 of std columns, else HDOP; nan: not given."""
    unknown = np.full(len(table.t_ns), np.nan)
    axes = "neu" if table.find(csv_table.SIGMA_POSITION.names("u")) is not None else "ned"
    sigma = table.vector(csv_table.SIGMA_POSITION, axes)
    if sigma is not None:
        return sigma**2
    horizontal, vertical = table.find(("std_h_m", "h_acc_m", "eph_m")), table.find(("std_u_m", "v_acc_m", "epv_m"))
    if horizontal is not None:
        down = sensors.VDOP_OVER_HDOP * horizontal if vertical is None else vertical
        return np.stack([horizontal, horizontal, down], axis=1) ** 2
    hdop, vdop = table.find(("hdop",)), table.find(("vdop",))
    return sensors.variance_from_dop(unknown if hdop is None else hdop, unknown if vdop is None else vdop)


def _velocity_variance(table: Table) -> Array:
    """(n, 3) m^2/s^2 of one std column or three; nan: not given."""
    one = table.find(("std_v_m_s", "s_acc_m_s", "speed_accuracy_m_s"))
    if one is not None:
        return np.repeat(one[:, np.newaxis] ** 2, 3, axis=1)
    each = table.vector(csv_table.SIGMA_VELOCITY, "ned") if table.find(csv_table.SIGMA_VELOCITY.names("n")) is not None else None
    return np.full((len(table.t_ns), 3), np.nan) if each is None else each**2


def _status(table: Table) -> Array:
    """NavSatStatus (n,) of fix_type (>= 3: fix), of status (likewise if ever > 2), else 0."""
    fix_type, status = table.find(("fix_type",)), table.find(("status",))
    if fix_type is None and status is not None and np.nanmax(status, initial=-1.0) > 2:
        fix_type = status
    if fix_type is not None:
        return sensors.navsat_status(fix_type)
    return np.zeros(len(table.t_ns)) if status is None else np.where(np.isfinite(status), status, -1.0)


def _baro(reader: _Reader) -> list[Stream]:
    table = reader.table("baro", "airdata")
    if table is None:
        return []
    pressure = table.find({"pressure_pa": 1.0, "press_pa": 1.0, "pressure_hpa": 100.0, "pressure_mbar": 100.0})
    height = table.find(("baro_alt_m", "baro_height_m", "alt_m", "height_m"))
    if pressure is None and height is not None:
        pressure = sensors.standard_pressure(height)
        reader.notes.append(f"{table.file}: heights written as the pressure of the standard atmosphere")
    if pressure is None:
        raise LogError(f"{table.file}: needs pressure_pa or baro_alt_m; it has {', '.join(table.names)}")
    return [recording.sensor("baro", table.t_ns, arrived(table), pressure[:, np.newaxis])]


def _field(reader: _Reader, B: Array) -> list[Stream]:
    table = reader.table("mag")
    if table is None:
        return []
    field_b = frames.turned(table.needed(csv_table.FIELD, "xyz"), B)
    return [recording.sensor("magnetometer", table.t_ns, arrived(table), field_b)]


def _airspeed(reader: _Reader) -> tuple[list[Stream], bool]:
    table = reader.table("airspeed", "airdata")
    true = None if table is None else table.find(_TRUE_AIRSPEED)
    speed = table.find(_INDICATED_AIRSPEED) if table is not None and true is None else true
    if table is None or speed is None:
        return [], False
    return [recording.sensor("airspeed", table.t_ns, arrived(table), speed[:, np.newaxis])], true is None


def _poses(table: Table, options: ImportOptions, B: Array) -> tuple[Array, Array, Array]:
    """p_n (n, 3), v_n (n, 3), q_nb_wxyz (n, 4), nan: not given.

    Columns n, e, d: NED; x, y, z: options' world, else ENU (attitude alone: NED).
    """
    axes = next((a for a in (_NED, "xyz") if table.find(csv_table.POSITION.names(a[0])) is not None), None)
    usual = _NED if axes is None else "enu"
    W = frames.world_axes(_NED if axes == _NED else options.world or usual)
    nothing = np.full((len(table.t_ns), 3), np.nan)
    p, v = (table.vector(quantity, axes) if axes else None for quantity in (csv_table.POSITION, csv_table.VELOCITY))
    q = table.vector(csv_table.ATTITUDE, "wxyz")
    p_n, v_n = (nothing if column is None else frames.turned(column, W) for column in (p, v))
    return p_n, v_n, np.full((len(table.t_ns), 4), np.nan) if q is None else frames.attitude(q, W, B)


def _truth(reader: _Reader, options: ImportOptions, B: Array) -> Stream | None:
    table = reader.table("truth", "groundtruth")
    if table is None:
        return None
    p_n, v_n, q_nb = _poses(table, options, B)
    if np.isnan(p_n).all() and np.isnan(q_nb).all():
        raise LogError(f"{table.file}: neither position (pn_m or px_m) nor attitude (qw); it has {', '.join(table.names)}")
    return recording.truth(table.t_ns, p_n, v_n, q_nb)


def _vision(reader: _Reader, options: ImportOptions, B: Array, purpose: str) -> tuple[Table, Array, Array]:
    table = reader.table("vision")
    if table is None:
        raise LogError(f"{reader.folder}: no vision.csv in it to take {purpose} from")
    p_n, _, q_nb = _poses(table, options, B)
    if np.isnan(p_n).all() or np.isnan(q_nb).all():
        raise LogError(f"{table.file}: needs position and attitude (px_m, qw, ...); it has {', '.join(table.names)}")
    return table, p_n, q_nb


def _odometry(reader: _Reader, options: ImportOptions, B: Array) -> Stream:
    table, p_o, q_ob = _vision(reader, options, B, "odometry")
    return recording.odometry(table.t_ns, arrived(table), p_o, q_ob, np.zeros(len(table.t_ns)))


def _pose_fixes(reader: _Reader, options: ImportOptions, B: Array) -> Stream:
    table, p_n, q_nb = _vision(reader, options, B, "pose fixes")
    period_ns = round(1e9 / options.pose_fix_hz)
    _, rows = np.unique((table.t_ns - table.t_ns[0]) // period_ns, return_index=True)
    sigma = np.repeat([VISION_SIGMA_M, VISION_SIGMA_RAD], 3)
    variance = np.broadcast_to(sigma**2, (len(rows), 6))
    reader.notes.append(f"{table.file}: fixes of {VISION_SIGMA_M} m and {np.rad2deg(VISION_SIGMA_RAD):.0f} degree per axis")
    return recording.pose_fix(table.t_ns[rows], arrived(table)[rows], p_n[rows], q_nb[rows], variance)


def _settings(
    known: DataSet, checks: dict[str, object], aids: list[Stream], truth: Stream | None, airspeed: dict[str, float | bool]
) -> Settings:
    lla = checks.get("origin_lla")
    origin: Vec3 | None = (float(lla[0]), float(lla[1]), float(lla[2])) if isinstance(lla, list) and len(lla) == 3 else None
    gnss = next((s for s in aids if s.topic == "/gnss"), None)
    if gnss and truth:
        origin = sensors.origin_of_truth(gnss, truth, known.gnss_delay_s, origin)
    return Settings(
        known.noise,
        known.noise_reason,
        known.gnss_delay_s,
        known.antenna_b_m,
        known.receiver,
        origin if gnss else None,
        known.altitude,
        known.hard_iron_ut,
        {**airspeed, **known.airspeed},
    )
