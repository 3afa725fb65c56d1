"""Folders of CSV files: the recorded flights as they are, and small ones written here."""

import csv
import gzip
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.importers import csv_folder
from logs.importers.recording import EPOCH_NS, ImportOptions, Message, Truth
from logs.store.reader import LogError
from models.frames import Origin
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, OdometryPose, PoseFix, Reading
from tests import long

M = TypeVar("M", bound=Message)

SETS = ["ardupilot_logs", "euroc", "inertialnav_logs", "quad_rtk_dot", "rtk_drive_walk", "tumvi_room", "umn_thor75"]

# Rows map the file's body axes to FRD, and its world axes to NED; written out here by hand.
BODY = {"euroc": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "tumvi_room": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}
ENU = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]


def columns(path: Path) -> dict[str, Array]:
    """By the csv module, cell by cell."""
    file = path if path.is_file() else path.with_name(path.name + ".gz")
    with gzip.open(file, "rt") if file.suffix == ".gz" else file.open() as f:
        header, *rows = csv.reader(f)
    return {name: np.array([float(row[k]) for row in rows]) for k, name in enumerate(header)}


def has(flight: Path, name: str) -> bool:
    return any((flight / f"{name}{ending}").is_file() for ending in (".csv", ".csv.gz"))


def of(messages: Iterable[Message], kind: type[M]) -> list[M]:
    return [m for m in messages if isinstance(m, kind)]


def stack(table: dict[str, Array], *names: str) -> Array:
    return np.stack([table[name] for name in names], axis=1)


class Flight:
    """A recorded flight as imported, and what its files hold."""

    def __init__(self, data_set: str, folder: Path) -> None:
        self.folder = folder
        self.B = np.array(BODY.get(data_set, np.eye(3)))
        recording = csv_folder.read(folder)
        self.settings, messages = recording.settings, list(recording)
        self.imu, self.truth = of(messages, ImuSample), of(messages, Truth)
        self.fixes, self.velocities = of(messages, GnssFix), of(messages, GnssVelocity)
        self.imu_file, self.truth_file = columns(folder / "imu.csv"), columns(folder / "truth.csv")
        self.gps_file = columns(folder / "gps.csv") if has(folder, "gps") else None


@pytest.fixture(scope="module", params=long.some(SETS, one_in=4))
def flights(request: pytest.FixtureRequest, landfix_data: Path) -> list[Flight]:
    folder = landfix_data / "flights" / request.param
    found = sorted(p.parent for p in folder.rglob("imu.csv*"))
    assert found
    return [Flight(request.param, flight) for flight in found]


def test_every_imu_sample_of_every_set(flights: list[Flight]) -> None:
    for flight in flights:
        table, got = flight.imu_file, flight.imu
        assert len(got) == len(table["t_s"])
        gyro, accel = stack(table, "gx_rad_s", "gy_rad_s", "gz_rad_s"), stack(table, "ax_m_s2", "ay_m_s2", "az_m_s2")
        np.testing.assert_array_equal([m.gyro_b for m in got], gyro @ flight.B.T)
        np.testing.assert_array_equal([m.accel_b for m in got], accel @ flight.B.T)
        t0_ns = json.loads((flight.folder / "checks.json").read_text()).get("t0_unix_ns", EPOCH_NS)
        assert [m.t_ns for m in got] == [t0_ns + round(t * 1e9) for t in table["t_s"]]
        assert -11.5 < np.median([m.accel_b[2] for m in got]) < -6.0, flight.folder


def test_every_truth_of_every_set(flights: list[Flight]) -> None:
    for flight in flights:
        table, got = flight.truth_file, flight.truth
        W = np.array(ENU if "px_m" in table else np.eye(3))
        assert len(got) == len(table["t_s"])
        axes = "xyz" if "px_m" in table else "ned"
        if f"p{axes[0]}_m" in table:
            np.testing.assert_array_equal([m.p_n for m in got], stack(table, *(f"p{a}_m" for a in axes)) @ W.T)
            np.testing.assert_array_equal([m.v_n for m in got], stack(table, *(f"v{a}_m_s" for a in axes)) @ W.T)
        else:
            assert np.isnan([m.p_n for m in got]).all()
        q = np.array([m.q_nb_wxyz for m in got])
        if "qw" in table:
            R_file = Rotation.from_quat(stack(table, "qw", "qx", "qy", "qz"), scalar_first=True).as_matrix()
            np.testing.assert_allclose(Rotation.from_quat(q, scalar_first=True).as_matrix(), W @ R_file @ flight.B.T, atol=1e-12)
        else:
            assert np.isnan(q).all()


