"""Rest as a measurement: its innovation and Jacobian, and which samples are quiet."""

import numpy as np
import pytest

from estimator.fusion import Fusion, FusionConfig
from estimator.sources.rest import ON_GROUND, RestConfig, at_rest, is_quiet
from models import so3
from models.frames import GRAVITY
from models.messages import AidStatus, Array, Estimate, ImuSample, PoseFix, Reading, Reason, vec3
from models.state import E, X, retract

EARTH_N = np.array([5e-2, 0.0, -6e-2])  # a thousand times as fast, so that its part of the Jacobian shows


def _state(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=X.SIZE)
    x[X.Q] = so3.from_euler(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0))
    return x


@pytest.mark.parametrize("seed", range(4))
def test_at_rest_the_innovation_is_zero_and_the_jacobian_its_derivative(seed: int) -> None:
    x = _state(seed)
    x[X.V] = 0.0
    rate = x[X.BG] + so3.matrix(x[X.Q]).T @ EARTH_N
    z = at_rest(np.tile(np.r_[rate, 0.0, 0.0, -9.8], (50, 1)), so3.to_euler(x[X.Q])[2], EARTH_N, RestConfig())
    nu, h = z.evaluate(x, np.zeros(3))
    np.testing.assert_allclose(nu, 0.0, atol=1e-12)
    for k in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[k] = 1e-6
        change = (z.evaluate(retract(x, dx), np.zeros(3))[0] - z.evaluate(retract(x, -dx), np.zeros(3))[0]) / 2e-6
        np.testing.assert_allclose(-change, h[:, k], atol=1e-7)


def test_a_steady_rate_is_quiet_and_a_shake_is_not() -> None:
    rng = np.random.default_rng(0)
    quiet = rng.normal(scale=[2e-3] * 3 + [0.03] * 3, size=(50, 6))
    assert is_quiet(quiet + np.array([0.1, 0.0, 0.0, 0.0, 0.0, -9.8]))
    shaken = quiet.copy()
    shaken[:, 4] += 0.3 * np.sin(np.arange(50))
    assert not is_quiet(shaken)


@pytest.mark.parametrize("noise", [1e-4, 7e-3])
def test_the_mean_rate_is_as_good_as_the_noise_of_its_samples(noise: float) -> None:
    """A gyroscope of 7 mrad/s at 125 Hz: its means differ by 0.6 mrad/s, and a rest that they refuted was lost for good."""
    rng, x = np.random.default_rng(1), np.zeros(X.SIZE)
    x[X.Q] = so3.from_euler(0.0, 0.0, 0.0)
    scores = []
    for _ in range(500):
        u = np.c_[rng.normal(scale=noise, size=(125, 3)), np.zeros((125, 3))]
        z = at_rest(u, 0.0, np.zeros(3), RestConfig())
        scores.append(z.evaluate(x, np.zeros(3))[0][4:] ** 2 / np.diag(z.noise)[4:])
    assert np.mean(scores) < 1.1


def test_after_a_flight_a_rest_has_a_heading_of_its_own() -> None:
    """Rest is not asked for in the air: what lands 3 degrees away is not held at the heading before the take-off."""
    rng, fusion, second, heading, outputs = np.random.default_rng(2), Fusion(FusionConfig()), 10**9, 0.5, []
    for k in range(2500):
        t_ns, turns = second + k * second // 100, 800 <= k < 1400
        rate = np.radians(0.5) if turns else 0.0
        heading += rate / 100.0
        u = rng.normal(scale=[1e-3] * 3 + [0.01] * 3) + np.array([0.0, 0.0, rate, 0.0, 0.0, -GRAVITY])
        outputs += fusion.handle(ImuSample(t_ns, t_ns, vec3(u[:3]), vec3(u[3:])))
        if k % 20 == 10:
            covariance = np.diag([0.01] * 3 + [0.1**2] * 3)
            outputs += fusion.handle(PoseFix(t_ns, t_ns, (0.0, 0.0, 0.0), tuple(so3.from_euler(0.0, 0.0, heading)), covariance))
        if k % 100 == 50:
            outputs += fusion.handle(Reading(t_ns, t_ns, "/landed", "rest", (0.0 if turns else float(ON_GROUND),)))
    rests = [a for a in outputs if isinstance(a, AidStatus) and a.kind == "rest" and a.t_ns > 19 * second]
    assert [a.reason for a in rests] == [Reason.FUSED] * 7
    last = [e for e in outputs if isinstance(e, Estimate)][-1]
    assert so3.to_euler(last.nav[X.Q])[2] == pytest.approx(heading, abs=0.01)
