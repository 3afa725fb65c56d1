import math

import numpy as np
import pytest

from benchmarks.campaign.bound import Linear, linearise, posterior_bound
from models import so3
from models.frames import GRAVITY, Origin
from models.imu import ImuNoise
from models.messages import Array, GnssFix, GnssVelocity, Input, PoseFix, Tick
from models.sim.aids import Gnss, PoseFixes
from models.sim.scenario import EPOCH_NS, Scenario, Truth, simulate
from models.sim.sensors import GRADES, Imu
from models.sim.trajectory import FixedWing, Multirotor
from models.state import E, NavState, local, retract
from tests.models.sim.strapdown import integrate

ORIGIN = Origin(47.4, 8.5, 450.0)
QUIET = ImuNoise(gyro_noise=1e-30, accel_noise=1e-30, gyro_walk=1e-30, accel_walk=1e-30)


def at_rest(duration_s: int, rate_hz: int = 50) -> Truth:
    n = duration_s * rate_hz + 1
    zero = np.zeros((n, 3))
    return Truth(
        t_ns=EPOCH_NS + np.arange(n, dtype=np.int64) * (10**9 // rate_hz),
        p_n=zero,
        v_n=zero,
        q_nb_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        R_nb=np.tile(np.eye(3), (n, 1, 1)),
        omega_b=zero,
        gyro_b=zero,
        accel_b=np.tile([0.0, 0.0, -GRAVITY], (n, 1)),
        gyro_bias=zero,
        accel_bias=zero,
    )


def diagonal(p: float, v: float, theta: float, bg: float, ba: float) -> Array:
    return np.diag(np.repeat(np.square([p, v, theta, bg, ba]), 3))


def test_free_inertial_drift_is_the_closed_form() -> None:
    # GIVEN a level IMU at rest with known variances of everything
    noise = ImuNoise(gyro_noise=1e-4, accel_noise=2e-3, gyro_walk=3e-6, accel_walk=1e-4)
    p, v, theta, bg, ba = 0.5, 0.05, 1e-3, 2e-5, 3e-3
    g, t = GRAVITY, 60.0
    # WHEN it is integrated for a minute without aid
    C = posterior_bound(at_rest(60), noise, [], diagonal(p, v, theta, bg, ba), [EPOCH_NS + 60 * 10**9], None)[0]
    # THEN the horizontal variances are the polynomials of time that the triple integrator gives
    horizontal = (
        p**2
        + v**2 * t**2
        + (g * theta) ** 2 * t**4 / 4
        + ba**2 * t**4 / 4
        + (g * bg) ** 2 * t**6 / 36
        + noise.accel_noise**2 * t**3 / 3
        + g**2 * noise.gyro_noise**2 * t**5 / 20
        + noise.accel_walk**2 * t**5 / 20
        + g**2 * noise.gyro_walk**2 * t**7 / 252
    )
    assert C[E.P, E.P][0, 0] == pytest.approx(horizontal, rel=1e-4)
    assert C[E.P, E.P][1, 1] == pytest.approx(horizontal, rel=1e-4)
    assert C[E.THETA, E.THETA][2, 2] == pytest.approx(
        theta**2 + bg**2 * t**2 + noise.gyro_noise**2 * t + noise.gyro_walk**2 * t**3 / 3, rel=1e-4
    )
    assert C[E.BG, E.BG][0, 0] == pytest.approx(bg**2 + noise.gyro_walk**2 * t, rel=1e-9)


@pytest.mark.parametrize("origin", [None, ORIGIN])
def test_transition_is_the_derivative_of_the_motion(origin: Origin | None) -> None:
    # GIVEN ten seconds of turning flight, and the strapdown equations integrated by the tests' own integrator
    scenario = Scenario(duration_s=10.0, vehicle=FixedWing(), geographic=origin is not None)
    if origin is not None:
        scenario = Scenario(duration_s=10.0, vehicle=FixedWing(), origin=(origin.lat_deg, origin.lon_deg, origin.alt_m))
    truth = simulate(scenario, 3).truth

    def flown(dx: Array) -> Array:
        start = NavState.unpack(
            retract(NavState(truth.p_n[0], truth.v_n[0], truth.q_nb_wxyz[0], np.zeros(3), np.zeros(3)).pack(), dx)
        )
        p_n, v_n, R_nb = integrate(
            (start.p_n, start.v_n, start.R_nb), truth.gyro_b - start.gyro_bias, truth.accel_b - start.accel_bias, 0.005, origin
        )
        return NavState(p_n, v_n, so3.from_matrix(R_nb), start.gyro_bias, start.accel_bias).pack()

    steps = np.repeat([1.0, 0.1, 1e-4, 1e-5, 1e-3], 3)
    phi = np.column_stack([local(flown(-h * e), flown(h * e)) / (2 * h) for h, e in zip(steps, np.eye(E.SIZE), strict=True)])
    # WHEN an initial covariance is carried along without noise  THEN it is what the derivative makes of it
    P0 = diagonal(1.0, 0.5, 0.01, 1e-3, 0.1)
    C = posterior_bound(truth, QUIET, [], P0, [int(truth.t_ns[-1])], origin)[0]
    expected = phi @ P0 @ phi.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(C / scale, expected / scale, atol=2e-5)


def test_measurement_is_the_information_form() -> None:
    rng = np.random.default_rng(5)
    L = rng.standard_normal((E.SIZE, E.SIZE))
    P0, H, R = L @ L.T + np.eye(E.SIZE), rng.standard_normal((6, E.SIZE)), np.diag(rng.uniform(0.1, 2.0, 6))
    truth = at_rest(1)
    C = posterior_bound(truth, QUIET, [Linear(EPOCH_NS, H, R)], P0, [EPOCH_NS], None)[0]
    np.testing.assert_allclose(C, np.linalg.inv(np.linalg.inv(P0) + H.T @ np.linalg.inv(R) @ H), rtol=1e-8, atol=1e-10)


def test_measurements_between_samples_are_used_at_their_own_time() -> None:
    # Velocity unknown: a position fix after t measures it with variance R / t^2, so its time is visible.
    truth, P0 = at_rest(2), diagonal(1e-9, 10.0, 1e-9, 1e-12, 1e-12)
    H = np.zeros((3, E.SIZE))
    H[:, E.P] = np.eye(3)
    for t in (1.0, 1.013):
        fix = Linear(EPOCH_NS + round(t * 1e9), H, 0.01 * np.eye(3))
        C = posterior_bound(truth, QUIET, [fix], P0, [int(truth.t_ns[-1])], None)[0]
        assert C[E.V, E.V][0, 0] == pytest.approx(1.0 / (t**2 / 0.01 + 1.0 / 100.0), rel=1e-6)


def test_order_of_questions_and_of_measurements_does_not_matter() -> None:
    simulation = simulate(Scenario(duration_s=20.0, pose_fix=PoseFixes(delay_s=(0.0, 3.0))), 1)
    linear = [m for m in (linearise(x, simulation.truth) for x in simulation.messages) if m]
    P0 = diagonal(5.0, 1.0, 0.1, 0.01, 0.2)
    at = [EPOCH_NS + k * 10**9 for k in (3, 17, 8)]

    def bound(measurements: list[Linear], at_ns: list[int]) -> Array:
        return posterior_bound(simulation.truth, simulation.imu_noise, measurements, P0, at_ns, simulation.origin)

    forward = bound(linear, at)
    np.testing.assert_array_equal(forward[::-1], bound(linear[::-1], at[::-1]))
    assert [m.t_ns for m in linear] != sorted(m.t_ns for m in linear)
    # Every question alone has the same answer: the later measurements do not count.
    np.testing.assert_allclose(bound([m for m in linear if m.t_ns <= at[2]], at[2:])[0], forward[2], rtol=1e-6)


def test_measurements_outside_are_ignored_and_questions_outside_refused() -> None:
    truth, P0, H = at_rest(1), diagonal(1.0, 1.0, 0.1, 0.01, 0.1), np.eye(E.SIZE)
    early = Linear(EPOCH_NS - 1, H, np.eye(E.SIZE))
    np.testing.assert_array_equal(posterior_bound(truth, QUIET, [early], P0, [EPOCH_NS], None)[0], P0)
    with pytest.raises(ValueError, match="outside"):
        posterior_bound(truth, QUIET, [], P0, [EPOCH_NS - 1], None)


def test_jacobians_are_the_derivatives_of_what_the_sensors_measure() -> None:
    # GIVEN a state in a turn, and the measurement functions written as in models/sim/aids.py
    truth = simulate(Scenario(duration_s=30.0, vehicle=Multirotor()), 2).truth
    k, lever = 4000, np.array([0.5, -0.3, -0.2])
    t = int(truth.t_ns[k])
    x = NavState(truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], np.zeros(3), np.zeros(3)).pack()

    def position(y: Array) -> Array:
        s = NavState.unpack(y)
        return np.asarray(s.p_n + s.R_nb @ lever)

    def velocity(y: Array) -> Array:
        s = NavState.unpack(y)
        return np.asarray(s.v_n + s.R_nb @ np.cross(truth.omega_b[k] - s.gyro_bias, lever))

    def pose(y: Array) -> Array:
        s, here = NavState.unpack(y), truth.q_nb_wxyz[k]
        return np.concatenate([s.p_n, so3.quat_log(so3.multiply(s.q_nb_wxyz, so3.conjugate(here)))])

    messages: list[tuple[Input, object]] = [
        (GnssFix(t, t, 0.0, 0.0, 0.0, np.eye(3)), position),
        (GnssVelocity(t, t, (0.0, 0.0, 0.0), np.eye(3)), velocity),
        (PoseFix(t, t, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6)), pose),
    ]
    h = 1e-5
    for message, measured in messages:
        assert callable(measured)
        expected = np.column_stack(
            [(measured(retract(x, h * e)) - measured(retract(x, -h * e))) / (2 * h) for e in np.eye(E.SIZE)]
        )
        linear = linearise(message, truth, (0.5, -0.3, -0.2))
        assert linear is not None
        np.testing.assert_allclose(linear.H, expected, atol=1e-8)
        np.testing.assert_array_equal(linear.R, np.eye(len(expected)))
    assert linearise(Tick(t, t), truth) is None
    assert linearise(GnssFix(t, t, 0.0, 0.0, 0.0, None), truth) is None


