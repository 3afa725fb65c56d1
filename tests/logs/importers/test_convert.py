"""What `landfix import` writes: a log that can be read back, and a configuration next to it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from estimator.config import parse
from logs import importers
from logs.importers import ImportOptions, convert, read
from logs.importers.settings import DATA_SETS, Settings, data_set
from logs.store.reader import LogError, LogReader
from logs.wire.codec import Decoder, ImuMounting, Topics
from models.imu import ImuNoise
from models.messages import GnssFix, GnssVelocity, ImuSample, PoseFix, Reading

IMU = "t_s,gx,gy,gz,ax,ay,az\n" + "".join(f"{k / 100},0.01,{k / 1000},0.03,0.1,0.2,-9.8\n" for k in range(3000))
GPS = "t_s,arrived_s,lat,lon,alt,vn,ve,vd,std_n_m,std_e_m,std_d_m\n" + "".join(
    f"{k},{k + 0.3},47.{k:03},8.5,500,1,2,3,1,2,3\n" for k in range(25)
)
TRUTH = "t_s,pn,pe,pd,vn,ve,vd,qw,qx,qy,qz\n" + "".join(f"{k},{k},2,3,1,0,0,1,0,0,0\n" for k in range(20))
VISION = "t_s,px,py,pz,qw,qx,qy,qz\n0.5,1,2,3,1,0,0,0\n0.6,1,2,3,1,0,0,0\n0.8,1,2,3,1,0,0,0\n"


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    folder = tmp_path / "flight"
    folder.mkdir()
    for name, text in (("imu", IMU), ("gps", GPS), ("truth", TRUTH), ("vision", VISION), ("baro", "t_s,pressure_pa\n1,95000\n")):
        (folder / f"{name}.csv").write_text(text)
    return folder


def test_every_message_comes_back_from_the_log_as_it_was_imported(flight: Path, tmp_path: Path) -> None:
    options = ImportOptions(pose_fix_hz=5.0)
    summary = convert("csv", flight, tmp_path / "out.mcap", options=options)
    decoder = Decoder(Topics(baro=("/baro",)), ImuMounting())
    expected = list(read("csv", flight, options))
    with LogReader(tmp_path / "out.mcap") as log:
        records = list(log)
        assert not log.torn
        assert log.metadata["landfix"]["import_kind"] == "csv"
    assert len(records) == len(expected) == sum(summary.messages.values())
    assert [r.log_time_ns for r in records] == [m.arrived_ns for m in expected]
    assert [r.topic for r in records] == [m.topic for m in expected]
    for record, message in zip(records, expected, strict=True):
        if record.topic == "/truth":
            assert record.schema == "nav_msgs/msg/Odometry"
            continue
        got = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
        assert type(got) is type(message)
        assert got is not None
        assert got.t_ns == message.t_ns
        match got, message:
            case ImuSample(), ImuSample():
                assert (got.gyro_b, got.accel_b) == (message.gyro_b, message.accel_b)
            case GnssFix(), GnssFix():
                assert (got.lat_deg, got.lon_deg, got.alt_m, got.status) == (message.lat_deg, message.lon_deg, message.alt_m, 0)
                assert got.covariance_n is not None
                np.testing.assert_array_equal(got.covariance_n, np.diag([1.0, 4.0, 9.0]))
            case GnssVelocity(), GnssVelocity():
                assert got.v_n == (1.0, 2.0, 3.0)
            case PoseFix(), PoseFix():
                np.testing.assert_allclose(got.p_n, (2.0, 1.0, -3.0))
            case Reading(), Reading():
                assert got.values == (95000.0,)
    assert summary.messages == {"/imu": 3000, "/truth": 20, "/gnss": 25, "/gnss/velocity": 25, "/baro": 1, "/pose_fix": 2}
    assert summary.seconds == pytest.approx(29.99)
    assert str(summary).startswith("30.0 s: /imu 3000, ")


def test_the_configuration_beside_it(flight: Path, tmp_path: Path) -> None:
    summary = convert("csv", flight, tmp_path / "out.mcap", options=ImportOptions(pose_fix_hz=5.0))
    assert summary.config == str(tmp_path / "out.toml")
    config = tomllib.loads(Path(summary.config).read_text())
    assert config["imu"] == {
        "axes": "flu",
        "gyro_noise": 5e-3,
        "accel_noise": 0.3,
        "gyro_walk": 1e-4,
        "accel_walk": 5e-3,
        "gyro_scale": 1e-3,
    }
    assert config["inputs"] == {
        "imu": ["/imu"],
        "gnss": ["/gnss"],
        "gnss_velocity": ["/gnss/velocity"],
        "pose_fix": ["/pose_fix"],
        "baro": ["/baro"],
    }
    assert config["gnss"] == {"delay_s": 0.0, "antenna_b_m": [0.0, 0.0, 0.0]}
    assert len(config["map"]["origin"]) == 3


def test_the_same_log_gives_the_same_bytes(flight: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        convert("csv", flight, tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert (tmp_path / "a.toml").read_text() == (tmp_path / "b.toml").read_text()


def test_progress_goes_up_to_one(flight: Path, tmp_path: Path) -> None:
    fractions: list[float] = []
    convert("csv", flight, tmp_path / "out.mcap", fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.5
    assert fractions[-1] == 1.0


def test_all_of_settings_reaches_the_text() -> None:
    noise = ImuNoise(1.5e-3, 0.25, 3e-5, 4e-3)
    settings = Settings(
        noise, "a guess", 0.21, (0.1, -0.2, 0.3), {"slow_sigma_m": 0.02}, (47.3977412345, -8.5455, 488.25), "above the ellipsoid"
    )
    text = settings.toml("csv", Path("/somewhere/flight"), ("/imu", "/gnss", "/gnss2", "/gnss/velocity", "/baro", "/truth"))
    config = tomllib.loads(text)
    assert config == {
        "imu": {
            "axes": "flu",
            "gyro_noise": 1.5e-3,
            "accel_noise": 0.25,
            "gyro_walk": 3e-5,
            "accel_walk": 4e-3,
            "gyro_scale": 1e-3,
        },
        "inputs": {"imu": ["/imu"], "gnss": ["/gnss", "/gnss2"], "gnss_velocity": ["/gnss/velocity"], "baro": ["/baro"]},
        "gnss": {"delay_s": 0.21, "antenna_b_m": [0.1, -0.2, 0.3], "slow_sigma_m": 0.02},
        "map": {"origin": [47.3977412345, -8.5455, 488.25]},
    }
    assert "a guess" in text
    assert "above the ellipsoid" in text
    assert "/somewhere" not in text


@pytest.mark.parametrize("name", list(DATA_SETS))
def test_the_estimator_takes_the_configuration_of_every_data_set(name: str) -> None:
    known = DATA_SETS[name]
    settings = Settings(
        known.noise, known.noise_reason, known.gnss_delay_s, known.antenna_b_m, known.receiver, (47.0, 8.0, 500.0), known.altitude
    )
    config = parse(settings.toml("csv", Path(name), ("/imu", "/gnss", "/gnss/velocity", "/pose_fix", "/baro", "/truth")))
    assert config.imu.axes == "flu"
    assert config.imu.accel_noise == known.noise.accel_noise
    assert config.gnss.delay_s == known.gnss_delay_s
    assert config.map.origin == (47.0, 8.0, 500.0)
    assert config.inputs.gnss == ("/gnss",)
    assert {key: getattr(config.gnss, key) for key in known.receiver} == known.receiver


def test_data_sets_are_known_by_name(tmp_path: Path) -> None:
    assert data_set(tmp_path / "euroc" / "V1_01_easy").axes == "urf"
    assert data_set(tmp_path / "mine") == data_set(tmp_path)
    assert DATA_SETS["quad_rtk_dot"].noise == ImuNoise(2e-3, 0.3, 1e-4, 5e-3)


@pytest.mark.parametrize("kind", list(importers.KINDS))
def test_every_kind_reports_in_one_line_that_nothing_is_there(kind: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file or folder"):
        convert(kind, tmp_path / "gone", tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("kind", list(importers.KINDS))
def test_every_kind_refuses_what_is_of_another_kind(kind: str, tmp_path: Path) -> None:
    source = tmp_path / ("source" if kind in {"csv", "euroc"} else "source.txt")
    source.mkdir() if kind in {"csv", "euroc"} else source.write_text("hello")
    with pytest.raises(LogError) as raised:
        convert(kind, source, tmp_path / "out.mcap")
    assert "\n" not in str(raised.value)
    assert "source" in str(raised.value)
    assert not (tmp_path / "out.mcap").exists()


def test_unknown_kinds_and_overwriting_the_source_are_refused(flight: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no importer called blackbox; there are csv, euroc, ulog, dataflash, tlog"):
        convert("blackbox", flight, tmp_path / "out.mcap")
    log = tmp_path / "flight.bin"
    log.write_bytes(b"\xa3\x95")
    with pytest.raises(LogError, match="would overwrite the input"):
        convert("dataflash", log, log)
    assert log.read_bytes() == b"\xa3\x95"
    with pytest.raises(LogError, match="cannot be written"):
        convert("csv", flight, tmp_path / "no" / "such" / "out.mcap")
