import numpy as np
import pytest
from numpy.typing import NDArray

from calib.errors import CalibrationError
from calib.inertial import imu, imu_report
from calib.inertial.allan import allan_deviation, noise
from calib.report.verdict import Grade
from models.frames import GRAVITY
from models.messages import Array

RATE = 100.0
SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0.6, 0.5]], dtype=float)


def times(seconds: float) -> NDArray[np.int64]:
    return np.rint(1e9 * np.arange(0.0, seconds, 1.0 / RATE)).astype(np.int64)


def at_rest(seconds: float, seed: int = 0) -> tuple[NDArray[np.int64], Array, Array]:
    rng, t = np.random.default_rng(seed), times(seconds)
    gyro = rng.normal(0.01, 2e-4 * np.sqrt(RATE), (len(t), 3))
    accel = rng.normal(0.0, 2e-3 * np.sqrt(RATE), (len(t), 3)) - np.array([0.0, 0.0, GRAVITY])
    return t, gyro, accel


def shaken(seconds: float, seed: int = 1) -> tuple[Array, Array]:
    rng, n = np.random.default_rng(seed), int(seconds * RATE)
    return rng.normal(0.0, 1.0, (n, 3)), rng.normal(0.0, 3.0, (n, 3)) - np.array([0.0, 0.0, GRAVITY])


def on_all_sides(sides: Array = SIDES) -> tuple[NDArray[np.int64], Array, Array, Array, Array]:
    """Five seconds on each side, shaken between; accelerometer with bias and scale."""
    bias, scale, rng = np.array([0.2, -0.1, 0.3]), np.array([1.01, 0.99, 1.005]), np.random.default_rng(2)
    gyro, accel = [], []
    for d in sides:
        g, f = shaken(1.5)
        gyro += [g, rng.normal(0.0, 1e-3, (500, 3))]
        accel += [f, GRAVITY * d / np.linalg.norm(d) * scale + bias + rng.normal(0.0, 0.02, (500, 3))]
    return times(6.5 * len(sides)), np.vstack(gyro), np.vstack(accel), bias, scale


def test_allan_deviation_of_white_noise_falls_with_the_root_of_time() -> None:
    tau, adev = allan_deviation(np.random.default_rng(0).normal(0.0, 0.3, 200_000), 100.0)
    np.testing.assert_allclose(adev[:12], 0.03 / np.sqrt(tau[:12]), rtol=0.1)


def test_allan_deviation_is_its_definition() -> None:
    x = np.random.default_rng(1).normal(size=400)
    _, adev = allan_deviation(x, 10.0)
    means = np.array([x[k : k + 4].mean() for k in range(397)])
    differences = means[4:] - means[:-4]
    assert adev[2] == pytest.approx(np.sqrt(0.5 * np.mean(differences**2)), rel=1e-12)


def test_density_and_walk_come_back_within_their_sigma() -> None:
    z = []
    for seed in range(8):
        rng, n = np.random.default_rng(seed), 60_000
        walk = np.cumsum(rng.normal(0.0, 1e-4 / np.sqrt(RATE), n))
        found = noise(rng.normal(0.0, 2e-3 * np.sqrt(RATE), n) + walk, RATE)
        assert found.density == pytest.approx(2e-3, rel=0.02)
        z.append((found.walk - 1e-4) / found.walk_sigma)
        np.testing.assert_allclose(found.model(found.tau_s[:6]), found.adev[:6], rtol=0.1)
    assert np.abs(np.mean(z)) < 1.5
    assert np.sqrt(np.mean(np.square(z))) < 2.5


def test_smoothed_samples_do_not_make_the_noise_smaller() -> None:
    """An autopilot logs what its low pass leaves: white only at times longer than that."""
    x = np.convolve(np.random.default_rng(4).normal(0.0, 2e-3 * np.sqrt(RATE), 6000), np.full(4, 0.25), "same")
    found = noise(x, RATE)
    assert 0.03 < found.white_from_s < 0.2
    assert found.density == pytest.approx(2e-3, rel=0.1)  # taken for white from the first sample on it is a third less
    assert found.density_sigma < 1.2e-4
    assert noise(np.random.default_rng(4).normal(0.0, 1.0, 6000), RATE).white_from_s <= 0.02


def test_stamps_of_the_epoch_and_stamps_that_jitter_do_not_smooth_the_noise() -> None:
    """Interpolated on an even clock, white noise loses a fifth of itself at the shortest times, and is no longer white there."""
    t, gyro, accel = at_rest(60.0)
    jitter = np.random.default_rng(1).integers(-2_000_000, 2_000_000, len(t))
    epoch = t + 1_700_000_000_000_000_123
    assert imu.static_noise(epoch, gyro, accel).white_from_s <= 0.02
    for stamps in (epoch, epoch + jitter):
        found = imu.static_noise(stamps, gyro, accel)
        for n, level in ((found.gyro[0], 2e-4), (found.accel[1], 2e-3)):
            assert n.adev[0] == pytest.approx(level * np.sqrt(RATE), rel=0.04)


