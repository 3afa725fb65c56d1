"""ArduPilot's on-board logs: every value against pymavlink and the CSV copy of the same flight; newer forms written here."""

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from logs.importers import csv_folder, dataflash
from logs.importers.recording import EPOCH_NS, ImportOptions, Recording, Truth
from logs.store.reader import LogError
from models import so3
from models.frames import Origin
from models.messages import AttitudePrior, GnssFix, GnssVelocity, ImuSample, OdometryDelta, OdometryPose, Reading


@pytest.fixture(scope="module")
def flown(landfix_data: Path) -> Path:
    return landfix_data / "native_logs/ardupilot_log171.bin"


@pytest.fixture(scope="module")
def recording(flown: Path) -> Recording:
    return dataflash.read(flown)


@pytest.fixture(scope="module")
def rows(flown: Path) -> dict[str, list[DFReader.DFMessage]]:
    """All messages, by pymavlink alone."""
    found: dict[str, list[DFReader.DFMessage]] = {}
    with DFReader.DFReader_binary(str(flown)) as log:
        while (message := log.recv_msg()) is not None:
            found.setdefault(message.get_type(), []).append(message)
    return found


def test_every_imu_sample(recording: Recording, rows: dict[str, list[DFReader.DFMessage]]) -> None:
    got = [m for m in recording if isinstance(m, ImuSample) and m.topic == "/imu"]
    assert len(got) == 11916
    assert [m.gyro_b for m in got] == [(r.GyrX, r.GyrY, r.GyrZ) for r in rows["IMU"]]
    assert [m.accel_b for m in got] == [(r.AccX, r.AccY, r.AccZ) for r in rows["IMU"]]
    np.testing.assert_allclose([m.t_ns * 1e-9 for m in got], [r._timestamp for r in rows["IMU"]], rtol=0, atol=2e-6)
    steps = [m.t_ns - got[0].t_ns for m in got]
    assert steps == [(r.TimeMS - rows["IMU"][0].TimeMS) * 1_000_000 for r in rows["IMU"]]


def test_every_fix(recording: Recording, rows: dict[str, list[DFReader.DFMessage]]) -> None:
    got = [m for m in recording if isinstance(m, GnssFix)]
    assert [(m.lat_deg, m.lon_deg, m.alt_m) for m in got] == [(r.Lat, r.Lng, r.Alt) for r in rows["GPS"]]
    assert [m.status >= 0 for m in got] == [r.Status >= 3 for r in rows["GPS"]]
    assert sum(m.status < 0 for m in got) == 161
    np.testing.assert_allclose([m.arrived_ns * 1e-9 for m in got], [r._timestamp for r in rows["GPS"]], rtol=0, atol=2e-6)
    last = got[-1].covariance_n
    assert last is not None
    np.testing.assert_allclose(np.diag(last), np.array([0.5, 0.5, 2.25]) * (3.0 * rows["GPS"][-1].HDop) ** 2)
    velocities = [m for m in recording if isinstance(m, GnssVelocity)]
    good = [r for r in rows["GPS"] if r.Status >= 3]
    course = np.deg2rad([r.GCrs for r in good])
    speed = np.array([r.Spd for r in good])
    v_n = np.stack([speed * np.cos(course), speed * np.sin(course), [r.VZ for r in good]], axis=1)
    np.testing.assert_allclose([m.v_n for m in velocities], v_n, atol=1e-12)


def test_fixes_are_as_regular_as_the_receiver_made_them(recording: Recording) -> None:
    """GIVEN arrivals that jitter by 10 ms and more WHEN stamped by the receiver's clock THEN stamps are 200 ms apart."""
    got = [m for m in recording if isinstance(m, GnssFix) and m.status >= 0]
    arrivals, stamps = np.diff([m.arrived_ns for m in got]) * 1e-6, np.diff([m.t_ns for m in got]) * 1e-6
    usual = stamps[(stamps > 150) & (stamps < 250)]
    assert len(usual) > 1000
    assert usual.std() < 3.0
    assert arrivals[(arrivals > 150) & (arrivals < 250)].std() > 8.0
    latency = np.array([m.arrived_ns - m.t_ns for m in got])
    assert latency.min() >= 0
    assert recording.settings.gnss_delay_s == pytest.approx(
        0.2 - 1e-9 * np.median([m.arrived_ns - m.t_ns for m in recording if isinstance(m, GnssFix)])
    )


