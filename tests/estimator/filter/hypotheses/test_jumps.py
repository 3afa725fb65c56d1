"""Fixes that jump away from their earlier ones for good, and fixes and a receiver of which neither follows the estimate."""

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Hypothesis
from models.imu import Coast, ImuNoise, constants
from models.messages import Array, PoseFix, Vec3, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests.estimator.scenes import SECOND, Run, fly, position_errors, simulated

JUMPS_NS = EPOCH_NS + 20 * SECOND
ALONE = "duration_s = 40.0\n[imu]\nrate_hz = 50.0\n[pose_fix]\nrate_hz = 2.0\n"
WITH_GNSS = "duration_s = 60.0\n[imu]\nrate_hz = 50.0\n[gnss]\n[pose_fix]\nrate_hz = 2.0\n"


def _flown(simulation: Simulation, until_ns: int, off: Vec3, swing_rad_s: float = 0.0) -> tuple[Run, Array, Array]:
    """The flight with its fixes off by `off` (3,) [m] until until_ns, times the sine of a swing; errors and sigmas [m]."""

    def moved(m: PoseFix) -> PoseFix:
        s = (m.t_ns - JUMPS_NS) * 1e-9
        return replace(m, p_n=vec3(np.add(m.p_n, np.multiply(off, np.sin(swing_rad_s * s) if swing_rad_s else 1.0))))

    messages = [moved(m) if isinstance(m, PoseFix) and JUMPS_NS <= m.t_ns < until_ns else m for m in simulation.messages]
    run = fly(simulation, messages=messages)
    sigma = np.array([np.sqrt(e.covariance[E.P, E.P].trace()) for e in run.estimates])
    return run, position_errors(run.estimates, simulation.truth), sigma


def _hypothesis(fused_s: float) -> Hypothesis:
    """At the origin with sigma 0.1 m, after a run of fixes from 0 s to fused_s."""
    x = np.zeros(X.SIZE)
    x[X.Q.start] = 1.0
    eskf = Eskf(EPOCH_NS, x, 0.01 * np.eye(E.SIZE), constants(ImuNoise(), Coast(), None))
    return Hypothesis(eskf, fused_ns=EPOCH_NS + round(fused_s * SECOND), run=9, run_ns=EPOCH_NS)


@pytest.mark.parametrize(
    ("off_m", "after_s", "is_noted"), [(5.0, 2.0, True), (0.3, 2.0, False), (5.0, 11.0, False), (20.0, 11.0, True)]
)
def test_a_jump_is_one_that_neither_the_covariance_nor_dead_reckoning_explains(
    off_m: float, after_s: float, is_noted: bool
) -> None:
    hypothesis = _hypothesis(20.0)
    hypothesis.note_jump(np.array([off_m, 0.0, 0.0]), EPOCH_NS + round((20.0 + after_s) * SECOND))
    assert (hypothesis.past is not None) == is_noted


def test_the_older_run_fades_with_the_duration_of_the_newer_one() -> None:
    hypothesis = _hypothesis(20.0)
    hypothesis.note_jump(np.array([5.0, 0.0, 0.0]), EPOCH_NS + 21 * SECOND)
    assert hypothesis.past is not None
    assert hypothesis.past.added(EPOCH_NS + 41 * SECOND)[0, 0] == pytest.approx(2.5**2)  # half of the time, half of the way
    hypothesis.note_fused(EPOCH_NS + 200 * SECOND)
    assert hypothesis.past is not None
    hypothesis.note_fused(EPOCH_NS + 202 * SECOND)
    assert hypothesis.past is None


@pytest.fixture(scope="module")
def alone() -> Simulation:
    return simulated(ALONE, seed=3)


@pytest.mark.parametrize("off", [(0.0, 0.0, 10.0), (3.0, 2.0, 0.0)])
def test_a_jump_for_good_stays_in_the_covariance(alone: Simulation, off: Vec3) -> None:
    """No IMU explains it, and nothing says which of the two runs of fixes is right."""
    _, errors, sigma = _flown(alone, EPOCH_NS + 99 * SECOND, off)
    assert errors[-200:].mean() > 0.5 * np.linalg.norm(off)  # the newer run is followed
    assert (errors > 3.0 * sigma).mean() < 0.01


def test_a_short_run_is_soon_forgotten(alone: Simulation) -> None:
    _, errors, sigma = _flown(alone, JUMPS_NS + 8 * SECOND, (6.0, 8.0, 0.0))
    assert errors[-200:].max() < 1.0
    assert sigma[-50:].max() < 5.0


def test_a_true_receiver_leads_again_where_fixes_never_agree() -> None:
    """Fixes that swing by 10 m contradict the IMU and one another: the receiver is not left out for them."""
    _, errors, _ = _flown(simulated(WITH_GNSS, seed=3), EPOCH_NS + 99 * SECOND, (10.0, 0.0, 0.0), swing_rad_s=0.3)
    assert errors[-250:].max() < 12.0


def test_one_fix_after_an_outage_proves_no_imu() -> None:
    """Nor do those of the first seconds; before any run the first fix does."""
    one = _hypothesis(0.0)
    one.run = 0
    for k in range(13):  # 6 s at 2 Hz
        one.note_fused(EPOCH_NS + k * SECOND // 2)
        assert one.unproven_s(EPOCH_NS + k * SECOND // 2) == 0.0
    for t_s in (16.0, 18.0):
        one.note_fused(EPOCH_NS + round(t_s * SECOND))
        assert one.unproven_s(EPOCH_NS + round(t_s * SECOND)) == pytest.approx(t_s - 6.0)
    one.note_fused(EPOCH_NS + 20 * SECOND)
    assert one.unproven_s(EPOCH_NS + 20 * SECOND) == 0.0
