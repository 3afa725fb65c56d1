import re
from pathlib import Path

import pytest

from estimator import strict_toml
from estimator.config import Config, ConfigError, load, parse, recorded
from logs.store.reader import Attachment
from logs.store.recorder import CONFIG_ATTACHMENT
from logs.wire.codec import ImuMounting, encode_input
from models.imu import ImuNoise
from models.messages import ImuSample

TASK = """
[imu]
axes = "frd"
gyro_noise = 0.0007
accel_noise = 0.04
gyro_walk = 0.0001
accel_walk = 0.001

[inputs]
imu = "/sensors/imu"
pose_fix = ["/pose_fix", "/position_fix"]

[gnss]
delay_s = 0.1
antenna_b_m = [0.1, 0, -0.2]

[map]
origin = [47.4, 8.5, 488]
"""


def test_without_a_file_everything_has_its_default() -> None:
    config = load(None)
    assert config == Config()
    assert config.inputs.imu == ("/imu",)
    assert config.fusion().origin is None


def test_a_section_given_in_part_keeps_its_own_defaults() -> None:
    given = parse("[landmark_fix]\nnoise_scale = 2.0\n").landmark_fix
    assert given.noise_scale == 2.0
    assert given.tilt_deg == Config().landmark_fix.tilt_deg == 0.0
    assert Config().pose_fix.tilt_deg > 0.0


