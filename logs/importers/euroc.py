"""ASL data sets (EuRoC, TUM-VI), without images.

    imu0/data.csv                            timestamp [ns], w_RS_S_xyz [rad s^-1], a_RS_S_xyz [m s^-2]
    state_groundtruth_estimate0/data.csv     timestamp, p_RS_R_xyz [m], q_RS_wxyz [], v_RS_R_xyz [m s^-1], biases
    imu0/sensor.yaml                         noise densities, where the set gives them

R is taken as ENU; the body is the IMU frame S (EuRoC's: x up, y right, z forward).
"""

import re
from pathlib import Path

import numpy as np

from logs.importers import csv_table, frames, recording, sensors
from logs.importers.csv_table import read_table
from logs.importers.recording import DEFAULTS, ImportOptions, Progress, Recording, Stream
from logs.importers.settings import DATA_SETS, Settings
from logs.store.reader import LogError
from models.imu import ImuNoise
from models.messages import Array
from models.untrusted.file import content

TRUTHS = ("state_groundtruth_estimate0", "mocap0", "vicon0", "leica0")

_SHEET = {
    "gyro_noise": ("gyroscope_noise_density", 4.0),  # the key in sensor.yaml, and what a small multirotor makes of it
    "accel_noise": ("accelerometer_noise_density", 20.0),
    "gyro_walk": ("gyroscope_random_walk", 5.0),
    "accel_walk": ("accelerometer_random_walk", 1.0),
}


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in mav0 or its parent. Raises LogError."""
    options.refuse_but("euroc", "axes", "world", "imu")
    mav = source / "mav0" if (source / "mav0").is_dir() else source
    folder = mav / (options.imu or "imu0")
    if not (folder / "data.csv").is_file():
        raise LogError(f"{source}: no mav0/{folder.name}/data.csv in it; euroc needs the folder that holds mav0")
    known = DATA_SETS["euroc"]
    B = frames.body_axes(options.axes or known.axes)
    table = read_table(folder / "data.csv")
    gyro_b = frames.turned(table.needed(csv_table.GYRO, "xyz"), B)
    accel_b = frames.turned(table.needed(csv_table.ACCEL, "xyz"), B)
    where = f"{folder.name}/data.csv"
    notes = [*table.notes, *sensors.check_imu(gyro_b, accel_b, where), *sensors.check_rate(table.t_ns, where)]
    if progress:
        progress(0.5)
    imu = recording.imu(table.t_ns, recording.arrival(table.t_ns), gyro_b, accel_b)
    truth = _truth(mav, frames.world_axes(options.world or "enu"), B, notes)
    notes.append("no fixes in this layout: images are not imported")
    noise, reason = _noise(folder / "sensor.yaml")
    settings = Settings(noise or known.noise, reason or known.noise_reason)
    return Recording.of((imu, *([truth] if truth else [])), settings, notes)


def _truth(mav: Path, W: Array, B: Array, notes: list[str]) -> Stream | None:
    path = next((p for p in (mav / name / "data.csv" for name in TRUTHS) if p.is_file()), None)
    if path is None:
        notes.append(f"no ground truth ({', '.join(TRUTHS)})")
        return None
    table = read_table(path)
    notes += table.notes
    p, v, q = (
        table.vector(quantity, axes)
        for quantity, axes in ((csv_table.POSITION, "xyz"), (csv_table.VELOCITY, "xyz"), (csv_table.ATTITUDE, "wxyz"))
    )
    if p is None:
        raise LogError(f"{path.parent.name}/data.csv: no column for position x (p_RS_R_x [m]); it has {', '.join(table.names)}")
    unknown = np.full((len(table.t_ns), 4), np.nan)
    v_n = unknown[:, :3] if v is None else frames.turned(v, W)
    return recording.truth(table.t_ns, frames.turned(p, W), v_n, unknown if q is None else frames.attitude(q, W, B))


def _noise(path: Path) -> tuple[ImuNoise | None, str]:
    text = content(path).decode(errors="replace") if path.is_file() else ""
    values = {}
    for name, (key, factor) in _SHEET.items():
        match = re.search(rf"^\s*{key}:\s*([-+.\deE]+)", text, re.MULTILINE)
        if match is None:
            return None, ""
        values[name] = float(match[1]) * factor
    factors = ", ".join(f"{name} x {factor:g}" for name, (_, factor) in _SHEET.items())
    return ImuNoise(**values), f"of sensor.yaml, made effective for a small multirotor: {factors}"
