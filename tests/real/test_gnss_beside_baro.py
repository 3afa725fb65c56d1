"""Two recorded flights with a barometer: in one it is metres off and GNSS is right, in the other GNSS is a hundred metres off."""

from pathlib import Path

import numpy as np
import pytest

from models.messages import Reading, Reason
from tests.real import gnss_flights as gnss


def test_a_barometer_in_the_wind_does_not_lock_out_a_good_receiver(landfix_data: Path, tmp_path: Path) -> None:
    """A fixed wing: speed and attitude move the pressure at its port by metres."""
    recording, config = gnss.flight(landfix_data, gnss.THOR75, tmp_path)
    _, statuses = gnss.run(gnss.inputs(recording), config)
    last = {s.t_ns: s.reason for s in statuses if s.kind == "gnss_position"}
    reasons = [last[t] for t in sorted(last) if last[t] is not Reason.ALIGNING]
    assert len(reasons) > 450
    assert reasons.count(Reason.GATED) <= 0.01 * len(reasons)


@pytest.mark.long
def test_a_receiver_that_walks_off_does_not_outvote_the_barometer(landfix_data: Path, tmp_path: Path) -> None:
    recording, config = gnss.flight(landfix_data, gnss.GLITCH, tmp_path)
    messages = gnss.inputs(recording)
    start_ns = messages[0].t_ns
    track, _ = gnss.run(messages, config)
    baro = [
        m for m in messages if isinstance(m, Reading) and m.kind == "baro" and (m.t_ns - start_ns) * 1e-9 > gnss.GLITCH_S - 30.0
    ]
    height = 44330.8 * (1.0 - (np.array([m.values[0] for m in baro]) / 101325.0) ** 0.190263)
    row = np.searchsorted(track.t_ns, [m.t_ns for m in baro]).clip(max=len(track.t_ns) - 1)
    t_s = (np.array([m.t_ns for m in baro]) - start_ns) * 1e-9
    error = -track.p_n[row, 2] - height
    error -= np.median(error[t_s < gnss.GLITCH_S])
    sigma = np.sqrt(track.covariance[row, 2, 2])
    assert np.abs(error).max() < 25.0
    assert np.abs(error[sigma < 3.0]).max() < 12.0
