"""The ASL folder layout: a recorded flight written as the data set publishes it, and damaged ones."""

import csv
import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from logs.importers import csv_folder, euroc
from logs.importers.recording import ImportOptions, Truth
from logs.store.reader import LogError
from models.messages import ImuSample

IMU_HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRUTH_HEADER = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [],"
    " v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]"
)
SENSOR = """\
#Default imu sensor yaml file
sensor_type: imu
gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]
gyroscope_random_walk: 1.9393e-05       # [ rad / s^2 / sqrt(Hz) ]
accelerometer_noise_density: 2.0000e-3  # [ m / s^2 / sqrt(Hz) ]
accelerometer_random_walk: 3.0000e-3    # [ m / s^3 / sqrt(Hz) ]
"""


def write(folder: Path, imu: list[str], truth: list[str] | None = None) -> Path:
    for name, header, rows in (("imu0", IMU_HEADER, imu), ("state_groundtruth_estimate0", TRUTH_HEADER, truth)):
        if rows is not None:
            (folder / "mav0" / name).mkdir(parents=True)
            (folder / "mav0" / name / "data.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder


def published(flight: Path, name: str, order: list[str]) -> list[str]:
    """Rows as in the data set: integer nanoseconds, then the columns in its order."""
    t0_ns = json.loads((flight / "checks.json").read_text())["t0_unix_ns"]
    with gzip.open(flight / f"{name}.csv.gz", "rt") as file:
        return [",".join([str(t0_ns + round(float(r["t_s"]) * 1e9)), *(r[c] for c in order)]) for r in csv.DictReader(file)]


def test_a_recorded_flight_in_its_own_layout_gives_the_same_messages_as_its_csv_copy(landfix_data: Path, tmp_path: Path) -> None:
    flight = landfix_data / "flights/euroc/V1_02_medium"
    imu = published(flight, "imu", ["gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2"])
    truth = published(flight, "truth", ["px_m", "py_m", "pz_m", "qw", "qx", "qy", "qz", "vx_m_s", "vy_m_s", "vz_m_s"])
    recording = euroc.read(write(tmp_path, imu, truth))
    assert len(recording) == 17_100 + 16_702
    for got, expected in zip(recording, csv_folder.read(flight), strict=True):
        assert (type(got), got.t_ns, got.arrived_ns) == (type(expected), expected.t_ns, expected.arrived_ns)
        if isinstance(got, ImuSample) and isinstance(expected, ImuSample):
            assert (got.gyro_b, got.accel_b) == (expected.gyro_b, expected.accel_b)
        if isinstance(got, Truth) and isinstance(expected, Truth):
            assert (got.p_n, got.v_n, got.q_nb_wxyz) == (expected.p_n, expected.v_n, expected.q_nb_wxyz)
    assert recording.settings.noise.accel_noise == 0.04


ROW = "1403715523912143104,0.1,0.2,0.3,9.8,0.1,-0.2"


def test_axes_of_the_body_are_those_of_the_data_set_by_default(tmp_path: Path) -> None:
    write(tmp_path, [ROW])
    (sample,) = euroc.read(tmp_path)
    assert isinstance(sample, ImuSample)
    assert (sample.t_ns, sample.gyro_b, sample.accel_b) == (1403715523912143104, (0.3, 0.2, -0.1), (-0.2, 0.1, -9.8))
    (sample,) = euroc.read(tmp_path / "mav0", ImportOptions(axes="frd"))
    assert isinstance(sample, ImuSample)
    assert sample.gyro_b == (0.1, 0.2, 0.3)


def test_noise_of_the_sheet_is_made_effective(tmp_path: Path) -> None:
    write(tmp_path, [ROW])
    (tmp_path / "mav0/imu0/sensor.yaml").write_text(SENSOR)
    settings = euroc.read(tmp_path).settings
    noise = settings.noise
    np.testing.assert_allclose((noise.gyro_noise, noise.accel_noise), (4 * 1.6968e-4, 20 * 2e-3))
    np.testing.assert_allclose((noise.gyro_walk, noise.accel_walk), (5 * 1.9393e-5, 3e-3))
    assert "sensor.yaml" in settings.noise_reason


def test_half_a_sheet_is_no_sheet(tmp_path: Path) -> None:
    write(tmp_path, [ROW])
    (tmp_path / "mav0/imu0/sensor.yaml").write_text(SENSOR.replace("accelerometer_random_walk", "nothing"))
    assert euroc.read(tmp_path).settings.noise.gyro_noise == 7e-4


def test_a_folder_without_ground_truth(tmp_path: Path) -> None:
    recording = euroc.read(write(tmp_path, [ROW]))
    assert any(note.startswith("no ground truth") for note in recording.notes)


def test_a_position_alone_is_a_truth_without_attitude(tmp_path: Path) -> None:
    write(tmp_path, [ROW])
    (tmp_path / "mav0/leica0").mkdir()
    (tmp_path / "mav0/leica0/data.csv").write_text(
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]\n1403715523912143104,1,2,3\n"
    )
    truths = [m for m in euroc.read(tmp_path) if isinstance(m, Truth)]
    assert [m.p_n for m in truths] == [(2.0, 1.0, -3.0)]
    turned = [m for m in euroc.read(tmp_path, ImportOptions(world="nwu")) if isinstance(m, Truth)]
    assert [m.p_n for m in turned] == [(1.0, -2.0, -3.0)]
    assert np.isnan(truths[0].q_nb_wxyz).all()


def test_what_cannot_be_imported_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no mav0/imu0/data\.csv in it; euroc needs the folder that holds mav0"):
        euroc.read(tmp_path)
    write(tmp_path, [])
    with pytest.raises(LogError, match=r"data\.csv: no line after the header"):
        euroc.read(tmp_path)
    with pytest.raises(LogError, match="--pose-fix-hz means nothing for euroc logs"):
        euroc.read(tmp_path, ImportOptions(pose_fix_hz=2.0))
