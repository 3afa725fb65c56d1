import math

import numpy as np
import pytest

from models import so3
from models.frames import GRAVITY
from models.messages import Array
from models.sim.air import Wind, blow
from models.sim.trajectory import FixedWing, Multirotor, Trajectory, build

VEHICLES = [Multirotor(), FixedWing(), Multirotor(drag_1_s=0.3)]
AIR = blow(Wind(speed_m_s=6.0, gust_m_s=1.0), np.random.default_rng(0))
G_N = np.array([0.0, 0.0, GRAVITY])


def fly(vehicle: Multirotor | FixedWing, duration_s: float = 120.0, seed: int = 3) -> Trajectory:
    in_wind = isinstance(vehicle, Multirotor) and vehicle.drag_1_s > 0.0
    return build(vehicle, duration_s, np.random.default_rng(seed), AIR if in_wind else None)


def difference(f: dict[int, Array], h: float) -> Array:
    """Derivative from values at -2h, -h, h, 2h, exact to fourth order."""
    return np.asarray((8 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12 * h))


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_velocity_acceleration_and_rate_are_the_derivatives(vehicle: Multirotor | FixedWing) -> None:
    trajectory, h = fly(vehicle), 5e-3
    t = np.random.default_rng(1).uniform(0.1, 119.9, 300)
    near = {k: trajectory.at(t + k * h) for k in (-2, -1, 1, 2)}
    here = trajectory.at(t)
    np.testing.assert_allclose(here.v_n, difference({k: m.p_n for k, m in near.items()}, h), atol=1e-7)
    np.testing.assert_allclose(here.a_n, difference({k: m.v_n for k, m in near.items()}, h), atol=1e-7)
    turns = {
        k: np.array([so3.quat_log(so3.multiply(so3.conjugate(a), b)) for a, b in zip(here.q_nb_wxyz, m.q_nb_wxyz, strict=True)])
        for k, m in near.items()
    }
    np.testing.assert_allclose(here.omega_b, difference(turns, h), atol=1e-6)
    assert np.abs(here.omega_b).max() > 0.1  # it does turn


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_angular_acceleration_is_continuous(vehicle: Multirotor | FixedWing) -> None:
    trajectory = fly(vehicle, 20.0)

    def largest_jump(dt: float) -> float:
        omega_b = trajectory.at(np.arange(0.0, 20.0, dt)).omega_b
        return float(np.abs(np.diff(omega_b, n=2, axis=0)).max() / dt)

    # A jump would stay as dt goes to zero; a continuous function's differences shrink with it.
    assert largest_jump(1e-3) < 0.6 * largest_jump(2e-3)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_attitude_is_a_rotation_and_quaternion_and_matrix_agree(vehicle: Multirotor | FixedWing) -> None:
    motion = fly(vehicle).at(np.linspace(0.0, 120.0, 200))
    for R, q in zip(motion.R_nb, motion.q_nb_wxyz, strict=True):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(so3.matrix(q), R, atol=1e-12)


def test_multirotor_pushes_along_minus_z_only_whatever_its_yaw() -> None:
    trajectory = fly(Multirotor())
    t = np.linspace(0.0, 120.0, 1000)
    motion = trajectory.at(t)
    thrust_b = np.einsum("kij,ki->kj", motion.R_nb, motion.a_n - G_N)
    np.testing.assert_allclose(thrust_b[:, :2], 0.0, atol=1e-12)
    assert thrust_b[:, 2].max() < -2.0
    assert trajectory.yaw is not None
    yaw = trajectory.yaw(t)
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)])
    np.testing.assert_allclose(np.sum(motion.R_nb[:, :, 1] * heading, axis=1), 0.0, atol=1e-12)
    assert np.sum(motion.R_nb[:, :, 0] * heading, axis=1).min() > 0.5
    course = np.arctan2(motion.v_n[:, 1], motion.v_n[:, 0])
    assert np.abs(wrapped(course - yaw)).max() > 2.0  # it flies sideways and backwards too


