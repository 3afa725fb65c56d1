"""Velocity in the body and range: Jacobians by differentiation, and what is refused."""

import numpy as np
import pytest

from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.range import RangeConfig
from estimator.sources.velocity_body import VelocityBodyConfig
from models import so3
from models.messages import Array, Reading, Reason
from models.state import E, X, retract

GYRO, LEVER = np.array([0.3, -0.7, 1.1]), (0.4, -0.2, 0.9)


def _made(kind: str, values: tuple[float, ...], covariance: Array | None = None) -> Aid | Refusal | None:
    config = SourcesConfig(velocity_body=VelocityBodyConfig(lever_b_m=LEVER), range=RangeConfig(ground_m=-2.0))
    return aid_of(Reading(10**9, 10**9, f"/{kind}", kind, values, covariance), config)


def _state(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=X.SIZE)
    x[X.Q] = so3.from_euler(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0))
    x[X.P][2] = -20.0
    return x


@pytest.mark.parametrize("kind", ["velocity_body", "range"])
@pytest.mark.parametrize("seed", range(3))
def test_the_true_reading_has_no_innovation_and_the_jacobian_is_its_derivative(kind: str, seed: int) -> None:
    x = _state(seed)
    r = so3.matrix(x[X.Q])
    true = r.T @ x[X.V] + np.cross(GYRO - x[X.BG], LEVER) if kind == "velocity_body" else [22.0 / r[2, 2]]
    aid = _made(kind, tuple(float(v) for v in true))
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    nu, h = z.evaluate(x, GYRO)
    np.testing.assert_allclose(nu, 0.0, atol=1e-9)
    for k in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[k] = 1e-6
        change = (z.evaluate(retract(x, dx), GYRO)[0] - z.evaluate(retract(x, -dx), GYRO)[0]) / 2e-6
        np.testing.assert_allclose(-change, h[:, k], atol=1e-6)


def test_components_that_are_not_given_have_no_row() -> None:
    aid = _made("velocity_body", (3.0, 9.0, 9.0), np.diag([0.01, 1e6, 1e6]))
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    assert len(z.evaluate(_state(0), GYRO)[0]) == 1
    none = _made("velocity_body", (3.0, 9.0, 9.0), np.diag([1e6, 1e6, 1e6]))
    assert isinstance(none, Refusal)
    assert none.reason is Reason.UNSUPPORTED


@pytest.mark.parametrize(
    ("kind", "values", "reason"),
    [
        ("velocity_body", (900.0, 0.0, 0.0), Reason.IMPLAUSIBLE),
        ("velocity_body", (np.nan, 0.0, 0.0), Reason.NOT_FINITE),
        ("range", (np.inf,), Reason.NOT_FINITE),
        ("range", (-1.0,), Reason.IMPLAUSIBLE),
    ],
)
def test_what_is_no_reading_is_refused(kind: str, values: tuple[float, ...], reason: Reason) -> None:
    made = _made(kind, values)
    assert isinstance(made, Refusal)
    assert made.reason is reason
