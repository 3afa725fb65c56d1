"""Fixes that share errors: how much of one the next one still has, and what the estimate claims then."""

from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Innovation
from estimator.filter.mismatch import Scatter, scatter
from estimator.sources.pose import PoseConfig
from models.measurements import Pose
from models.messages import Array, Input, PoseFix, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E
from tests.estimator.scenes import SECOND, aid_of, error, fly, pose_fix, position_errors, radii, simulated, within

SIGMA, SETTLED_S = 0.2, 20.0


def _course(count: int, rho: float, seed: int) -> Array:
    """(count, 6) of variance 1, first-order Gauss-Markov."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((count, 6))
    for k in range(1, count):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * x[k]
    return x


def _seen(nu: Array) -> Innovation:
    return Innovation(nu, np.eye(6), np.eye(6), SIGMA**2 * np.eye(6), SIGMA**2 * np.eye(6), float(nu @ nu) / SIGMA**2, 0.0)


def _after(nus: Array, every_ns: int = SECOND // 20) -> Scatter:
    known = Scatter(EPOCH_NS)
    for k, nu in enumerate(nus):
        known = known.also(EPOCH_NS + k * every_ns, _seen(nu), SIGMA**2 * np.eye(6), fused=True)
    return known


@pytest.mark.parametrize("seed", range(20))
def test_white_noise_lasts_for_no_share(seed: int) -> None:
    assert max(_after(SIGMA * _course(400, 0.0, seed)).shares) < 0.05


@pytest.mark.parametrize("rho", [0.9, 0.97, 0.99])
@pytest.mark.parametrize("seed", range(3))
def test_the_correlation_is_found_and_not_more_than_it(rho: float, seed: int) -> None:
    known = _after(SIGMA * _course(400, rho, seed))
    for share in known.shares:
        assert rho - 0.15 < share < rho + 0.01
    assert known.weight == pytest.approx((1.0 - max(known.shares)) / (1.0 + max(known.shares)))


def test_position_and_attitude_have_shares_of_their_own() -> None:
    nus = SIGMA * np.concatenate((_course(400, 0.97, 1)[:, :3], _course(400, 0.0, 2)[:, 3:]), axis=1)
    position, attitude = _after(nus).shares
    assert position > 0.8
    assert attitude < 0.05


def test_false_fixes_change_little_and_a_pause_nothing() -> None:
    nus = SIGMA * _course(400, 0.97, 3)
    nus[[386, 394], :3] += 50.0
    assert min(_after(nus).shares) > 0.6
    known = _after(SIGMA * _course(400, 0.97, 3))
    assert known.also(known.t_ns + 60 * SECOND, _seen(np.ones(6)), np.eye(6), fused=True).shares == known.shares


def test_the_variance_that_a_fix_reports_is_divided_and_a_division_that_is_configured_stays() -> None:
    fix = pose_fix(EPOCH_NS)
    aid, configured = aid_of(fix), aid_of(fix, PoseConfig(lasting_share=0.5))
    z = aid.measurement(None)
    assert isinstance(z, Pose)
    known = _after(SIGMA * _course(400, 0.97, 3))
    divided, rest = scatter.taken(aid, z, known)
    assert isinstance(rest, Pose)
    (look,) = [e.moves(np.zeros(16)) for e in divided.slow_errors if e.block == "/pose_fix.look"]
    assert look is not None
    np.testing.assert_allclose(np.diag(rest.noise + look @ look.T), np.diag(z.noise))
    np.testing.assert_allclose(np.diag(look @ look.T) / np.diag(z.noise), np.repeat(known.shares, 3))
    assert scatter.taken(configured, z, known) == (configured, z)


def test_a_fix_in_part_stays_as_it_is() -> None:
    covariance = np.diag([0.01] * 5 + [np.nan])
    aid = aid_of(replace(pose_fix(EPOCH_NS), covariance=covariance))
    z = aid.measurement(None)
    assert isinstance(z, Pose)
    known = _after(SIGMA * _course(400, 0.97, 3))
    assert scatter.taken(aid, z, known) == (aid, z)


def _flown(shift: Sequence[Array] | None, claimed: float = 1.0) -> tuple[Simulation, list[Input]]:
    toml = "duration_s = 50.0\n[imu]\nrate_hz = 100.0\n[pose_fix]\nrate_hz = 20.0\nsigma_m = [{0}, {0}, {0}]\n"
    flight = simulated(toml.format(0.2 if shift is None else 0.005), seed=2)
    messages, k = list[Input](), 0
    for m in flight.messages:
        if isinstance(m, PoseFix):
            covariance = np.array(m.covariance)
            covariance[:3, :3] = (claimed * SIGMA) ** 2 * np.eye(3)
            p_n = m.p_n if shift is None else vec3(np.add(m.p_n, shift[k]))
            messages.append(replace(m, p_n=p_n, covariance=covariance))
            k += 1
        else:
            messages.append(m)
    return flight, messages


@pytest.mark.parametrize("seed", [1, 2])
def test_correlated_fixes_are_not_averaged_away(seed: int) -> None:
    """At 20 Hz, errors correlated over 2 s: forty fixes are one."""
    flight, messages = _flown(list(SIGMA * _course(1100, np.exp(-0.05 / 2.0), seed)[:, :3]))
    run = fly(flight, messages=messages)
    found = within(run.estimates, SETTLED_S, 50.0)
    off = np.array([error(e, flight.truth)[E.P] for e in found])
    nees = [o @ np.linalg.solve(e.covariance[E.P, E.P], o) / 3.0 for o, e in zip(off, found, strict=True)]
    assert np.mean(nees) < 2.0
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 1.2 * np.sqrt(3.0) * SIGMA
    assert not any("stamps of" in h.detail for h in run.health)
    assert run.internal_errors() == []


def test_white_fixes_are_averaged() -> None:
    flight, messages = _flown(None)
    run = fly(flight, messages=messages)
    assert np.median(radii(within(run.estimates, SETTLED_S, 50.0))) < 0.25


def test_fixes_four_times_better_than_they_claim_stay_accurate() -> None:
    flight, messages = _flown(None)
    claimed = [replace(m, covariance=16.0 * np.array(m.covariance)) if isinstance(m, PoseFix) else m for m in messages]
    off, other = (
        position_errors(within(fly(flight, messages=some).estimates, SETTLED_S, 50.0), flight.truth)
        for some in (messages, claimed)
    )
    assert np.sqrt(np.mean(other**2)) < 2.5 * np.sqrt(np.mean(off**2))