@pytest.mark.parametrize(
    ("grade", "drift_m"), [("hobby", 43.0), ("flight_controller", 18.0), ("industrial", 23.0), ("tactical", 9.0)]
)
def test_drift_after_a_minute_is_that_of_the_grade(grade: str, drift_m: float) -> None:
    # GIVEN four minutes of turning flight with GNSS of 1 m and 0.2 m/s, then none
    gnss = Gnss(sigma_m=(1.0, 1.0, 1.0), velocity_sigma_m_s=(0.2, 0.2, 0.2), outages_s=((240.0, 300.0),))
    scenario = Scenario(duration_s=300.0, vehicle=FixedWing(seed=1), imu=Imu(grade=grade, rate_hz=50.0), gnss=gnss)  # type: ignore[arg-type]
    simulation = simulate(scenario, 0)
    linear = [m for m in (linearise(x, simulation.truth) for x in simulation.messages) if m]
    start = GRADES[grade]
    P0 = diagonal(5.0, 1.0, 0.1, start.gyro_turn_on, start.accel_turn_on)
    end_ns = int(simulation.truth.t_ns[-1])
    # WHEN a minute has passed  THEN the horizontal RMS is that of the instrument class (typical figures, so 30 %)
    C = posterior_bound(simulation.truth, simulation.imu_noise, linear, P0, [end_ns], simulation.origin)[0]
    assert math.sqrt(C[E.P, E.P][0, 0] + C[E.P, E.P][1, 1]) == pytest.approx(drift_m, rel=0.3)