def test_truth_and_imu_agree_on_where_down_is(flights: list[Flight]) -> None:
    """R_nb f, averaged over a flight, is -g: only with the axes of both right."""
    for flight in flights:
        q = np.array([m.q_nb_wxyz for m in flight.truth])
        if np.isnan(q).any():
            continue
        t = np.array([m.t_ns for m in flight.imu])
        nearest = np.clip(np.searchsorted(t, [m.t_ns for m in flight.truth]), 0, len(t) - 1)
        force = np.array([m.accel_b for m in flight.imu])[nearest]
        mean = Rotation.from_quat(q, scalar_first=True).apply(force).mean(axis=0)
        assert np.abs(mean - [0.0, 0.0, -9.8]).max() < 0.8, (flight.folder, mean)


def test_every_fix_of_every_set(flights: list[Flight]) -> None:
    for flight in flights:
        table, got = flight.gps_file, flight.fixes
        if table is None:
            assert not got
            assert flight.settings.origin is None
            continue
        np.testing.assert_array_equal([(m.lat_deg, m.lon_deg, m.alt_m) for m in got], stack(table, "lat_deg", "lon_deg", "alt_m"))
        good = table["status"] >= 3 if "status" in table else np.ones(len(got), bool)
        assert [m.status >= 0 for m in got] == good.tolist()
        v_n = stack(table, "vn_m_s", "ve_m_s", "vd_m_s")[good]
        np.testing.assert_array_equal([m.v_n for m in flight.velocities], v_n)
        covariance = got[-1].covariance_n
        assert (covariance is None) == (not {"std_n_m", "hdop"} & table.keys())
        if covariance is not None and "std_n_m" in table:
            np.testing.assert_allclose(np.diag(covariance), [table[c][-1] ** 2 for c in ("std_n_m", "std_e_m", "std_u_m")])


def test_the_origin_carries_the_truth_to_the_fixes(flights: list[Flight]) -> None:
    """The median distance between fixes and truth, in n at the origin of the settings, is small in each axis."""
    for flight in flights:
        p = np.array([m.p_n for m in flight.truth])
        if flight.settings.origin is None or np.isnan(p).any():
            continue
        origin, t = Origin(*flight.settings.origin), np.array([m.t_ns for m in flight.truth])
        good = [m for m in flight.fixes if m.status >= 0 and t[0] < m.t_ns < t[-1]]
        nearest = np.searchsorted(t, [m.t_ns for m in good])
        places = np.array([origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m) for m in good])
        assert np.abs(np.median(places - p[nearest], axis=0)).max() < 2.5, flight.folder


def test_settings_of_the_sets(landfix_data: Path) -> None:
    flights = landfix_data / "flights"
    late = csv_folder.read(flights / "inertialnav_logs/quad106").settings
    assert late.gnss_delay_s == 0.21
    assert csv_folder.read(flights / "umn_thor75").settings.origin == (45.32883681495387, -93.23095410966317, 249.46754455566406)
    above_take_off = csv_folder.read(flights / "quad_rtk_dot/flight_a").settings.origin  # checks.json has the first fix's height
    assert above_take_off is not None
    assert above_take_off[2] == pytest.approx(12.5942341 - 7.1, abs=0.01)
    assert csv_folder.read(flights / "euroc/V1_02_medium").settings.noise.accel_noise == 0.04
    drive = csv_folder.read(flights / "rtk_drive_walk/drive_0708").settings
    assert drive.antenna_b_m == (0.0, -0.05, 0.0)
    assert drive.receiver["velocity_delay_s"] == 0.125


def test_the_drives_velocity_is_as_much_older_than_its_position_as_its_settings_say(landfix_data: Path) -> None:
    recording = csv_folder.read(landfix_data / "flights/rtk_drive_walk/drive_0708")
    fixes, velocities = of(recording, GnssFix), of(recording, GnssVelocity)
    assert recording.settings.origin is not None
    origin = Origin(*recording.settings.origin)
    t_s = np.array([m.t_ns - fixes[0].t_ns for m in fixes]) * 1e-9
    p_n = np.array([origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m) for m in fixes])
    moved, at_s = np.diff(p_n, axis=0) / np.diff(t_s)[:, None], 0.5 * (t_s[1:] + t_s[:-1])  # the mean velocity of an interval
    stamp_s = np.array([m.t_ns - fixes[0].t_ns for m in velocities]) * 1e-9
    v_n = np.array([m.v_n for m in velocities])
    delays_s = np.arange(0.0, 0.26, 0.025)
    off = [np.sqrt(np.mean([(np.interp(at_s + d, stamp_s, v_n[:, k]) - moved[:, k]) ** 2 for k in range(2)])) for d in delays_s]
    assert delays_s[np.argmin(off)] == pytest.approx(recording.settings.receiver["velocity_delay_s"], abs=0.026)
    assert min(off) < 0.5 * off[0]