def test_a_hum_is_not_taken_for_noise() -> None:
    rng, t = np.random.default_rng(5), np.arange(0.0, 60.0, 1.0 / RATE)
    white = rng.normal(0.0, 2e-3 * np.sqrt(RATE), len(t))
    short = noise(white + 0.02 * np.sin(2.0 * np.pi * 23.0 * t), RATE)
    assert short.white_from_s > 0.03
    assert short.density == pytest.approx(2e-3, rel=0.15)
    always = noise(white[:400] + 0.5 * np.sin(2.0 * np.pi * 3.3 * t[:400]), RATE)
    assert np.isnan(always.white_from_s)
    assert not always.walk_seen
    assert always.density == pytest.approx(always.adev[-1] * np.sqrt(always.tau_s[-1]))


def test_a_short_rest_gives_the_density_and_reports_what_it_cannot() -> None:
    t, gyro, accel = at_rest(3.0)
    static = imu.static_noise(t, gyro, accel)
    config = static.config()
    assert config["gyro_noise"] == pytest.approx(2e-4, rel=0.2)
    assert set(config) == {"gyro_noise", "accel_noise"}
    assert static.longest_tau_s == pytest.approx(0.32)
    judged = imu_report.of_static(static)
    assert judged.grade is Grade.REDO
    assert "longer" in judged.text
    rest, table, *_ = imu_report.static_tables(static)
    assert ("noise known up to", "0.32 s of averaging; what is slower was not seen") in rest[2]
    assert all(row[-1].startswith("<") for row in table[2])


def test_noise_of_the_longest_rest_between_motion() -> None:
    t, gyro, accel = at_rest(120.0)
    gyro[:2000], accel[:2000] = shaken(20.0)
    gyro[9000:9500], accel[9000:9500] = shaken(5.0)
    static = imu.static_noise(t, gyro, accel)
    assert 68.0 < static.duration_s < 71.0
    config = static.config()
    assert config["gyro_noise"] == pytest.approx(2e-4, rel=0.1)
    assert config["accel_noise"] == pytest.approx(2e-3, rel=0.1)
    np.testing.assert_allclose(static.gyro_mean, 0.01, atol=1e-3)
    assert imu_report.of_static(static).grade is Grade.USABLE
    assert "longer" in imu_report.of_static(static).text
    assert len(imu_report.static_tables(static)) == 3


def test_lost_samples_do_not_make_the_noise_another() -> None:
    t, gyro, accel = at_rest(60.0)
    kept = np.random.default_rng(3).random(len(t)) > 0.01
    static = imu.static_noise(t[kept], gyro[kept], accel[kept])
    assert static.config()["gyro_noise"] == pytest.approx(2e-4, rel=0.1)


def test_scale_and_bias_from_six_positions() -> None:
    t, gyro, accel, bias, scale = on_all_sides()
    found = imu.six_position(t, gyro, accel)
    assert len(found.positions) == 7
    error = np.concatenate((bias - found.bias, scale - found.scale))
    assert np.abs(error / np.sqrt(np.diagonal(found.covariance))).max() < 4.0
    assert np.abs(error[:3]).max() < 0.005
    assert found.residual < 0.01
    assert "7 positions" in imu_report.six_table(found)[0]


def test_a_side_that_is_missing_is_named() -> None:
    t, gyro, accel, _, _ = on_all_sides(SIDES[[0, 1, 2, 4, 5, 6]])
    with pytest.raises(CalibrationError, match="missing: axis y down"):
        imu.six_position(t, gyro, accel)


def test_recordings_that_cannot_be_used_say_why() -> None:
    t, gyro, accel = at_rest(60.0)
    moving = shaken(60.0)
    for bad, expected in (
        ((t, *moving), "rests for 0 s at most: let it lie still"),
        ((t[:50], gyro[:50], accel[:50]), "50 IMU samples"),
        ((t, gyro, accel / GRAVITY), "reads 1.00 in the median"),
        ((t[::-1].copy(), gyro, accel), "do not increase"),
        ((t, np.where(np.arange(len(t))[:, None] == 7, np.nan, gyro), accel), "finite"),
        ((t[:150], gyro[:150], accel[:150]), "rests for 0 s"),
    ):
        with pytest.raises(CalibrationError, match=expected):
            imu.static_noise(*bad)
    tilted = np.linspace(0.0, 0.6, len(t))[:, None] * [1.0, 0.0, 0.0]  # slowly, with nothing else
    drift = tilted + np.random.default_rng(0).normal(0.0, 1e-6, (len(t), 3)) - [0.0, 0.0, GRAVITY]
    with pytest.raises(CalibrationError, match="motion, not noise"):
        imu.static_noise(t, gyro, drift)
    with pytest.raises(CalibrationError, match="always reads the same"):
        imu.static_noise(t, gyro, accel * [1.0, 1.0, 0.0] - [0.0, 0.0, GRAVITY])
    with pytest.raises(CalibrationError, match="too few"):
        noise(gyro[:100, 0], RATE)


def test_a_slow_even_turn_is_no_rest() -> None:
    t, gyro, accel = at_rest(40.0)
    angle = np.linspace(0.0, 2.0, len(t))
    turned = np.column_stack((GRAVITY * np.sin(angle), np.zeros(len(t)), -GRAVITY * np.cos(angle)))
    assert imu.rests(t, gyro, accel - accel.mean(axis=0) + turned) == []
