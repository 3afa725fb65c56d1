"""How far an odometry may drift, as its increments show it: the velocity d that the filter considers."""

import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Hypotheses, Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relative import drift, steps
from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.odometry import DRIFT_M_S, OdometryAid, OdometryConfig, drift_block
from models import imu
from models.imu import Coast, ImuNoise
from models.messages import ImuSample, OdometryDelta, Reason
from models.state import E, X

SECOND = 10**9
TOPIC, HALF = "/odometry", SECOND // 2
BLOCK = drift_block(TOPIC)
ACTIVE = SourceState(Phase.ACTIVE, silent_ns=2**62)
ANY = DRIFT_M_S * np.sqrt(3.0)


def _flying() -> tuple[Eskf, ImuBuffer]:
    """North at 2 m/s, the velocity known to 2 cm/s, the body turned to the east."""
    x = np.zeros(X.SIZE)
    x[X.Q], x[X.V] = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], [2.0, 0.0, 0.0]
    cov = np.diag([0.5**2] * 3 + [0.02**2] * 3 + [0.01**2] * 3 + [1e-4**2] * 3 + [1e-2**2] * 3)
    samples = ImuBuffer()
    for t in range(0, 60 * SECOND, SECOND // 100):
        samples.insert(ImuSample(t, t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
    return Eskf(0, x, cov, imu.constants(ImuNoise(), Coast(), None)), samples


def _step(f: Eskf, samples: ImuBuffer, rate: float, *, alone: bool = True, given: tuple[int, ...] = (0, 1, 2, 3, 4, 5)) -> Reason:
    """Half a second's increment of an odometry that drifts to the north at this rate: what became of it."""
    t_ns, bank = f.t_ns, Hypotheses([Hypothesis(f)])
    variances = np.full(6, 1e6)
    variances[list(given)] = np.array([1e-4] * 3 + [1e-6] * 3)[list(given)]
    delta = OdometryDelta(
        t_ns + HALF, t_ns + HALF, t_ns, (0.0, -0.5 * (2.0 + rate), 0.0), (1.0, 0.0, 0.0, 0.0), np.diag(variances), topic=TOPIC
    )
    config = OdometryConfig(scale_sigma=0.0, lasting_share=0.0, attitude_sigma_deg=0.1)
    end = aid_of(delta, SourcesConfig(odometry=config))
    assert isinstance(end, OdometryAid)
    assert isinstance(end.begin, OdometryAid)
    kept = steps.take(bank, end.begin, None, ACTIVE, alone=alone).kept
    f.propagate(samples, samples.first_after(t_ns), end.t_ns)
    return steps.take(bank, end, kept, ACTIVE, alone=alone).reason


def test_the_increment_in_which_a_drift_begins_passes_the_gate_and_widens_what_it_may_be() -> None:
    f, samples = _flying()
    assert _step(f, samples, 0.0) is Reason.FUSED
    at = f.slow.columns[BLOCK]
    before = np.sqrt(f.cov[at, at].diagonal())
    assert _step(f, samples, 0.26) is Reason.FUSED
    after = np.sqrt(f.cov[at, at].diagonal())
    more = after**2 - before**2
    assert more[0] > 1.2 * more[1:].max()  # to the north, which is on the body's left


def test_a_drift_that_changes_the_velocity_no_more_than_increments_do_is_within_what_is_considered() -> None:
    wide = {}
    for sigma_m_s in (0.02, 0.2):
        f, samples = _flying()
        f.cov[E.V, E.V] = np.eye(3) * sigma_m_s**2
        assert _step(f, samples, 0.0) is Reason.FUSED
        wide[sigma_m_s] = drift.sigma_m_s(f, BLOCK) / np.sqrt(3.0)
    assert wide[0.02] < 0.05
    assert 0.08 < wide[0.2] < 0.11


def test_where_positions_come_it_fades_and_alone_it_stays() -> None:
    wide = {}
    for alone in (True, False):
        f, samples = _flying()
        for k in range(40):
            f.cov[E.V, E.V] += np.eye(3) * 0.02**2
            assert _step(f, samples, 0.0, alone=alone) is Reason.FUSED
            if k == 0:
                at = f.slow.columns[BLOCK]
                f.cov[at, at] += np.eye(3) * 0.2**2
        wide[alone] = drift.sigma_m_s(f, BLOCK)
    assert wide[True] > 0.2
    assert wide[False] < 0.1


def test_rotations_alone_say_nothing_of_it() -> None:
    f, samples = _flying()
    assert _step(f, samples, 5.0, given=(3, 4, 5)) is Reason.FUSED
    assert drift.sigma_m_s(f, BLOCK) == pytest.approx(ANY, rel=0.02)
    assert _step(f, samples, 0.26, given=(1, 5)) is Reason.FUSED  # the left row of wheels
    assert drift.sigma_m_s(f, BLOCK) > 1.9 * ANY
