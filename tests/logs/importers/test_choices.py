"""What an importer has to choose or to repair: the receiver, the IMU, the unit of time, a clock that was set."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink2

from logs.importers import csv_folder, tlog, ulog
from logs.store.reader import LogError
from models.messages import GnssFix, GnssVelocity, ImuSample
from tests.logs.importers.test_tlog import Ground, fix
from tests.logs.importers.test_ulog import ACCELS, GYROS, message


def receivers(*fields: dict[str, float]) -> list[list[dict[str, float]]]:
    """Ten fixes each of receivers of PX4, with these fields changed."""
    usual = {
        "fix_type": 3.0, "latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_msl_m": 500.0, "altitude_ellipsoid_m": 548.0,
        "eph": 1.0, "epv": 2.0, "s_variance_m_s": 0.3, "vel_ned_valid": 1.0, "vel_n_m_s": 1.0, "vel_e_m_s": 0.0, "vel_d_m_s": 0.0,
    }  # fmt: skip
    return [[{"timestamp": 1000 + 2000 * k, **usual, **other} for k in range(10)] for other in fields]


def px4(folder: Path, gps: list[list[dict[str, float]]]) -> Path:
    """A log with an IMU and several instances of sensor_gps."""
    topics: list[tuple[str, int, list[dict[str, Any]]]] = [("sensor_gyro", 0, GYROS), ("sensor_accel", 0, ACCELS)]
    topics += [("sensor_gps", k, rows) for k, rows in enumerate(gps)]
    log = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for name, instance, rows in topics:
        if instance == 0:
            fields = ";".join(f"{'uint64_t' if 'timestamp' in field else 'double'} {field}" for field in rows[0])
            log += message(b"F", f"{name}:{fields};".encode())
    for k, (name, instance, _) in enumerate(topics):
        log += message(b"A", struct.pack("<BH", instance, k) + name.encode())
    for k, (_, _, rows) in enumerate(topics):
        for row in rows:
            form = "<H" + "".join("Q" if "timestamp" in field else "d" for field in row)
            log += message(b"D", struct.pack(form, k, *row.values()))
    (folder / "log.ulg").write_bytes(log)
    return folder / "log.ulg"


def test_of_two_receivers_the_one_with_fixes_is_taken(tmp_path: Path) -> None:
    recording = ulog.read(px4(tmp_path, receivers({"fix_type": 0.0, "latitude_deg": 0.0}, {"latitude_deg": 47.5})))
    assert {(m.lat_deg, m.status) for m in recording if isinstance(m, GnssFix)} == {(47.5, 0)}
    assert any("sensor_gps 1" in note for note in recording.notes)


def test_an_accuracy_of_zero_is_none(tmp_path: Path) -> None:
    recording = ulog.read(px4(tmp_path, receivers({"eph": 0.0, "epv": 0.0, "s_variance_m_s": 0.0})))
    assert [m.covariance_n for m in recording if isinstance(m, GnssFix)] == [None] * 10
    assert [m.covariance_n for m in recording if isinstance(m, GnssVelocity)] == [None] * 10


def test_the_imu_of_a_companion_computer_is_left_out(tmp_path: Path) -> None:
    ground = Ground()
    companion = mavlink2.MAVLink(None, srcSystem=7, srcComponent=191)
    for k in range(10):
        ground.imu(k * 10_000, 1_000_000 + k * 10_000)
        autopilot, ground.vehicle = ground.vehicle, companion
        ground.imu(k * 10_000 + 1000, 99_000_000 + k * 10_000, z=-5.0)
        ground.imu(k * 10_000 + 2000, 99_005_000 + k * 10_000, z=-5.0)
        ground.vehicle = autopilot
    samples = [m for m in tlog.read(ground.write(tmp_path)) if isinstance(m, ImuSample)]
    np.testing.assert_allclose([m.accel_b[2] for m in samples], [-9.8] * 10, rtol=1e-6)


@pytest.mark.parametrize("set_s", [-3600, 3600])
def test_a_ground_clock_that_is_set_leaves_no_hole(set_s: int, tmp_path: Path) -> None:
    ground = Ground()
    for k in range(20):
        late_us = set_s * 1_000_000 if k >= 10 else 0
        ground.imu(k * 10_000 + late_us, 5_000_000 + k * 10_000)
        ground.hear(k * 10_000 + late_us, fix(5_000_000 + k * 10_000))
    recording = tlog.read(ground.write(tmp_path))
    for kind in (ImuSample, GnssFix):
        assert np.diff([m.t_ns for m in recording if isinstance(m, kind)]).tolist() == [10_000_000] * 19
    assert any("clock was set 1 times" in note for note in recording.notes)


def imu_csv(folder: Path, header: str, times: list[float], separator: str = ",") -> Path:
    names = f"{header},gx,gy,gz,ax,ay,az".replace(",", separator)
    rows = (separator.join(map(str, (t, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8))) for t in times)
    (folder / "imu.csv").write_text("\n".join((names, *rows)) + "\n")
    return folder


def test_seconds_of_the_day_go_on_over_midnight(tmp_path: Path) -> None:
    times = [round((86_399.9 + 0.01 * k) % 86_400, 3) for k in range(30)]
    recording = csv_folder.read(imu_csv(tmp_path, "t_s", times))
    assert np.diff([m.t_ns for m in recording]).tolist() == [10_000_000] * 29
    assert any("midnight" in note for note in recording.notes)


def test_milliseconds_are_not_taken_for_seconds(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"10 s from one sample to the next.*t_ms"):
        csv_folder.read(imu_csv(tmp_path, "time", [10.0 * k for k in range(30)]))


@pytest.mark.parametrize(("separator", "name"), [("\t", "tabs"), (";", "semicolons")])
def test_other_separators_are_named(separator: str, name: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=f"separated by {name}; commas are wanted"):
        csv_folder.read(imu_csv(tmp_path, "t_s", [0.0, 0.01], separator))
