"""Airspeed and range in logs: PX4, ArduPilot and a folder of CSV files."""

import struct
from pathlib import Path

import numpy as np
import pytest

from estimator.config import parse
from logs.importers import csv_folder, dataflash, ulog
from logs.importers.recording import Recording
from models.messages import Reading
from tests.logs.importers.test_ulog import ACCELS, GYROS, written


def _values(recording: Recording, kind: str) -> list[float]:
    return [m.values[0] for m in recording if isinstance(m, Reading) and m.kind == kind]


def test_px4_airspeed_is_the_true_one_of_a_sensor(tmp_path: Path) -> None:
    rows = [
        {"timestamp": 1000 + k, "indicated_airspeed_m_s": 14.0, "true_airspeed_m_s": speed, "airspeed_source": source}
        for k, (speed, source) in enumerate([(15.0, 1.0), (np.nan, 1.0), (16.0, 0.0), (17.0, 4.0), (18.0, 2.0)])
    ]
    recording = ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, airspeed_validated=rows))
    assert _values(recording, "airspeed") == [15.0, 18.0]
    assert "indicated" not in recording.settings.toml("ulog", tmp_path, ("/imu", "/airspeed"))


def test_px4_range_is_that_of_the_sensor_that_looks_down(tmp_path: Path) -> None:
    def row(z_m: float, orientation: float) -> dict[str, float]:
        limits = {"min_distance": 0.2, "max_distance": 30.0}
        return {"timestamp": 1000, "current_distance": z_m, "orientation": orientation, "signal_quality": 90.0, **limits}

    down = ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, distance_sensor=[row(3.0, 25.0), row(50.0, 25.0)]))
    assert _values(down, "range") == [3.0, np.inf]
    ahead = ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, distance_sensor=[row(3.0, 0.0)]))
    assert _values(ahead, "range") == []


def _dataflash(path: Path) -> Path:
    """IMU, ARSP and RFND, as ArduPilot 4.5 names them."""
    formats = {"IMU": (1, "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"), "ARSP": (2, "Qf", "TimeUS,Airspeed"),
               "RFND": (3, "QBfBB", "TimeUS,Instance,Dist,Stat,Orient")}  # fmt: skip
    log = b""
    described = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), **formats}
    for name, (kind, form, columns) in described.items():
        size = 3 + (86 if name == "FMT" else struct.calcsize("<" + form))
        log += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name.encode(), form.encode(), columns.encode())
    for k in range(20):
        log += b"\xa3\x95\x01" + struct.pack("<Qffffff", 20_000 * k, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        log += b"\xa3\x95\x02" + struct.pack("<Qf", 20_000 * k, 12.5)
    for dist, status, orient in ((4.5, 4, 25), (0.0, 2, 25), (7.0, 4, 0)):
        log += b"\xa3\x95\x03" + struct.pack("<QBfBB", 100_000, 0, dist, status, orient)
    path.write_bytes(log)
    return path


def test_ardupilot_airspeed_is_indicated_and_range_is_that_of_the_sensor_that_looks_down(tmp_path: Path) -> None:
    recording = dataflash.read(_dataflash(tmp_path / "log.bin"))
    assert _values(recording, "airspeed") == [12.5] * 20
    assert _values(recording, "range") == [4.5, np.inf]
    assert parse(recording.settings.toml("dataflash", tmp_path, ("/imu", "/airspeed"))).airspeed.indicated


@pytest.mark.parametrize(("header", "indicated"), [("ias_m_s", True), ("tas_m_s", False)])
def test_a_csv_column_reports_which_airspeed_it_is(tmp_path: Path, header: str, indicated: bool) -> None:
    imu = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"
    (tmp_path / "imu.csv").write_text(imu + "".join(f"{0.02 * k:.2f},0,0,0,0,0,-9.8\n" for k in range(20)))
    (tmp_path / "airspeed.csv").write_text(f"t_s,{header}\n0.1,17.5\n0.2,17.6\n")
    recording = csv_folder.read(tmp_path)
    assert _values(recording, "airspeed") == [17.5, 17.6]
    config = parse(recording.settings.toml("csv", tmp_path, ("/imu", "/airspeed")))
    assert config.airspeed.indicated is indicated
    assert config.inputs.airspeed == ("/airspeed",)
