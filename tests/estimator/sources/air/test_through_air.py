"""Motion through the air: Jacobians by differentiation, and the drag of PX4's model."""

from dataclasses import replace

import numpy as np
import pytest

from estimator.sources.air.through_air import SEA_LEVEL_KG_M3, AirVelocity, DragForce, density_ratio
from models import so3
from models.messages import Array
from models.state import E, X, retract

WIND = np.array([3.0, -2.0])
LINEAR, BALLISTIC = 0.15, 60.0
SQUARE = 0.5 * SEA_LEVEL_KG_M3 / BALLISTIC


def _state() -> Array:
    x = np.random.default_rng(0).normal(size=X.SIZE)
    x[X.Q], x[X.V], x[X.BA] = so3.from_euler(0.1, -0.2, 2.0), (10.0, 3.0, 1.0), (0.1, -0.05, 0.2)
    return x


def _through_air(x: Array) -> Array:
    return np.asarray(so3.matrix(x[X.Q]).T @ (x[X.V] - [*WIND, 0.0]))


def _readings(x: Array) -> list[AirVelocity | DragForce]:
    """Without an error at the state x."""
    u = _through_air(x)
    across = u[:2]
    force = -(LINEAR + SQUARE * np.linalg.norm(across)) * across + x[X.BA][:2]
    calm = -LINEAR * across + x[X.BA][:2]
    return [
        AirVelocity(u[:1], np.eye(1), np.arange(1)),
        AirVelocity(u[:2], np.eye(2), np.arange(2)),
        DragForce(force, 0.5, LINEAR, SQUARE),
        DragForce(calm, 0.5, LINEAR, 0.0),
    ]


def _innovation(z: AirVelocity | DragForce, x: Array, wind: Array) -> Array:
    """As the filter makes it: less what the wind adds."""
    nu, _ = z.in_wind(wind).evaluate(x, np.zeros(3))
    return np.asarray(nu + so3.matrix(x[X.Q]).T[z.rows, :2] @ wind)


@pytest.mark.parametrize("which", range(4), ids=["airspeed", "with sideslip", "drag", "drag of the rotors"])
def test_the_true_reading_has_no_innovation_and_the_jacobian_is_its_derivative(which: int) -> None:
    x = _state()
    z = _readings(x)[which]
    np.testing.assert_allclose(_innovation(z, x, WIND), 0.0, atol=1e-9)
    _, h = z.in_wind(WIND).evaluate(x, np.zeros(3))
    for k in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[k] = 1e-6
        change = (_innovation(z, retract(x, dx), WIND) - _innovation(z, retract(x, -dx), WIND)) / 2e-6
        np.testing.assert_allclose(-change, h[:, k], atol=1e-5)


@pytest.mark.parametrize("which", range(4), ids=["airspeed", "with sideslip", "drag", "drag of the rotors"])
def test_a_scale_shows_by_the_velocity_of_the_estimate_and_not_by_the_noise_of_the_reading(which: int) -> None:
    x = _state()
    z = _readings(x)[which].in_wind(WIND)
    noisy = replace(z, f_b=z.f_b + 1.0) if isinstance(z, DragForce) else replace(z, z_b=z.z_b + 5.0)
    true = _through_air(x)[: len(z.rows), np.newaxis]
    if which == 1:
        true[1] = 0.0  # the tube measures nothing across it
    np.testing.assert_allclose(z.by_scale(x), true)
    np.testing.assert_allclose(noisy.by_scale(x), true)


def test_drag_that_is_hardly_there_is_less_certain_of_the_speed_than_the_force_is_of_itself() -> None:
    still, fast = (DragForce(np.array([f, 0.0]), 0.5, LINEAR, SQUARE) for f in (0.0, 5.0))
    assert still.noise[0, 0] == pytest.approx((0.5 / LINEAR) ** 2)
    assert fast.noise[0, 0] < still.noise[0, 0]
    assert np.isfinite(still.velocity(np.zeros(2))[1]).all()


def test_air_is_thinner_above_by_the_standard_atmosphere() -> None:
    assert density_ratio(0.0) == 1.0
    assert density_ratio(5000.0) == pytest.approx(0.6012, abs=1e-3)  # ICAO Doc 7488
