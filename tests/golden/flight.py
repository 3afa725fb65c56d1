"""The golden trajectory: what the estimator makes of one simulated flight, as text that `git diff` can read.

    python -m tests.golden.flight        writes it anew; look at the difference before you commit it

GNSS until 8 s, fixes once a second and 0.3 s late, one lie at 14 s, nothing from 16 s to 22 s. Six decimals: other processors
round the last bits of a double differently, and that is 1e-9 of them away.
"""

from pathlib import Path

import numpy as np

from models import so3
from models.messages import Estimate
from models.sim.scenario import EPOCH_NS
from models.state import E, X
from tests.estimator.scenes import SECOND, fly, simulated

PATH = Path(__file__).with_name("trajectory.txt")
REFRESH = "python -m tests.golden.flight"
_SCENARIO = """
duration_s = 25.0
[vehicle]
kind = "multirotor"
seed = 11
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 2.0
outages_s = [[8.0, 25.0]]
[pose_fix]
rate_hz = 1.0
delay_s = 0.3
outages_s = [[16.0, 22.0]]
false_spans = [{ start_s = 13.5, end_s = 14.5, offset_n_m = [3.0, -2.0, 0.5] }]
"""
_HEAD = f"# {REFRESH}\n# t_s  p_n[3] m  v_n[3] m/s  roll pitch yaw rad  sigma_p[3] m  sigma_theta[3] rad\n"


def text() -> str:
    """The trajectory at every half second since 3 s."""
    estimates = {e.t_ns: e for e in fly(simulated(_SCENARIO, seed=7)).estimates}
    return _HEAD + "".join(_row(estimates[t]) for t in range(EPOCH_NS + 3 * SECOND, EPOCH_NS + 25 * SECOND, SECOND // 2))


def _row(e: Estimate) -> str:
    sigma = np.sqrt(np.diag(e.covariance))
    numbers = [*e.nav[X.P], *e.nav[X.V], *so3.to_euler(e.nav[X.Q]), *sigma[E.P], *sigma[E.THETA]]
    return f"{(e.t_ns - EPOCH_NS) / SECOND:4.1f} " + " ".join(f"{n:.6f}" for n in numbers) + "\n"


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