def wrapped(angle: Array) -> Array:
    return np.asarray((angle + math.pi) % (2 * math.pi) - math.pi)


def test_multirotor_starts_at_rest_on_the_origin_climbs_hovers_and_keeps_its_limits() -> None:
    vehicle = Multirotor(speed_m_s=8.0, climb_m_s=3.0, area_m=120.0, height_m=40.0)
    motion = fly(vehicle, 600.0).at(np.arange(0.0, 600.0, 0.05))
    assert np.linalg.norm(motion.p_n[0]) < 0.3
    assert np.linalg.norm(motion.v_n[0]) < 0.2
    assert np.abs(motion.p_n[:, :2]).max() < 60.3
    assert motion.p_n[:, 2].min() > -1.3 * 40.0 - 0.3
    level = np.linalg.norm(motion.v_n[:, :2], axis=1)
    assert 7.0 < level.max() < 8.3
    assert 2.5 < np.abs(motion.v_n[:, 2]).max() < 3.3
    assert np.mean(level < 0.3) > 0.05
    tilt_deg = np.degrees(np.arccos(motion.R_nb[:, 2, 2]))
    assert 25.0 < tilt_deg.max() < 60.0


def test_visits_are_flown_to_and_change_nothing_before() -> None:
    plain, visiting = fly(Multirotor()), fly(Multirotor(visits=((60.0, 10.0, 250.0), (61.0, 0.0, 30.0))))
    t = np.arange(0.0, 120.0, 0.1)
    p = visiting.at(t).p_n
    np.testing.assert_allclose(p[t < 50.0], plain.at(t[t < 50.0]).p_n, atol=0.5)  # its wander is another one
    nearest = np.linalg.norm(p[:, :2] - (10.0, 250.0), axis=1)
    assert nearest.min() < 8.0  # a corner is rounded
    turned = int(np.argmin(nearest))
    assert t[turned] > 60.0
    assert p[turned : turned + 100, 1].min() < 200.0  # and it comes back


@pytest.mark.parametrize("seed", range(5))
def test_a_multirotor_that_lands_ends_at_rest_on_the_origin(seed: int) -> None:
    trajectory = fly(Multirotor(lands=True, speed_m_s=8.0, climb_m_s=3.0), 150.0, seed)
    motion = trajectory.at(np.linspace(0.0, 150.0, 3001))
    assert np.abs(motion.p_n[-20:]).max() < 0.3
    assert np.abs(motion.v_n[-20:]).max() < 0.3
    assert motion.p_n[:, 2].max() < 0.5  # never below the ground
    assert -motion.p_n[:, 2].min() > 25.0
    assert np.hypot(motion.v_n[:, 0], motion.v_n[:, 1]).max() < 8.5
    assert np.abs(motion.v_n[:, 2]).max() < 3.3
    flown = motion.p_n[:, 2] < -20.0
    assert flown.mean() > 0.55


def test_fixed_wing_turns_are_coordinated_and_its_nose_follows_the_path() -> None:
    motion = fly(FixedWing(), 600.0).at(np.arange(0.0, 600.0, 0.05))
    speed = np.linalg.norm(motion.v_n, axis=1)
    v_b = np.einsum("kij,ki->kj", motion.R_nb, motion.v_n)
    f_b = np.einsum("kij,ki->kj", motion.R_nb, motion.a_n - G_N)
    np.testing.assert_allclose(v_b[:, 0], speed)
    np.testing.assert_allclose(f_b[:, 1], 0.0, atol=1e-12)
    assert f_b[:, 2].max() < -5.0  # the lift is upwards in the body
    assert 15.0 < speed.min() < 18.0
    assert 22.0 < speed.max() < 25.0
    bank_deg = np.degrees(np.arctan2(motion.R_nb[:, 2, 1], motion.R_nb[:, 2, 2]))
    assert 25.0 < np.abs(bank_deg).max() < 40.0
    assert np.mean(np.abs(bank_deg) < 2.0) > 0.1