def test_pressure_and_reference(recording: Recording, rows: dict[str, list[DFReader.DFMessage]]) -> None:
    assert [m.values[0] for m in recording if isinstance(m, Reading) and m.kind == "baro"] == [r.Press for r in rows["BARO"]]
    fields = [m.values for m in recording if isinstance(m, Reading) and m.kind == "magnetometer"]
    np.testing.assert_allclose(fields, [(1e-7 * r.MagX, 1e-7 * r.MagY, 1e-7 * r.MagZ) for r in rows["MAG"]])
    truths = [m for m in recording if isinstance(m, Truth)]
    assert [m.p_n for m in truths] == [(r.PN, r.PE, r.PD) for r in rows["EKF1"]]
    assert [m.v_n for m in truths] == [(r.VN, r.VE, r.VD) for r in rows["EKF1"]]
    r = rows["EKF1"][1500]
    np.testing.assert_allclose(
        np.rad2deg(so3.to_euler(np.array(truths[1500].q_nb_wxyz))), [r.Roll, r.Pitch, r.Yaw - 360 * (r.Yaw > 180)], atol=1e-9
    )


def test_the_autopilots_attitude_twice_a_second(recording: Recording) -> None:
    known = {m.t_ns: m.q_nb_wxyz for m in recording if isinstance(m, Truth)}
    got = [m for m in recording if isinstance(m, AttitudePrior)]
    assert all(m.q_nb_wxyz == known[m.t_ns] for m in got)
    assert np.median(np.diff([m.t_ns for m in got])) == pytest.approx(5e8, rel=0.05)
    np.testing.assert_allclose(np.rad2deg(np.sqrt(np.diag(got[0].covariance))), [2.0, 2.0, 4.0])


def test_the_same_flight_as_its_csv_copy(recording: Recording, landfix_data: Path) -> None:
    copy = csv_folder.read(landfix_data / "flights/ardupilot_logs/log171")
    for topic, tolerance in (("/imu", 1e-6), ("/gnss", 1e-6), ("/gnss/velocity", 1e-3), ("/truth", 1e-3)):
        mine, theirs = recording.stream(topic), copy.stream(topic)
        assert mine is not None
        assert theirs is not None
        assert len(mine) == len(theirs)
        np.testing.assert_array_equal(np.diff(mine.arrived_ns), np.diff(theirs.arrived_ns))
        np.testing.assert_allclose(mine.columns[0], theirs.columns[0], rtol=tolerance, atol=tolerance)
    mine_at, theirs_at = recording.settings.origin, copy.settings.origin
    assert mine_at is not None
    assert theirs_at is not None
    assert np.abs(Origin(*theirs_at).to_ned(*mine_at)).max() < 0.3


def test_another_imu_on_request(flown: Path, rows: dict[str, list[DFReader.DFMessage]]) -> None:
    stream = dataflash.read(flown, ImportOptions(imu="imu3")).stream("/imu")
    assert stream is not None
    assert stream.columns[0].tolist() == [[r.GyrX, r.GyrY, r.GyrZ] for r in rows["IMU3"]]