def test_the_sections_reach_the_parts_they_configure(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.toml"
    file.write_text(TASK)
    config = load(file)
    fusion = config.fusion()
    noise: ImuNoise = fusion.imu
    assert (noise.gyro_noise, noise.accel_noise, noise.gyro_walk, noise.accel_walk) == (0.0007, 0.04, 0.0001, 0.001)
    assert fusion.gnss.delay_s == 0.1
    assert fusion.gnss.antenna_b_m == (0.1, 0.0, -0.2)
    assert fusion.origin == (47.4, 8.5, 488.0)
    assert config.inputs.imu == ("/sensors/imu",)
    assert config.inputs.pose_fix == ("/pose_fix", "/position_fix")


def test_axes_and_mounting_reach_the_decoder() -> None:
    sample = ImuSample(10**9, 10**9, (0.1, 0.2, 0.3), (1.0, 2.0, -9.0))
    topic, schema, data = encode_input(sample, ImuMounting("frd", 0.0, 0.0, 90.0))
    decoder = parse('[imu]\naxes = "frd"\nmounting_rpy_deg = [0, 0, 90]\n').decoder()
    decoded = decoder.decode(topic, schema, data, sample.arrived_ns)
    assert isinstance(decoded, ImuSample)
    assert decoded.gyro_b == pytest.approx(sample.gyro_b)
    assert decoded.accel_b == pytest.approx(sample.accel_b)


def test_a_log_of_an_older_version_is_read_without_the_keys_that_were_removed() -> None:
    older = TASK + "[imus]\nsilent_s = 1\n[visual_odometry]\ntimeout_s = 3.0\n"
    assert recorded([attached(older)], "a.mcap") == parse(TASK)
    assert recorded([], "a.mcap") == Config()
    with pytest.raises(ConfigError, match=r"a.mcap, config.toml: unknown key 'interval' in \[visual_odometry\]"):
        recorded([attached("[visual_odometry]\ninterval = 3\n")], "a.mcap")


def attached(text: str) -> Attachment:
    return Attachment(CONFIG_ATTACHMENT, "application/toml", text.encode())


def test_everything_survives_writing_and_reading() -> None:
    config = parse(TASK)
    assert parse(config.toml()) == config
    assert parse(config.toml()).toml() == config.toml()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[imu]\naxis = "flu"\n', "v.toml: unknown key 'axis' in [imu]; did you mean 'axes'?"),
        (
            "[imus]\nsilent_s = 1\n",
            "v.toml: section [imus] was removed: leave it out: it is a constant of estimator/sources/imu/choice.py",
        ),
        (
            "[rest]\ngyro = 1\n",
            "v.toml: key 'gyro' in [rest] was removed: leave it out: it is a constant of estimator/sources/rest.py",
        ),
        (
            "[visual_odometry]\ntimeout_s = 3\n",
            "v.toml: key 'timeout_s' in [visual_odometry] was removed: leave it out: [vision] timeout_s holds for odometry too",
        ),
        ("[imu]\ngyro = 1\n", "v.toml: unknown key 'gyro' in [imu]; did you mean 'gyro_walk'?"),
        ("[innputs]\n", "v.toml: unknown section [innputs]; did you mean 'inputs'? sections: gnss, pose_fix, landmark_fix, "),
        ('[imu]\naxes = "ned"\n', 'v.toml: imu.axes = "ned": must be one of '),
        ("[imu]\ngyro_noise = -1\n", "v.toml: imu.gyro_noise = -1: expected float >= 1e-09"),
        ("[imu]\ngyro_noise = nan\n", "v.toml: imu.gyro_noise = nan: must be a finite number"),
        ("[map]\norigin = [91, 8, 0]\n", "v.toml: map.origin[0] = 91: expected float <= 90.0"),
        ('[inputs]\nimu = "/a"\ngnss = "/a"\n', "v.toml: [inputs]: topic /a cannot feed two inputs"),
        ("[output]\nrate_hz = '50'\n", 'v.toml: output.rate_hz = "50": expected float, got str'),
        ('[bounds]\nvehicle = "fixed_wing"\n[drag]\nenabled = true\n', "v.toml: [drag] enabled: rotors have this drag, and "),
        ('[bounds]\nvehicle = "boat"\n[rest]\nenabled = true\n', "v.toml: [rest] enabled: it is for what stands on the ground"),
        (
            '[bounds]\nvehicle = "multirotor"\n[initialise]\ncourse_sigma_deg = 5\n',
            'v.toml: [initialise] course_sigma_deg: a vehicle of [bounds] vehicle "multirotor" flies sideways',
        ),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(text: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load(file)
    line = str(caught.value).replace(str(tmp_path) + "/", "")
    assert line.startswith(expected)
    assert "\n" not in line


@pytest.mark.parametrize("vehicle", ["any", "multirotor"])
def test_drag_and_rest_are_for_a_multirotor_and_for_any_vehicle(vehicle: str) -> None:
    config = parse(f'[bounds]\nvehicle = "{vehicle}"\n[drag]\nenabled = true\n[rest]\nenabled = true\n')
    assert config.drag.enabled
    assert config.rest.enabled


def test_a_file_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.toml: cannot be read \(no such file or directory\)"):
        load(tmp_path / "nowhere.toml")
    binary = tmp_path / "b.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not a text file"):
        load(binary)


def test_every_key_has_a_meaning_and_every_number_a_default() -> None:
    keys = strict_toml.keys(Config)
    assert {k.section.partition(".")[0] for k in keys} == set(Config.__struct_fields__)
    assert [f"{k.section}.{k.name}" for k in keys if not k.meaning] == []
    without = {f"{k.section}.{k.name}" for k in keys if k.default == "-" and k.section != "zenoh.security"}
    of_the_image = {"map.picture", "map.picture_heights", "map.picture_height_m"}
    of_the_vehicle = {"bounds.speed_m_s", "bounds.lowest_m", "bounds.highest_m"}
    of_the_place = {"map.origin", "visual_odometry.ground_m", "range.ground_m", "magnetometer.declination_deg"}
    limits = {"integrity.hal_m", "integrity.val_m"}
    assert without == {"map.landmarks", "rig.file"} | of_the_place | of_the_image | of_the_vehicle | limits


def test_every_physical_number_has_a_unit() -> None:
    without = {f"{k.section}.{k.name}" for k in strict_toml.keys(Config) if not k.unit and k.default[0] in "-0123456789"}
    suffixed = {k for k in without if k.endswith(("_s", "_m", "_deg", "_hz", "_noise", "_walk"))}
    assert suffixed == set()


@pytest.mark.parametrize(
    ("topic", "what"),
    [
        ("/landfix/odometry", "is an output of landfix"),
        ("landfix/global", "is an output of landfix"),
        ("/tf", "is an output of landfix"),
        ("/**", "names more than one topic"),
        ("/a/*/imu", "names more than one topic"),
    ],
)
def test_an_input_is_one_topic_and_not_an_own_output(topic: str, what: str) -> None:
    for key in ("imu", "gnss", "odometry", "left_image"):
        with pytest.raises(ConfigError, match=re.escape(f"[inputs] {key}: {topic} {what}")):
            parse(f'[inputs]\n{key} = "{topic}"\n')
    parse('[inputs]\npose_fix = ["/tf_fix", "/mine/landfix/fix"]\n')


def test_a_boat_is_not_landed(tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    for vehicle, topics in (("multirotor", ("/landed",)), ("boat", ())):
        file.write_text(f'[bounds]\nvehicle = "{vehicle}"\n')
        assert load(file).inputs.rest == topics
