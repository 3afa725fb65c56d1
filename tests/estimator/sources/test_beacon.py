"""Range to a beacon: its Jacobian, what is refused, and that a range to a vehicle that is lost across the line proves little."""

import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.beacon import BeaconConfig, BeaconRange
from models import so3
from models.imu import Coast, ImuNoise, constants
from models.messages import Array, Reading, Reason
from models.state import E, X, retract

LEVER, BEACON = (0.4, -0.2, 0.9), (30.0, -20.0, -5.0)
CONFIG = SourcesConfig(beacon=BeaconConfig(at_n_m=((0.0, 0.0, 0.0), BEACON), antenna_b_m=LEVER))
NO_RATE = np.zeros(3)


def _made(z_m: float, topic: str = "/beacon/2") -> Aid | Refusal | None:
    return aid_of(Reading(10**9, 10**9, topic, "beacon", (z_m,)), CONFIG)


def _state(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=X.SIZE)
    x[X.Q] = so3.normalise(x[X.Q])
    return x


@pytest.mark.parametrize("seed", range(3))
def test_the_true_range_has_no_innovation_and_the_jacobian_is_its_derivative(seed: int) -> None:
    x = _state(seed)
    aid = _made(float(np.linalg.norm(x[X.P] + so3.matrix(x[X.Q]) @ LEVER - BEACON)))
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    nu, h = z.evaluate(x, NO_RATE)
    np.testing.assert_allclose(nu, 0.0, atol=1e-9)
    for k in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[k] = 1e-6
        change = (z.evaluate(retract(x, dx), NO_RATE)[0] - z.evaluate(retract(x, -dx), NO_RATE)[0]) / 2e-6
        np.testing.assert_allclose(-change, h[:, k], atol=1e-7)


@pytest.mark.parametrize(
    ("z_m", "topic", "reason", "words"),
    [
        (12.0, "/uwb", Reason.UNSUPPORTED, "at_n_m has 2"),
        (12.0, "/beacon/3", Reason.UNSUPPORTED, "at_n_m has 2"),
        (12.0, "/beacon/0", Reason.UNSUPPORTED, "at_n_m has 2"),
        (-1.0, "/beacon/1", Reason.IMPLAUSIBLE, "a range of -1 m"),
        (1500.0, "/beacon/1", Reason.IMPLAUSIBLE, "longest_m is 1000"),
    ],
)
def test_a_range_of_no_beacon_or_none_is_refused(z_m: float, topic: str, reason: Reason, words: str) -> None:
    refused = _made(z_m, topic)
    assert isinstance(refused, Refusal)
    assert refused.reason is reason
    assert words in refused.detail


def test_fifty_ranges_to_a_vehicle_that_is_lost_across_the_line_leave_it_consistent() -> None:
    """Known to 12 m across, 40 m away: the range bends by metres. By the gradient alone NEES/3 is above 10."""
    rng, sigma = np.random.default_rng(5), np.array([1.0, 12.0, 12.0])
    cov = np.diag(np.repeat([1.0, 0.1, 0.01, 1e-4, 0.01], 3))
    cov[E.P, E.P] = np.diag(sigma**2)
    beacon, nees = np.array([-40.0, 0.0, 0.0]), []
    for _ in range(150):
        x = np.zeros(X.SIZE)
        x[X.Q] = so3.normalise(np.array([1.0, 0.0, 0.0, 0.0]))
        true_n = sigma * rng.standard_normal(3)
        eskf = Eskf(0, x, cov.copy(), constants(ImuNoise(), Coast(), None))
        for _ in range(50):
            z_m = float(np.linalg.norm(true_n - beacon)) + 0.1 * rng.standard_normal()
            z = BeaconRange(z_m, beacon, np.zeros(3), np.array([[0.01]]))
            eskf.update(eskf.innovation(z, NO_RATE))
        off = true_n - eskf.x[X.P]
        nees.append(off @ np.linalg.solve(eskf.cov[E.P, E.P], off) / 3.0)
    assert 0.5 < np.mean(nees) < 1.5
    assert np.quantile(nees, 0.95) < 4.0
