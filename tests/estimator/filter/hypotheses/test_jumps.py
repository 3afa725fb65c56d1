"""Fixes that jump away from their earlier ones for good, and fixes and a receiver of which neither follows the estimate."""

import numpy as np
import pytest
from msgspec.structs import replace

from models.messages import Array, PoseFix, Vec3, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E
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
    """An omitted receiver is judged again once the fixes are refused, too."""
    _, errors, _ = _flown(simulated(WITH_GNSS, seed=3), EPOCH_NS + 99 * SECOND, (10.0, 0.0, 0.0), swing_rad_s=0.3)
    assert errors[-250:].max() < 12.0