def test_a_torn_and_a_damaged_log_are_read_as_far_as_possible(
    flown: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(flown.read_bytes()[:1_000_003])
    data[500_000:500_400] = bytes(400)
    path = tmp_path / "torn.bin"
    path.write_bytes(data)
    stream = dataflash.read(path).stream("/imu")
    assert stream is not None
    assert 3000 < len(stream) < 5000
    assert capfd.readouterr() == ("", "")


# --- logs as newer versions write them ---------------------------------------------------------------------------------------

FORMATS = {  # name: type, format, columns
    "IMU": (129, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": (130, "QBBIHBcLLeffff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"),
    "GPA": (131, "QBCCCC", "TimeUS,I,VDop,HAcc,VAcc,SAcc"),
    "XKF1": (132, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "ORGN": (133, "QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "VISP": (135, "QffffffB", "TimeUS,PX,PY,PZ,R,P,Y,Rst"),
    "VISO": (136, "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf"),
    "OF": (137, "QBffff", "TimeUS,Qual,flowX,flowY,bodyX,bodyY"),
    "WENC": (138, "Qfbfb", "TimeUS,Dist0,Qual0,Dist1,Qual1"),
    "RFND": (139, "QBCBB", "TimeUS,Instance,Dist,Stat,Orient"),
    "PARM": (134, "QNff", "TimeUS,Name,Value,Default"),
    "SIM": (150, "QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
    "MAG": (152, "QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    "SIM2": (151, "Qfff", "TimeUS,VN,VE,VD"),
    "UBX1": (153, "QBHBBHI", "TimeUS,Instance,noisePerMS,jamInd,aPower,agcCnt,config"),
}
STRUCT = {
    "Q": "Q",
    "B": "B",
    "b": "b",
    "h": "h",
    "f": "f",
    "I": "I",
    "H": "H",
    "c": "h",
    "C": "H",
    "L": "i",
    "e": "i",
    "N": "16s",
}


def row(name: str, *values: float | bytes) -> bytes:
    kind, form, _ = FORMATS[name]
    return struct.pack("<BBB" + "".join(STRUCT[c] for c in form), 0xA3, 0x95, kind, *values)


def header(**columns: str) -> bytes:
    fmt = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for name, (kind, form, fields) in FORMATS.items():
        length = 3 + struct.calcsize("<" + "".join(STRUCT[c] for c in form))
        written = columns.get(name, fields).encode()
        fmt += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), written)
    return fmt


def imu_rows(n: int) -> bytes:
    return b"".join(
        row("IMU", 1_000_000 + 2500 * k, instance, 0.1 * instance, 0.2, 0.3, 0.0, 0.0, -9.75)
        for k in range(n)
        for instance in (0, 1)
    )


def gps_row(t_us: int, instance: int, gms: int, lat: int) -> bytes:
    return row("GPS", t_us, instance, 3, gms, 2200, 12, 150, lat, 85455940, 48800, 5.0, 90.0, -0.5, 0.0)


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    path = tmp_path / "newer.BIN"
    log = header() + row("PARM", 900_000, b"GPS_DELAY_MS", 150.0, 0.0) + row("ORGN", 950_000, 0, 473977400, 85455900, 48700)
    log += imu_rows(400)
    for k, late_us in enumerate([30_000, 0, 45_000, 10_000]):
        t_us = 1_100_000 + 200_000 * k + late_us
        log += gps_row(t_us, 0, 400_000_000 + 200 * k, 473977420 + k) + row("GPA", t_us, 0, 80, 120, 200, 30)
        log += gps_row(t_us + 100, 1, 400_000_000 + 200 * k, 473977000)
        log += row("XKF1", t_us, 0, 100, -200, 9000, 1.0, 2.0, 3.0, 0.0, 4.0, 5.0, -6.0, 0, 0, 0, 0)
        log += row("XKF1", t_us, 1, 0, 0, 0, *([0.0] * 7), 0, 0, 0, 0)
    path.write_bytes(log)
    return path


def test_instances_are_distinguished(newer: Path) -> None:
    first, second = dataflash.read(newer), dataflash.read(newer, ImportOptions(imu="IMU2"))
    a, b = first.stream("/imu"), second.stream("/imu")
    assert a is not None
    assert b is not None
    assert (len(a), len(b)) == (400, 400)
    np.testing.assert_allclose(a.columns[0][:, 0], 0.0)
    np.testing.assert_allclose(b.columns[0][:, 0], 0.1, rtol=1e-6)
    assert np.diff(a.t_ns).tolist() == [2_500_000] * 399
    topics = [s.topic for s in first.streams]
    assert topics == ["/gnss", "/gnss/velocity", "/gnss2", "/gnss2/velocity", "/imu", "/imu2", "/attitude", "/truth"]
    np.testing.assert_allclose((first.stream("/imu2") or b).columns[0], b.columns[0])
    assert second.stream("/imu2") is None
    assert len(first.stream("/truth") or ()) == 4  # of the first core only


def test_what_u_blox_says_of_its_reception_is_noted(newer: Path) -> None:
    rows = [(0, 90, 7, 1, 819, 0), (0, 101, 39, 1, 1638, 0), (1, 0, 200, 1, 0, 0)]
    newer.write_bytes(newer.read_bytes() + b"".join(row("UBX1", 1_200_000 + k, *r) for k, r in enumerate(rows)))
    notes = dataflash.read(newer).notes
    usual, most = "jamming indicator 23 of 255, gain 15 %, noise 96", "jamming indicator 39 of 255, gain 20 %, noise 101"
    assert f"/gnss: {usual}; at most: {most}" in notes
    assert "/gnss2: jamming indicator 200 of 255; at most: jamming indicator 200 of 255" in notes


@pytest.mark.parametrize("names", ["R,P,Y", "Roll,Pitch,Yaw"])
def test_poses_from_outside_are_an_odometry_that_begins_anew_at_a_reset(newer: Path, names: str) -> None:
    newer.write_bytes(newer.read_bytes().replace(header(), header(VISP=f"TimeUS,PX,PY,PZ,{names},Rst")))
    newer.write_bytes(
        newer.read_bytes()
        + row("VISP", 1_200_000, 1.0, 2.0, -3.0, 0.0, 0.0, 90.0, 0)
        + row("VISP", 1_300_000, 7.0, 2.0, -3.0, 0.0, 0.0, 90.0, 1)
    )
    recording = dataflash.read(newer)
    first, second = (m for m in recording if isinstance(m, OdometryPose))
    np.testing.assert_allclose(first.p_o, (1.0, 2.0, -3.0))
    np.testing.assert_allclose(np.rad2deg(so3.to_euler(np.array(first.q_ob_wxyz))), (0.0, 0.0, 90.0), atol=1e-6)
    assert first.frame != second.frame
    assert second.t_ns - first.t_ns == 100_000_000
    assert '# odometry = "/odometry"' in recording.settings.toml("dataflash", newer, ("/imu", "/odometry"))


def test_a_cameras_steps_are_joined_though_their_stamps_jitter(newer: Path) -> None:
    """Ten steps of 50 ms, 0.1 m forward and 0.01 rad to the right each, written up to 8 ms late; then one without confidence."""
    late_us = [0, 8000, 1000, 0, 5000, 8000, 0, 3000, 7000, 2000]
    rows = [row("VISO", 1_200_000 + 50_000 * k + late, 0.05, 0, 0, 0.01, 0.1, 0, 0, 90.0) for k, late in enumerate(late_us)]
    newer.write_bytes(newer.read_bytes() + b"".join(rows) + row("VISO", 1_700_000, 0.05, 0, 0, 0, 5.0, 0, 0, 0.0))
    recording = dataflash.read(newer)
    (delta,) = (m for m in recording if isinstance(m, OdometryDelta))
    imu = recording.stream("/imu")
    assert imu is not None
    assert [(t - imu.t_ns[0]) // 1000 for t in (delta.t0_ns, delta.t_ns)] == [150_000, 652_000]
    headings = 0.01 * np.arange(1, 11)  # a step is seen in the body at its end
    np.testing.assert_allclose(delta.dp_b, [0.1 * np.cos(headings).sum(), 0.1 * np.sin(headings).sum(), 0.0], atol=1e-6)
    np.testing.assert_allclose(so3.quat_log(np.array(delta.dq_wxyz)), [0.0, 0.0, 0.1], atol=1e-6)
    assert 'odometry_delta = ["/odometry_delta"]' in recording.settings.toml("dataflash", newer, ("/imu", "/odometry_delta"))


def test_flow_over_the_range_finder_turns_about_z_with_the_gyroscope(newer: Path) -> None:
    """2 m/s forward, 1 m/s to the right, 8 m above ground, rolling at 0.4 rad/s; the IMU turns at 0.3 rad/s; a row is missing."""
    seen = -1.0 / 8.0 + 0.4, 2.0 / 8.0
    times = [1_200_000 + 50_000 * k for k in range(12) if k != 5]
    flows = b"".join(row("OF", t, 200, *seen, 0.4, 0.0) for t in times)
    newer.write_bytes(newer.read_bytes() + b"".join(row("RFND", t, 0, 800, 4, 25) for t in times) + flows)
    recording = dataflash.read(newer)
    first, second = (m for m in recording if isinstance(m, OdometryDelta))
    assert [m.t_ns - m.t0_ns for m in (first, second)] == [200_000_000] * 2
    assert second.t0_ns - first.t_ns == 100_000_000
    turn = np.array([0.02, 0.0, 0.015])
    dp, R = np.zeros(3), np.eye(3)
    for _ in range(4):
        dp += R @ so3.matrix(so3.quat_exp(0.5 * turn)) @ np.array([0.1, 0.05, 0.0])
        R = R @ so3.matrix(so3.quat_exp(turn))
    np.testing.assert_allclose(first.dp_b, dp, atol=1e-5)
    np.testing.assert_allclose(so3.matrix(np.array(first.dq_wxyz)), R, atol=1e-5)
    assert first.topic == "/optical_flow"
    assert 'optical_flow = ["/optical_flow"]' in recording.settings.toml("dataflash", newer, ("/imu", "/optical_flow"))


def test_flow_without_a_range_is_left_out_and_a_note_counts_it(newer: Path) -> None:
    newer.write_bytes(newer.read_bytes() + b"".join(row("OF", 1_200_000 + 50_000 * k, 200, 0, 0.1, 0, 0) for k in range(6)))
    recording = dataflash.read(newer)
    assert not [m for m in recording if isinstance(m, OdometryDelta)]
    assert "5 of 5 messages of optical flow left out: no range to the ground at that time" in recording.notes


@pytest.mark.parametrize("both", [True, False])
def test_wheels_are_a_velocity_forward_in_the_middle_between_two_counts(newer: Path, both: bool) -> None:
    """Left 1.8, right 2.2 m/s, every 20 ms; a second wheel that is not there counts 0 at quality 0; 0.1 s are lost."""
    rows = [
        row("WENC", 1_200_000 + 20_000 * k, 0.036 * k, 0 if 12 <= k < 17 else 100, 0.044 * k * both, 100 * both)
        for k in range(30)
    ]
    newer.write_bytes(newer.read_bytes() + b"".join(rows))
    recording = dataflash.read(newer)
    got, imu = [m for m in recording if isinstance(m, Reading) and m.kind == "velocity_body"], recording.stream("/imu")
    assert imu is not None
    assert [(m.t_ns - imu.t_ns[0]) // 1000 for m in got] == [250_000, 350_000, 590_000, 690_000]
    assert [m.arrived_ns - m.t_ns for m in got] == [50_000_000] * 4
    np.testing.assert_allclose([m.values for m in got], [(2.0 if both else 1.8, 0.0, 0.0)] * 4, atol=1e-5)
    assert got[0].covariance is not None
    np.testing.assert_allclose(np.diag(got[0].covariance), [0.01, 1e6, 1e6])
    text = recording.settings.toml("dataflash", newer, ("/imu", "/velocity_body"))
    assert "across_sigma_m_s = 0.1" in text
    assert 'velocity_body = ["/velocity_body"]' in text


def test_the_receivers_own_accuracy_goes_before_dop(newer: Path) -> None:
    fixes = [m for m in dataflash.read(newer) if isinstance(m, GnssFix)]
    first, second = (next(m for m in fixes if m.topic == topic) for topic in ("/gnss", "/gnss2"))
    assert first.covariance_n is not None
    assert second.covariance_n is not None
    np.testing.assert_allclose(np.diag(first.covariance_n), [1.44, 1.44, 4.0])
    np.testing.assert_allclose(np.diag(second.covariance_n), np.array([0.5, 0.5, 2.25]) * 4.5**2)
    velocity = next(m for m in dataflash.read(newer) if isinstance(m, GnssVelocity))
    np.testing.assert_allclose(velocity.v_n, [0.0, 5.0, -0.5], atol=1e-12)
    assert velocity.covariance_n is not None
    np.testing.assert_allclose(velocity.covariance_n, 0.09 * np.eye(3))


def test_stamps_are_the_receivers_and_the_rest_of_the_delay_is_in_the_settings(newer: Path) -> None:
    """GIVEN arrivals 30, 0, 45 and 10 ms late THEN the stamps are regular, the fastest fix took no time, the median 20 ms."""
    recording = dataflash.read(newer)
    stream = recording.stream("/gnss")
    assert stream is not None
    assert np.diff(stream.t_ns).tolist() == [200_000_000] * 3
    assert ((stream.arrived_ns - stream.t_ns) // 1_000_000).tolist() == [30, 0, 45, 10]
    assert recording.settings.gnss_delay_s == pytest.approx(0.150 - 0.020)
    unix_s = 315964800 + 2200 * 604800 + 400_000.2 - 18
    assert stream.t_ns[1] == pytest.approx(unix_s * 1e9, abs=50e6)


def test_the_origin_is_the_logs_own(newer: Path) -> None:
    """The reference is 4 m north and 5 m east of it, and the fixes are not: so only what the fixes say can be right."""
    recording = dataflash.read(newer)
    assert recording.settings.origin is not None
    stream, truth = recording.stream("/gnss"), recording.stream("/truth")
    assert stream is not None
    assert truth is not None
    place = Origin(*recording.settings.origin).to_ned(*stream.columns[0][1].tolist())
    np.testing.assert_allclose(place, [4.0, 5.0, -6.0], atol=0.3)


def test_of_a_simulated_flight_the_truth_is_that_of_the_simulator(newer: Path) -> None:
    q = so3.from_euler(0.1, -0.2, 1.5)
    log = newer.read_bytes() + row("SIM", 1_500_000, 0, 0, 0, 488.0, 473977490, 85455900, *(2.0 * q))
    log += row("SIM2", 1_499_000, 1.0, 2.0, 3.0) + row("SIM2", 1_502_000, 4.0, 5.0, 6.0)
    log += row("SIM", 1_600_000, 0, 0, 0, 487.0, 473977400, 85455900, *q)
    newer.write_bytes(log)
    recording = dataflash.read(newer)
    first, second = (m for m in recording if isinstance(m, Truth))
    np.testing.assert_allclose(first.p_n, [1.0, 0.0, -1.0], atol=2e-3)  # 9e-6 degrees north of ORGN
    np.testing.assert_allclose(second.p_n, [0.0, 0.0, 0.0], atol=1e-6)
    assert (first.v_n, second.v_n) == ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    np.testing.assert_allclose(first.q_nb_wxyz, q, atol=1e-6)
    assert recording.reference == ""
    np.testing.assert_allclose(np.array(recording.settings.origin), [47.39774, 8.54559, 487.0])
    assert "/truth is the state of the simulator" in recording.notes
    (attitude,) = {m.q_nb_wxyz for m in recording if isinstance(m, AttitudePrior)}  # still the autopilot's own
    np.testing.assert_allclose(np.rad2deg(so3.to_euler(np.array(attitude))), [1.0, -2.0, 90.0], atol=1e-9)


def test_a_heading_of_magnetic_north_is_not_taken(newer: Path) -> None:
    """GIVEN an origin of the filter at 1.4 s THEN no attitude from before it: ArduPilot has no declination until then."""
    before = next(m.t_ns for m in dataflash.read(newer) if isinstance(m, AttitudePrior))
    data = newer.read_bytes()
    first = row("ORGN", 950_000, 0, 473977400, 85455900, 48700)
    assert data.count(first) == 1
    newer.write_bytes(data.replace(first, row("ORGN", 1_400_000, 0, 473977400, 85455900, 48700)))
    after = next(m.t_ns for m in dataflash.read(newer) if isinstance(m, AttitudePrior))
    assert after - before == 1_545_000_000 - 1_130_000_000


@pytest.mark.parametrize("dead", [False, True], ids=["not used", "reads zero"])
def test_the_heading_of_an_autopilot_without_compass_is_not_taken_and_named(newer: Path, dead: bool) -> None:
    rest = row("MAG", 1_000_000, 0, 0, 0, 0) if dead else row("PARM", 900_000, b"COMPASS_USE", 0.0, 1.0)
    newer.write_bytes(newer.read_bytes() + rest)
    recording = dataflash.read(newer)
    assert not any(isinstance(m, AttitudePrior) for m in recording)
    assert any("the heading may be anything" in note for note in recording.notes)


def test_a_log_without_gnss_has_no_date(tmp_path: Path) -> None:
    path = tmp_path / "indoors.bin"
    path.write_bytes(header() + imu_rows(100))
    recording = dataflash.read(path)
    assert next(iter(recording)).t_ns == EPOCH_NS + 1_000_000_000
    assert any("does not know the date" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "the file is empty"),
        (b"ULog\x01\x12\x35", "not an ArduPilot dataflash log"),
        (b"\xa3\x95", "no IMU messages called IMU in it"),
        (header(), "no IMU messages called IMU in it"),
        (header() + imu_rows(3).replace(struct.pack("<f", -9.75), struct.pack("<f", -0.99)), "that is g"),
    ],
)
def test_what_is_no_dataflash_log_is_reported_in_one_line(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(content)
    with pytest.raises(LogError) as raised:
        dataflash.read(path)
    assert str(raised.value).startswith("log.bin: ")
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_options_that_mean_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="--world means nothing for dataflash logs"):
        dataflash.read(tmp_path, ImportOptions(world="enu"))
    with pytest.raises(LogError, match=r"gone\.bin: No such file"):
        dataflash.read(tmp_path / "gone.bin")
