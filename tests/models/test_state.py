"""The state table tiles its dimensions, and (+) and (-) are each other's inverse with a local (right) attitude error."""

import numpy as np
import pytest

from models import so3
from models.messages import Array
from models.state import E, NavState, X, has_moved, local, retract


def _state(seed: int) -> Array:
    x = np.random.default_rng(seed).normal(size=X.SIZE)
    x[X.Q] = so3.normalise(x[X.Q])
    return x


def _errors() -> list[Array]:
    """Zero, tiny, random, and a turn of nearly 180 degrees."""
    d = np.random.default_rng(7).normal(size=E.SIZE)
    large = d.copy()
    large[E.THETA] *= 3.1 / np.linalg.norm(large[E.THETA])
    return [np.zeros(E.SIZE), 1e-9 * d, 0.1 * d, d, large]


STATES = [_state(seed) for seed in range(4)]


def _covered(table: type[X] | type[E]) -> list[int]:
    parts = [part for part in vars(table).values() if isinstance(part, slice)]
    return sorted(i for part in parts for i in range(part.start, part.stop))


@pytest.mark.parametrize("table", [X, E])
def test_slices_tile_the_state_without_gap_or_overlap(table: type[X] | type[E]) -> None:
    assert _covered(table) == list(range(table.SIZE))


def test_every_error_component_has_its_own_name() -> None:
    assert len(E.NAMES) == len(set(E.NAMES)) == E.SIZE
    assert list(E.NAMES)[E.THETA] == ["thx", "thy", "thz"]
    assert list(E.NAMES)[E.BA] == ["bax", "bay", "baz"]


def test_pack_undoes_unpack_and_the_parts_are_copies() -> None:
    x = _state(0)
    nav = NavState.unpack(x)
    np.testing.assert_array_equal(nav.pack(), x)
    nav.p_n[:] = 0.0
    np.testing.assert_array_equal(x, _state(0))


def test_parts_stand_where_the_table_reports() -> None:
    nav = NavState(np.full(3, 1.0), np.full(3, 2.0), np.array([1.0, 0.0, 0.0, 0.0]), np.full(3, 4.0), np.full(3, 5.0))
    x = nav.pack()
    for part, value in ((X.P, 1.0), (X.V, 2.0), (X.BG, 4.0), (X.BA, 5.0)):
        np.testing.assert_array_equal(x[part], value)
    np.testing.assert_array_equal(nav.R_nb, np.eye(3))


@pytest.mark.parametrize("x", STATES)
@pytest.mark.parametrize("dx", _errors())
def test_local_undoes_retract(x: Array, dx: Array) -> None:
    np.testing.assert_allclose(local(x, retract(x, dx)), dx, rtol=1e-12, atol=2e-15)


@pytest.mark.parametrize(("x", "y"), list(zip(STATES, STATES[1:] + STATES[:1], strict=True)))
def test_retract_undoes_local(x: Array, y: Array) -> None:
    back = retract(x, local(x, y))
    np.testing.assert_allclose(so3.matrix(back[X.Q]), so3.matrix(y[X.Q]), rtol=0, atol=1e-14)
    back[X.Q] = y[X.Q]  # q and -q are one attitude, compared above
    np.testing.assert_allclose(back, y, rtol=0, atol=1e-14)


@pytest.mark.parametrize("x", STATES)
def test_nothing_added_is_the_state_itself(x: Array) -> None:
    np.testing.assert_allclose(retract(x, np.zeros(E.SIZE)), x, rtol=0, atol=1e-15)


@pytest.mark.parametrize("x", STATES)
@pytest.mark.parametrize("dx", _errors())
def test_attitude_error_is_local_and_the_rest_is_added(x: Array, dx: Array) -> None:
    """R = R_hat exp(theta), everything else x + dx."""
    y = retract(x, dx)
    R_hat, R = NavState.unpack(x).R_nb, NavState.unpack(y).R_nb
    np.testing.assert_allclose(R, R_hat @ so3.matrix(so3.quat_exp(dx[E.THETA])), rtol=0, atol=1e-14)
    for of_state, of_error in ((X.P, E.P), (X.V, E.V), (X.BG, E.BG), (X.BA, E.BA)):
        np.testing.assert_array_equal(y[of_state], x[of_state] + dx[of_error])


def test_quaternion_stays_a_unit_over_many_steps() -> None:
    rng = np.random.default_rng(8)
    x = _state(0)
    for _ in range(1000):
        x = retract(x, rng.normal(size=E.SIZE))
    assert abs(np.linalg.norm(x[X.Q]) - 1.0) < 1e-15


def test_opposite_quaternions_are_no_error() -> None:
    x = _state(1)
    y = x.copy()
    y[X.Q] = -x[X.Q]
    np.testing.assert_allclose(local(x, y), np.zeros(E.SIZE), atol=1e-15)


@pytest.mark.parametrize("name", E.NAMES)
@pytest.mark.parametrize(("sigmas", "beyond"), [(4.9, False), (-4.9, False), (5.1, True), (-5.1, True)])
def test_position_velocity_and_attitude_move_the_vehicle_and_biases_do_not(name: str, sigmas: float, beyond: bool) -> None:
    i, cov = E.NAMES.index(name), 1e-3 * np.diag(np.arange(1.0, E.SIZE + 4.0))
    dx = np.zeros(E.SIZE)
    dx[i] = sigmas * np.sqrt(cov[i, i])
    assert has_moved(_state(2), retract(_state(2), dx), cov, 5.0) is (beyond and i < E.BG.start)