def test_another_imu_on_request(landfix_data: Path) -> None:
    flight = landfix_data / "flights/ardupilot_logs/log171"
    second = of(csv_folder.read(flight, ImportOptions(imu="imu2")), ImuSample)
    assert second[0].accel_b == (-0.04201063, -0.653491, -9.381412)


def test_poses_of_vision_serve_as_fixes_on_request(landfix_data: Path) -> None:
    flight = landfix_data / "flights/euroc/V1_02_medium"
    assert not of(csv_folder.read(flight), PoseFix)
    recording = csv_folder.read(flight, ImportOptions(pose_fix_hz=2.0))
    fixes, truths = of(recording, PoseFix), of(recording, Truth)
    gaps = np.diff([m.t_ns for m in fixes]) * 1e-9
    assert 0.45 < np.median(gaps) < 0.55
    assert gaps.min() > 0.4
    t = np.array([m.t_ns for m in truths])
    nearest = np.clip(np.searchsorted(t, [m.t_ns for m in fixes]), 0, len(t) - 1)
    p, q = np.array([m.p_n for m in fixes]), np.array([m.q_nb_wxyz for m in fixes])
    p_true, q_true = np.array([m.p_n for m in truths])[nearest], np.array([m.q_nb_wxyz for m in truths])[nearest]
    assert 0.02 < np.sqrt(np.mean((p - p_true) ** 2)) < 0.1
    turn = Rotation.from_quat(q, scalar_first=True) * Rotation.from_quat(q_true, scalar_first=True).inv()
    assert 0.3 < np.rad2deg(np.sqrt(np.mean(turn.as_rotvec() ** 2))) < 2.0


def test_poses_of_vision_are_an_odometry_on_request(landfix_data: Path) -> None:
    flight = landfix_data / "flights/euroc/V1_02_medium"
    assert not of(csv_folder.read(flight), OdometryPose)
    recording = csv_folder.read(flight, ImportOptions(odometry=True))
    poses = of(recording, OdometryPose)
    fixes = of(csv_folder.read(flight, ImportOptions(pose_fix_hz=100.0)), PoseFix)
    assert [(m.t_ns, m.p_o, m.q_ob_wxyz) for m in poses] == [(m.t_ns, m.p_n, m.q_nb_wxyz) for m in fixes]
    assert {m.frame for m in poses} == {"odom 0"}
    assert 'odometry = ["/odometry"]' in recording.settings.toml("csv", flight, ("/imu", "/odometry")).splitlines()


# --- small folders -----------------------------------------------------------------------------------------------------------

IMU = "t_s,gx,gy,gz,ax,ay,az\n" + "".join(f"{k / 100},0.01,0.02,0.03,0.1,0.2,-9.8\n" for k in range(50))
GPS = "t_s,lat,lon,alt,ve,vn,vu,{more}\n0.1,47.5,8.5,500,1,2,3,{cells}\n"


def folder(path: Path, **files: str) -> Path:
    for name, text in files.items():
        (path / f"{name}.csv").write_text(text)
    return path


def test_imu_alone_is_a_recording_and_reports_what_is_missing(tmp_path: Path) -> None:
    recording = csv_folder.read(folder(tmp_path, imu=IMU))
    assert len(recording) == 50
    assert recording.settings.origin is None
    assert "nothing to start from" in recording.notes[0]