def test_an_hour_of_fixed_wing_stays_in_its_area_and_height() -> None:
    motion = fly(FixedWing(area_m=2000.0, height_m=150.0), 3600.0).at(np.arange(0.0, 3600.0, 0.5))
    assert np.abs(motion.p_n[:, :2]).max() < 2500.0
    assert -motion.p_n[:, 2].max() > 40.0
    assert -motion.p_n[:, 2].min() < 260.0


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_evaluation_at_many_instants_is_that_at_each(vehicle: Multirotor | FixedWing) -> None:
    trajectory, t = fly(vehicle), np.array([0.0, 17.3, 120.0])
    together = trajectory.at(t)
    for k in range(3):
        alone = trajectory.at(t[k : k + 1])
        np.testing.assert_array_equal(alone.p_n[0], together.p_n[k])
        np.testing.assert_array_equal(alone.omega_b[0], together.omega_b[k])


@pytest.mark.parametrize("t", [-0.1, 120.1, float("nan")])
def test_outside_its_duration_there_is_no_motion(t: float) -> None:
    with pytest.raises(ValueError, match=r"lasts from 0 to 120\.0 s"):
        fly(Multirotor()).at(np.array([1.0, t]))


def test_seeds_make_courses_and_the_vehicles_own_seed_fixes_its() -> None:
    t = np.array([60.0])

    def place(vehicle: Multirotor | FixedWing, seed: int) -> Array:
        return np.asarray(fly(vehicle, seed=seed).at(t).p_n[0])

    for kind in (Multirotor, FixedWing):
        np.testing.assert_array_equal(place(kind(), 1), place(kind(), 1))
        assert np.linalg.norm(place(kind(), 1) - place(kind(), 2)) > 1.0
        np.testing.assert_array_equal(place(kind(seed=9), 1), place(kind(seed=9), 2))


def test_across_its_thrust_a_multirotor_feels_nothing_but_drag() -> None:
    t = np.linspace(0.0, 120.0, 500)
    motion, wind = fly(Multirotor(drag_1_s=0.3)).at(t), AIR.at(t)[0]
    felt, through_air = (np.einsum("kij,ki->kj", motion.R_nb, v) for v in (motion.a_n - G_N, motion.v_n - wind))
    np.testing.assert_allclose(felt[:, :2], -0.3 * through_air[:, :2], atol=1e-9)


def test_a_fixed_wing_flies_along_its_nose_through_air_that_moves() -> None:
    t = np.linspace(0.0, 120.0, 500)
    motion = build(FixedWing(), 120.0, np.random.default_rng(3), AIR).at(t)
    along = np.einsum("kij,ki->kj", motion.R_nb, motion.v_n - AIR.at(t)[0])
    np.testing.assert_allclose(along[:, 1:], 0.0, atol=1e-9)


def test_a_wind_has_the_gusts_that_it_is_asked_for() -> None:
    t = np.arange(0.0, 5000.0, 0.1)
    wind, change = blow(Wind(speed_m_s=6.0, gust_m_s=1.0, gust_s=4.0), np.random.default_rng(1)).at(t)
    gust = wind[:, :2] - wind[:, :2].mean(axis=0)
    np.testing.assert_allclose(gust.std(axis=0), 1.0, rtol=0.1)
    np.testing.assert_allclose(np.hypot(*wind[:, :2].mean(axis=0)), 6.0, rtol=0.02)
    lag = round(4.0 / 0.1)
    assert np.mean(gust[:-lag] * gust[lag:]) == pytest.approx(np.exp(-1.0), abs=0.2)
    np.testing.assert_allclose(np.diff(wind[:, 0]) / 0.1, 0.5 * (change[1:, 0] + change[:-1, 0]), atol=0.01)
