"""The aligning stretch run again: the same answer whatever the filter made of it, and nothing counted twice."""

import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import innovation
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relinearise import Stretch, relinearise
from models import imu, so3
from models.imu import Coast
from models.messages import Array, ImuSample, PoseFix
from models.sim.scenario import Simulation
from models.state import E, X, local
from tests.estimator.scenes import aid_of, config_of, displaced, simulated, true_state


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    """Fixes between IMU samples, which are 0.9 m of flight apart: taken at a sample, a fix would be wrong by several sigma."""
    return simulated('duration_s = 12.0\n[vehicle]\nkind = "fixed_wing"\n[imu]\nrate_hz = 20.0\n[pose_fix]\nrate_hz = 0.97\n')


def _flown(simulation: Simulation, off_rad: float = 0.0, lie_at: int = -1) -> tuple[Stretch, Eskf, ImuBuffer]:
    """A stretch that starts with an attitude wrong by off_rad, as it should expect, and what a linear filter makes of it."""
    samples = ImuBuffer()
    for m in simulation.messages:
        if isinstance(m, ImuSample):
            samples.insert(m)
    start_ns = simulation.truth.t_ns[0]
    x = true_state(simulation.truth, start_ns)
    x[X.Q] = so3.multiply(x[X.Q], so3.quat_exp(np.array([0.0, 0.0, off_rad])))
    x[X.BG], x[X.BA] = 0.0, 0.0
    variances = np.repeat([1.0, 1.0, 0.5, 1e-2, 0.3], 3) ** 2
    constants = imu.constants(config_of(simulation).imu, Coast(), None)
    lead = Eskf(int(start_ns), x, np.diag(variances), constants)
    stretch = Stretch.of(lead)
    for k, fix in enumerate(m for m in simulation.messages if isinstance(m, PoseFix)):
        aid = aid_of(displaced(fix, (200.0, 0.0, 0.0)) if k == lie_at else fix)
        z, index = aid.measurement(None), samples.first_after(lead.t_ns)
        assert z is not None
        lead.propagate(samples, index, aid.t_ns)
        if k != lie_at:
            lead.update(innovation(lead, aid, z, np.zeros(3)))
        stretch = stretch.also(aid, z, np.zeros(3))
    return stretch, lead, samples


def _run(stretch: Stretch, found: Eskf, samples: ImuBuffer) -> tuple[Eskf, Stretch]:
    result = relinearise(stretch, found, samples)
    assert result is not None
    return result


def _sigma(found: Eskf) -> Array:
    return np.sqrt(np.diag(found.cov)[: E.SIZE])


def test_where_the_linear_filter_is_right_nothing_changes(simulation: Simulation) -> None:
    stretch, lead, samples = _flown(simulation)
    found, noted = _run(stretch, lead, samples)
    assert np.abs(local(lead.x, found.x) / _sigma(lead)).max() < 0.2
    np.testing.assert_allclose(_sigma(found), _sigma(lead), rtol=0.03)
    again, confirmed = _run(noted, found, samples)
    np.testing.assert_allclose(_sigma(again), _sigma(found), rtol=1e-3)  # the same information, not twice of it
    assert np.abs(local(again.x, found.x) / _sigma(found)).max() < 0.1
    assert (noted.moved_at, confirmed.moved_at, confirmed.run_at) == (len(stretch.taken), noted.moved_at, noted.run_at)


def test_the_answer_does_not_depend_on_what_the_filter_found(simulation: Simulation) -> None:
    stretch, lead, samples = _flown(simulation, off_rad=1.0)
    first, _ = _run(stretch, lead, samples)
    astray = lead.copy()
    astray.x[X.Q] = so3.multiply(astray.x[X.Q], so3.quat_exp(np.array([0.1, -0.1, 0.6])))
    second, _ = _run(stretch, astray, samples)
    assert np.abs(local(first.x, second.x) / _sigma(first)).max() < 0.1
    e = local(first.x, true_state(simulation.truth, first.t_ns)) if first.t_ns in simulation.truth.t_ns else None
    assert e is None or np.abs(e / _sigma(first)).max() < 4.0


def test_an_implausible_measurement_is_left_out(simulation: Simulation) -> None:
    stretch, lead, samples = _flown(simulation, lie_at=6)
    found, _ = _run(stretch, lead, samples)
    assert np.abs(local(lead.x, found.x) / _sigma(lead)).max() < 0.5


def test_the_stretch_is_settled_when_the_attitude_is_known_and_no_run_has_changed_it_for_long(simulation: Simulation) -> None:
    stretch, lead, samples = _flown(simulation)
    assert stretch.due(lead)
    _, noted = _run(stretch, lead, samples)
    assert not noted.is_confirmed
    assert not noted.is_settled
    taken = stretch.taken
    part = Stretch(stretch.t_ns, stretch.x, stretch.cov, stretch.slow, taken[:5], (stretch.x,), None, 4, 4)
    assert not part.is_confirmed
    confirmed = Stretch(stretch.t_ns, stretch.x, stretch.cov, stretch.slow, taken, (stretch.x,), np.full(9, 1e-3), 5, 4)
    assert confirmed.is_confirmed
    assert not confirmed.is_settled
    settled = Stretch(stretch.t_ns, stretch.x, stretch.cov, stretch.slow, taken, (stretch.x,), np.full(9, 1e-3), 8, 4)
    assert settled.is_settled


def test_a_stretch_does_not_grow_without_end(simulation: Simulation) -> None:
    stretch, _, _ = _flown(simulation)
    assert not stretch.is_long(stretch.t_ns + 100_000_000_000)
    assert stretch.is_long(stretch.t_ns + 121_000_000_000)


def test_what_no_measurement_of_the_stretch_carries_is_kept_and_follows_the_state(simulation: Simulation) -> None:
    """A wind estimated beside the state, half of whose error is that of the velocity."""
    stretch, lead, samples = _flown(simulation, off_rad=0.5)
    alone, _ = _run(stretch, lead, samples)
    lead.consider("wind", np.eye(2), np.inf, np.full(2, 1e-9))
    level, wind, own = slice(E.V.start, E.V.start + 2), lead.slow.columns["wind"], slice(0, E.SIZE)
    lead.cov[wind, own] = 0.5 * lead.cov[level, own]
    lead.cov[own, wind] = lead.cov[wind, own].T
    lead.cov[wind, wind] = 0.25 * lead.cov[level, level] + 0.01 * np.eye(2)
    lead.slow = lead.slow.moved(np.concatenate([np.zeros(wind.start - E.SIZE), [3.0, -2.0]]))
    found, _ = _run(stretch, lead, samples)
    np.testing.assert_allclose(found.x, alone.x)
    np.testing.assert_allclose(found.cov[own, own], alone.cov[own, own])
    np.testing.assert_allclose(found.slow.of("wind"), [3.0, -2.0] + 0.5 * local(lead.x, alone.x)[level], rtol=1e-6)
    at = found.slow.columns["wind"]
    np.testing.assert_allclose(found.cov[at, at], 0.25 * alone.cov[level, level] + 0.01 * np.eye(2), rtol=1e-6)
    assert np.linalg.eigvalsh(found.cov).min() > 0.0