def test_axes_and_world_by_option(tmp_path: Path) -> None:
    flu = IMU.replace("0.2,-9.8", "-0.2,9.8").replace("0.02,0.03", "-0.02,-0.03")
    truth = "t_s,px,py,pz,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n"
    recording = csv_folder.read(folder(tmp_path, imu=flu, truth=truth), ImportOptions(axes="flu", world="nwu"))
    sample, place = of(recording, ImuSample)[0], of(recording, Truth)[0]
    assert (sample.gyro_b, sample.accel_b) == ((0.01, 0.02, 0.03), (0.1, 0.2, -9.8))
    assert place.p_n == (1.0, -2.0, -3.0)
    np.testing.assert_allclose(np.abs(place.q_nb_wxyz), [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    assert np.isnan(place.v_n).all()


def test_axes_that_contradict_gravity_are_reported(tmp_path: Path) -> None:
    recording = csv_folder.read(folder(tmp_path, imu=IMU), ImportOptions(axes="flu"))
    assert any("wrong axes?" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("more", "cells", "variance", "status"),
    [
        ("nsat", "7", None, 0),
        ("std_n_m,std_e_m,std_u_m", "1,2,3", [1.0, 4.0, 9.0], 0),
        ("h_acc_m,v_acc_m", "2,3", [4.0, 4.0, 9.0], 0),
        ("hdop", "2", [18.0, 18.0, 81.0], 0),
        ("fix_type", "2", None, -1),
        ("fix_type", "6", None, 2),
        ("status", "-1", None, -1),
        ("status", "1", None, 1),
        ("status", "3", None, 0),
    ],
)
def test_accuracy_and_status_of_fixes(tmp_path: Path, more: str, cells: str, variance: list[float] | None, status: int) -> None:
    recording = csv_folder.read(folder(tmp_path, imu=IMU, gps=GPS.format(more=more, cells=cells)))
    (fix,) = of(recording, GnssFix)
    assert fix.status == status
    assert (fix.covariance_n is None) == (variance is None)
    if fix.covariance_n is not None and variance is not None:
        np.testing.assert_allclose(fix.covariance_n, np.diag(variance))
    velocities = of(recording, GnssVelocity)
    assert [m.v_n for m in velocities] == ([(2.0, 1.0, -3.0)] if status >= 0 else [])


def test_a_fix_arrives_when_the_file_reports_it(tmp_path: Path) -> None:
    gps = "t_s,arrived_s,lat,lon,alt\n0.05,0.25,47.5,8.5,500\n"
    recording = csv_folder.read(folder(tmp_path, imu=IMU, gps=gps))
    kinds = [type(m) for m in recording]
    assert kinds.index(GnssFix) == 25
    (fix,) = of(recording, GnssFix)
    assert (fix.t_ns, fix.arrived_ns) == (EPOCH_NS + 50_000_000, EPOCH_NS + 250_000_000)


@pytest.mark.parametrize(("unit", "value"), [("_t", 2e-5), ("_ut", 20.0), ("_gauss", 0.2), ("_mgauss", 200.0)])
def test_a_magnetic_field_is_in_tesla_and_in_the_axes_of_the_imu(tmp_path: Path, unit: str, value: float) -> None:
    table = f"t_s,mx{unit},my{unit},mz{unit}\n0,{value},{2 * value},{-value}\n"
    recording = csv_folder.read(folder(tmp_path, imu=IMU, mag=table), ImportOptions(axes="flu"))
    (message,) = of(recording, Reading)
    assert message.kind == "magnetometer"
    np.testing.assert_allclose(message.values, [2e-5, -4e-5, 2e-5])


@pytest.mark.parametrize(
    ("header", "cell", "pascal"),
    [("pressure_pa", "95000", 95000.0), ("pressure_hpa", "950", 95000.0), ("baro_alt_m", "0", 101325.0)],
)
def test_pressure_or_barometric_height(tmp_path: Path, header: str, cell: str, pascal: float) -> None:
    (message,) = of(csv_folder.read(folder(tmp_path, imu=IMU, baro=f"t_s,{header}\n0,{cell}\n")), Reading)
    assert message.values[0] == pytest.approx(pascal, rel=1e-12)


def test_nan_rows_stay_for_the_estimator_to_judge(tmp_path: Path) -> None:
    recording = csv_folder.read(folder(tmp_path, imu=IMU + "0.5,nan,0,0,0,0,-9.8\n", gps="t_s,lat,lon,alt\n0.1,nan,8.5,500\n"))
    assert np.isnan(of(recording, ImuSample)[-1].gyro_b[0])
    assert np.isnan(of(recording, GnssFix)[0].lat_deg)


@pytest.mark.parametrize(
    ("files", "line"),
    [
        ({"gps": "t_s,lat,lon,alt\n"}, "no imu.csv or imu.csv.gz in it (there is: gps.csv)"),
        ({"imu": IMU.replace("gz", "temperature")}, "imu.csv: no column for angular rate z"),
        ({"imu": IMU.replace("-9.8", "-1.0")}, "imu.csv: the accelerometer reads 1.02 in the median: that is g"),
        ({"imu": IMU, "gps": "t_s,lat,lon\n0,1,2\n"}, "gps.csv: needs lat_deg, lon_deg and alt_m; it has t_s, lat, lon"),
        (
            {"imu": IMU, "gps": "t_s,lat,lon,alt\n0,473977422,85455940,488\n"},
            "gps.csv: latitude or longitude 473977422 is not degrees",
        ),
        ({"imu": IMU, "baro": "t_s,temperature\n0,1\n"}, "baro.csv: needs pressure_pa or baro_alt_m"),
        ({"imu": IMU, "truth": "t_s,vn,ve,vd\n0,1,2,3\n"}, "truth.csv: neither position (pn_m or px_m) nor attitude (qw)"),
    ],
)
def test_what_cannot_be_imported_is_reported_in_one_line(tmp_path: Path, files: dict[str, str], line: str) -> None:
    with pytest.raises(LogError) as raised:
        csv_folder.read(folder(tmp_path, **files))
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_instead_of_a_folder(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"not a folder; csv needs the folder that holds imu\.csv"):
        csv_folder.read(folder(tmp_path, imu=IMU) / "imu.csv")


def test_pose_fixes_without_vision(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no vision\.csv in it to take pose fixes from"):
        csv_folder.read(folder(tmp_path, imu=IMU), ImportOptions(pose_fix_hz=1.0))
