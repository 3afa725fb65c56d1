"""Units, fix types, accuracies, origins."""

import numpy as np
import pytest

from logs.importers import recording, sensors
from logs.store.reader import LogError
from models.frames import Origin
from models.messages import Array

rng = np.random.default_rng(11)
GYRO = 0.3 * rng.standard_normal((500, 3))
ACCEL = np.array([0.0, 0.0, -9.8]) + 2.0 * rng.standard_normal((500, 3))


@pytest.mark.parametrize(
    ("gyro_b", "accel_b", "line"),
    [
        (GYRO, ACCEL / 9.80665, "that is g; needed: m/s^2"),
        (GYRO, 0.1 * GYRO, "gravity is missing"),
        (GYRO, 1000.0 * ACCEL, "which is not m/s^2"),
        (np.rad2deg(GYRO), ACCEL, "that is deg/s; needed: rad/s"),
        (GYRO * np.nan, ACCEL, "no finite IMU sample"),
    ],
)
def test_wrong_units_are_refused(gyro_b: Array, accel_b: Array, line: str) -> None:
    with pytest.raises(LogError, match=line.replace("^", r"\^")):
        sensors.check_imu(gyro_b, accel_b, "imu.csv")


def test_right_units_pass_also_with_some_nan() -> None:
    gyro_b, accel_b = GYRO.copy(), ACCEL.copy()
    gyro_b[3], accel_b[7] = np.nan, np.nan
    assert sensors.check_imu(gyro_b, accel_b, "imu.csv") == []


def test_axes_that_do_not_fit_gravity_are_reported() -> None:
    (note,) = sensors.check_imu(GYRO, -ACCEL, "imu.csv")
    assert "wrong axes?" in note


def test_slow_imus_are_reported() -> None:
    assert sensors.check_rate(np.arange(10, dtype=np.int64) * 10_000_000, "x") == []
    (note,) = sensors.check_rate(np.arange(10, dtype=np.int64) * 500_000_000, "x")
    assert note.startswith("x: 2.0 IMU samples a second are too few")


def test_positions_that_are_not_degrees_are_refused() -> None:
    sensors.check_place(np.array([[-89.0, 179.9, 1e4], [np.nan] * 3, [np.inf, 0.0, 0.0]]), "gps.csv")
    sensors.check_place(np.array([[47.0, 8.0, 0.0], [47.0, 8.0, 0.0], [1e9, 8.0, 0.0]]), "gps.csv")  # one damaged row
    with pytest.raises(LogError, match="1e-7 deg"):
        sensors.check_place(np.array([[473977422.0, 85455940.0, 488.0]]), "gps.csv")


def test_fix_types() -> None:
    np.testing.assert_array_equal(sensors.navsat_status(np.arange(7.0)), [-1, -1, -1, 0, 1, 2, 2])


def test_dop_at_one_gives_the_cep_of_consumer_receivers() -> None:
    variance = sensors.variance_from_dop(np.array([1.0, 2.0, np.nan]), np.array([np.nan, 1.5, np.nan]))
    errors = rng.standard_normal((20_000, 2)) * np.sqrt(variance[0, :2])
    assert 2.4 < np.median(np.linalg.norm(errors, axis=1)) < 2.6
    np.testing.assert_allclose(variance[1], [18.0, 18.0, 4.5**2])
    assert np.isnan(variance[2]).all()


def test_standard_pressure() -> None:
    np.testing.assert_allclose(
        sensors.standard_pressure(np.array([0.0, 1000.0, 5000.0])), [101325.0, 89874.6, 54019.9], rtol=1e-4
    )


def test_the_origin_is_found_from_fixes_and_truth_in_spite_of_noise_and_outliers() -> None:
    """GIVEN a truth about 2 km away from its origin WHEN a tenth of the fixes is 100 m off THEN the origin is right to 0.5 m."""
    origin = Origin(47.4, 8.5, 500.0)
    t = np.arange(400, dtype=np.int64) * 200_000_000
    p_n = np.array([2000.0, -1500.0, -50.0]) + 100.0 * rng.standard_normal((400, 3))
    measured = p_n + rng.standard_normal((400, 3))
    measured[::10] += 100.0
    lla = np.array([origin.to_geodetic(p) for p in measured])
    truth = recording.truth(t, p_n, p_n, np.full((400, 4), np.nan))
    fixes = recording.gnss(t + 300_000_000, t, lla, np.ones((400, 3)), np.zeros(400))
    found = sensors.origin_of_truth(fixes, truth, 0.3)
    assert found is not None
    assert np.abs(origin.to_ned(*found)).max() < 0.5
    near = (47.4, 8.5, 500.9)
    assert sensors.origin_of_truth(fixes, truth, 0.3, near) == near  # what the log says, if it fits
    wrong = (47.4, 8.5, 512.0)
    assert sensors.origin_of_truth(fixes, truth, 0.3, wrong) == found
    no_fix = recording.gnss(t, t, lla, np.ones((400, 3)), np.full(400, -1.0))
    assert sensors.origin_of_truth(no_fix, truth, 0.0) is None
