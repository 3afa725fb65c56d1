"""Keys that are tuned: their scale, their bounds, and how they are written into a file that somebody wrote by hand."""

import math

import msgspec
import pytest

from estimator.config import Config, ConfigError, parse
from estimator.tools.tune.keys import KEYS, bounds, chosen, from_search, to_search, value_of, written

BY_HAND = """\
# my vehicle
[imu]
axes = "flu"
gyro_noise=0.002   # from the data sheet
# accel_noise = 0.1
[pose_fix]  # mocap
tilt_deg = 0.0

[inputs]
imu = ["/imu"]
"""


@pytest.mark.parametrize("name", sorted(KEYS))
def test_every_key_is_one_of_the_configuration_and_its_default_lies_inside_the_bounds(name: str) -> None:
    key, config = KEYS[name], Config()
    default = value_of(config, key)
    assert key.low < default < key.high
    low, high = bounds(key)
    assert low < to_search(key, default) < high
    for value in (key.low, default, key.high):
        assert from_search(key, to_search(key, value)) == pytest.approx(value, rel=6e-3, abs=0.0)
        section, _, field = name.partition(".")
        changed = msgspec.structs.replace(getattr(config, section), **{field: value})
        parse(written("", {name: value}))
        assert getattr(changed, field) == value
    assert from_search(key, high + 1.0) in {key.low, key.high}


def test_noise_is_searched_by_its_logarithm() -> None:
    assert to_search(KEYS["imu.gyro_noise"], 1e-3) == pytest.approx(-3.0)
    assert from_search(KEYS["imu.gyro_noise"], math.log10(0.00123456)) == 0.00123


def test_what_is_turned_is_what_the_log_can_tell() -> None:
    names = [key.name for key in chosen({"pose_fix"})]
    assert names == ["imu.gyro_noise", "imu.accel_noise", "imu.gyro_walk", "imu.accel_walk", "pose_fix.noise_scale"]
    assert "gnss.slow_sigma_m" in {key.name for key in chosen({"gnss"}, truth=True)}
    assert not any("gnss" in key.name for key in chosen({"gnss"})), "a receiver does not tell its slow error"
    assert [key.name for key in chosen(set(), ["imu.accel_noise"])] == ["imu.accel_noise"]
    with pytest.raises(ConfigError, match=r"--vary imu.axes: cannot be tuned; there are imu.gyro_noise, "):
        chosen(set(), ["imu.axes"])


def test_a_file_keeps_all_but_the_tuned_numbers() -> None:
    values = {"imu.gyro_noise": 0.001, "imu.accel_noise": 0.05, "pose_fix.noise_scale": 1.5, "gnss.slow_sigma_m": 0.3}
    text = written(BY_HAND, values)
    config = parse(text)
    assert (config.imu.gyro_noise, config.imu.accel_noise) == (0.001, 0.05)
    assert (config.pose_fix.noise_scale, config.pose_fix.tilt_deg) == (1.5, 0.0)
    assert config.gnss.slow_sigma_m == 0.3
    assert config.inputs.imu == ("/imu",)
    kept = set(BY_HAND.splitlines()) - {"gyro_noise=0.002   # from the data sheet"}
    assert kept <= set(text.splitlines())
    assert "gyro_noise = 0.001  # from the data sheet\n# accel_noise = 0.1\naccel_noise = 0.05\n[pose_fix]" in text
    assert written(text, values) == text


def test_without_a_file_there_are_only_the_tuned_numbers() -> None:
    assert written("", {"imu.gyro_noise": 0.001}) == "[imu]\ngyro_noise = 0.001\n"
