"""Two recorded flights with a barometer: in one it is metres off and GNSS is right, in the other GNSS is a hundred metres off."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.flights import gnss
from models.messages import Reading, Reason


@pytest.fixture(autouse=True)
def _data(landfix_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANDFIX_DATA", str(landfix_data))


def test_a_barometer_in_the_wind_does_not_lock_out_a_good_receiver(tmp_path: Path) -> None:
    """A fixed wing: speed and attitude move the pressure at its port by metres."""
    recording, config = gnss.flight(gnss.FLIGHTS["thor75"], tmp_path)
    _, statuses = gnss.run(gnss.inputs(recording), config)
    last = {s.t_ns: s.reason for s in statuses if s.kind == "gnss_position"}
    reasons = [last[t] for t in sorted(last) if last[t] is not Reason.ALIGNING]
    assert len(reasons) > 450
    assert reasons.count(Reason.GATED) <= 0.01 * len(reasons)


@pytest.mark.long
def test_a_receiver_that_walks_off_does_not_outvote_the_barometer(tmp_path: Path) -> None:
    recording, config = gnss.flight(gnss.GLITCH, tmp_path)
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
