import math

import numpy as np
import pytest

from models.frames import GRAVITY, Origin
from models.messages import Array
from models.sim.sensors import GRADES, Imu, ImuRecord, feel, gravity_n, measure
from models.sim.trajectory import FixedWing, Motion, Multirotor, build
from tests.models.sim.strapdown import integrate, local_gravity

ORIGIN = Origin(47.4, 8.5, 450.0)
DT = 0.005


def at_rest(n: int) -> Motion:
    zero = np.zeros((n, 3))
    return Motion(zero, zero, zero, np.tile(np.eye(3), (n, 1, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), zero)


def record(imu: Imu, n: int = 40_000, seed: int = 5) -> ImuRecord:
    return measure(imu, at_rest(n), None, DT, np.random.default_rng(seed))


def mean_square_is(x: Array, variance: float) -> None:
    """Two-sided: the sum of squares of n normal numbers is within 4.5 standard deviations of n variance."""
    assert np.mean(np.square(x)) / variance == pytest.approx(1.0, abs=4.5 * math.sqrt(2.0 / x.size))


@pytest.mark.parametrize("vehicle", [Multirotor(), FixedWing()])
@pytest.mark.parametrize("origin", [None, ORIGIN, Origin(-33.9, 151.2, 20.0)])
def test_perfect_samples_integrate_back_to_the_motion(vehicle: Multirotor | FixedWing, origin: Origin | None) -> None:
    motion = build(vehicle, 60.0, np.random.default_rng(8)).at(np.linspace(0.0, 60.0, 12_001))
    gyro_b, accel_b = feel(motion, origin)
    p_n, v_n, R_nb = integrate((motion.p_n[0], motion.v_n[0], motion.R_nb[0]), gyro_b, accel_b, DT, origin)
    assert np.linalg.norm(p_n - motion.p_n[-1]) < 0.01
    assert np.linalg.norm(v_n - motion.v_n[-1]) < 1e-3
    assert np.abs(R_nb - motion.R_nb[-1]).max() < 1e-6


def test_earth_rate_is_felt_at_rest_and_gravity_points_up() -> None:
    gyro_b, accel_b = feel(at_rest(1), ORIGIN)
    np.testing.assert_allclose(gyro_b[0], ORIGIN.earth_rate_n)
    np.testing.assert_allclose(accel_b[0], [0.0, 0.0, -ORIGIN.gravity], atol=1e-9)
    gyro_b, accel_b = feel(at_rest(1), None)
    np.testing.assert_array_equal(gyro_b[0], 0.0)
    np.testing.assert_array_equal(accel_b[0], [0.0, 0.0, -GRAVITY])


def test_gravity_leans_towards_the_centre_and_falls_off_upwards() -> None:
    near = local_gravity(ORIGIN)
    for p_n in ([0.0, 0.0, 0.0], [3000.0, 0.0, 0.0], [0.0, -3000.0, 0.0], [0.0, 0.0, -2000.0], [-800.0, 900.0, -300.0]):
        np.testing.assert_allclose(gravity_n(np.array([p_n]), ORIGIN)[0], near(np.array(p_n)), atol=4e-6)
    np.testing.assert_array_equal(gravity_n(np.array([[5.0, 6.0, 7.0]]), None), [[0.0, 0.0, GRAVITY]])


def test_grades_are_the_data_sheets_numbers_in_si() -> None:
    noise = GRADES["flight_controller"].noise
    assert noise.gyro_noise == pytest.approx(0.17 * math.pi / 180 / 60)  # deg/sqrt(h)
    assert noise.accel_noise == pytest.approx(0.10 / 60)  # m/s/sqrt(h)
    # In 100 s the bias wanders by the bias instability: 6 deg/h, 0.06 mg.
    assert noise.gyro_walk * math.sqrt(100.0) == pytest.approx(math.radians(6.0) / 3600)
    assert noise.accel_walk * math.sqrt(100.0) == pytest.approx(0.06e-3 * 9.80665)
    order = [GRADES[name].noise.gyro_walk for name in ("hobby", "industrial", "flight_controller", "tactical")]
    assert order == sorted(order, reverse=True)


@pytest.mark.parametrize("grade", ["hobby", "flight_controller", "industrial", "tactical"])
def test_white_noise_has_the_density_at_every_averaging_time(grade: str) -> None:
    # GIVEN an IMU at rest, its bias known
    r, noise = record(Imu(grade=grade)), GRADES[grade].noise  # type: ignore[arg-type]
    # WHEN the noise is averaged over tau  THEN its Allan deviation is density / sqrt(tau)
    for y, x, bias, density in (
        (r.gyro_b, r.true_gyro_b, r.gyro_bias, noise.gyro_noise),
        (r.accel_b, r.true_accel_b, r.accel_bias, noise.accel_noise),
    ):
        white = y - x - bias
        mean_square_is(white, density**2 / DT)
        for m in (1, 10, 100):
            means = white[: len(white) // m * m].reshape(-1, m, 3).mean(axis=1)
            pairs = (means[1::2] - means[: len(means) // 2 * 2 : 2]) / math.sqrt(2.0)  # no overlap: independent
            mean_square_is(pairs, density**2 / (m * DT))


def test_bias_walks_with_the_filters_density() -> None:
    r, noise = record(Imu(grade="hobby")), GRADES["hobby"].noise
    for bias, walk in ((r.gyro_bias, noise.gyro_walk), (r.accel_bias, noise.accel_walk)):
        mean_square_is(np.diff(bias, axis=0), walk**2 * DT)
        mean_square_is(bias[200::200] - bias[:-200:200], walk**2 * 200 * DT)  # increments are independent


def test_turn_on_bias_is_drawn_for_every_run() -> None:
    grade = GRADES["flight_controller"]
    runs = [record(Imu(), n=2, seed=seed) for seed in range(300)]
    mean_square_is(np.array([r.gyro_bias[0] for r in runs]), grade.gyro_turn_on**2)
    mean_square_is(np.array([r.accel_bias[0] for r in runs]), grade.accel_turn_on**2)
    np.testing.assert_array_equal(record(Imu(turn_on=0.0), n=2).gyro_bias[0], 0.0)


def test_noise_multiplier_multiplies_the_white_noise_only() -> None:
    plain, loud = record(Imu(), n=1000), record(Imu(noise_multiplier=2.0), n=1000)
    np.testing.assert_array_equal(plain.gyro_bias, loud.gyro_bias)
    np.testing.assert_allclose(loud.gyro_b - loud.gyro_bias, 2.0 * (plain.gyro_b - plain.gyro_bias), atol=1e-15)


def test_scale_and_misalignment_distort_what_is_felt() -> None:
    silent = {"noise_multiplier": 0.0, "turn_on": 0.0}
    scaled = [record(Imu(**silent, scale_sigma=0.01), n=2, seed=s) for s in range(300)]  # type: ignore[arg-type]
    mean_square_is(np.array([r.accel_b[0, 2] / -GRAVITY - 1.0 for r in scaled]), 0.01**2)
    assert all(r.accel_b[0, 0] == 0.0 for r in scaled)
    tilted = [record(Imu(**silent, misalignment_deg=0.5), n=2, seed=s) for s in range(300)]  # type: ignore[arg-type]
    mean_square_is(np.array([r.accel_b[0, :2] / GRAVITY for r in tilted]), math.radians(0.5) ** 2)


def test_quantisation_and_saturation() -> None:
    r = record(Imu(gyro_step_rad_s=1e-3, accel_step_m_s2=0.01, accel_limit_m_s2=9.0), n=500)
    np.testing.assert_allclose(r.gyro_b / 1e-3, np.round(r.gyro_b / 1e-3), atol=1e-9)
    assert len(np.unique(r.gyro_b)) > 3
    np.testing.assert_allclose(r.accel_b[:, 2], -9.0)
