"""Which IMU samples and streams are usable: numbers, units, gravity."""

import math

import numpy as np
import pytest

from estimator.sources.base.machine import Phase
from estimator.sources.imu.plausibility import sample_refusal, stream_plausibility
from models.frames import GRAVITY
from models.messages import Array, ImuSample, Reason, Vec3, vec3


def _sample(gyro: Vec3 = (0.1, 0.2, 0.3), accel: Vec3 = (0.0, 0.0, -GRAVITY)) -> ImuSample:
    return ImuSample(0, 0, gyro, accel)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (math.nan, Reason.NOT_FINITE),
        (math.inf, Reason.NOT_FINITE),
        (-math.inf, Reason.NOT_FINITE),
        (1e308, Reason.IMPLAUSIBLE),
        (-1e5, Reason.IMPLAUSIBLE),
        (5e-324, None),
        (-0.0, None),
        (30.0, None),
    ],
)
def test_a_sample_is_judged_by_each_of_its_numbers(axis: int, value: float, reason: Reason | None) -> None:
    numbers = [0.1, 0.2, 0.3]
    numbers[axis] = value
    for sample in (_sample(gyro=vec3(numbers)), _sample(accel=vec3(numbers))):
        refusal = sample_refusal(sample)
        assert (refusal.reason if refusal else None) is reason


def _stream(gyro: Vec3, accel: Vec3) -> Array:
    noise = np.random.default_rng(0).normal(size=(200, 6)) * [0.01, 0.01, 0.01, 0.3, 0.3, 0.3]
    return np.tile([*gyro, *accel], (200, 1)) + noise


def test_a_sound_stream_is_active() -> None:
    assert stream_plausibility(_stream((0.5, -0.2, 1.0), (3.0, 0.0, -11.0))) == (Phase.ACTIVE, "")


@pytest.mark.parametrize(
    ("gyro", "accel", "word"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), "unit g"),
        ((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), "gravity is missing"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -9810.0), "gravity is missing or the unit is wrong"),
        ((30.0, 20.0, 40.0), (0.0, 0.0, -9.8), "degrees per second"),
    ],
)
def test_a_stream_in_wrong_units_or_without_gravity_is_stopped_with_the_reason(gyro: Vec3, accel: Vec3, word: str) -> None:
    phase, detail = stream_plausibility(_stream(gyro, accel))
    assert phase is Phase.STOPPED
    assert word in detail
