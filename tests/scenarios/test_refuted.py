"""A sensor that positions have refuted is not used in the dark, where the covariance grows until anything passes the gate."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.fusion import Fusion, FusionConfig
from estimator.sources.beacon import BeaconConfig
from estimator.sources.rest import RestConfig
from models import so3
from models.messages import Array, AttitudePrior, ImuSample, Input, Reason
from models.sim.beacons import Beacons, measure_ranges
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, loops, ride

CONFIG = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla)
BEACONS = Beacons()
FAULT_S, DARK_S, END_S = 22.0, 40.0, 65.0


def _seconds(t_ns: int) -> float:
    return (t_ns - EPOCH_NS) * 1e-9


def _dark(messages: list[Input], dark_s: float = DARK_S) -> list[Input]:
    return [m for m in messages if isinstance(m, ImuSample) or _seconds(m.t_ns) < dark_s]


def _overconfident(run: Run, journey: Ride, begin_s: float) -> float:
    """Share of the time that the position is beyond three times its 95 % radius."""
    beyond = []
    for e in within(run.aligned, begin_s, END_S, every=10):
        radius = math.sqrt(7.815 * float(np.linalg.eigvalsh(e.covariance[E.P, E.P])[-1]))
        beyond.append(np.linalg.norm(error(e, journey.truth)[E.P]) > 3.0 * radius)
    return float(np.mean(beyond))


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(5.0, END_S - 5.0, seed=1, imu=Imu(grade="hobby", rate_hz=50.0))


def test_given_beacons_that_go_wrong_together_then_the_dark_is_bridged_by_the_imu(journey: Ride) -> None:
    """Followed, they lead it 13 m off, with overconfidence for a fifth of the time."""
    t = journey.truth
    ranges = measure_ranges(BEACONS, t.t_ns, EPOCH_NS, t.p_n, t.R_nb, np.random.default_rng(51))
    wrong: list[Input] = [replace(r, values=(r.values[0] + 5.0 * (_seconds(r.t_ns) > FAULT_S),)) for r in ranges]
    config = replace(CONFIG, beacon=BeaconConfig(at_n_m=BEACONS.at_n_m))
    run = Run(Fusion(config)).feed(by_arrival([*_dark(journey.messages), *wrong]))
    assert run.internal_errors() == []
    assert _overconfident(run, journey, FAULT_S) == 0.0
    dark = [s for s in run.last_words("/beacon/1").values() if _seconds(s.t_ns) > DARK_S + 6.0]
    assert {s.reason for s in dark} <= {Reason.STOPPED, Reason.GATED, Reason.THINNED}


@pytest.mark.long
def test_given_beacons_that_were_wrong_for_a_moment_then_they_are_used_in_the_dark(journey: Ride) -> None:
    t = journey.truth
    ranges = measure_ranges(BEACONS, t.t_ns, EPOCH_NS, t.p_n, t.R_nb, np.random.default_rng(51))
    wrong: list[Input] = [replace(r, values=(r.values[0] + 5.0 * (FAULT_S < _seconds(r.t_ns) < FAULT_S + 2.0),)) for r in ranges]
    config = replace(CONFIG, beacon=BeaconConfig(at_n_m=BEACONS.at_n_m))
    run = Run(Fusion(config)).feed(by_arrival([*_dark(journey.messages), *wrong]))
    assert np.linalg.norm(error(within(run.aligned, END_S - 1.0, END_S)[-1], t)[E.P]) < 2.0


@pytest.mark.long
def test_given_a_raft_that_drifts_then_it_is_not_taken_for_resting_with_gnss_or_later_without() -> None:
    def path(t: Array) -> Array:
        drift = np.column_stack([0.3 * np.maximum(t - 25.0, 0.0), np.zeros((len(t), 3))])
        return loops(np.minimum(t, 25.0)) + drift

    adrift = ride(2.0, 88.0, seed=1, path=path, imu=Imu(grade="hobby", rate_hz=50.0))
    run = Run(Fusion(replace(CONFIG, rest=RestConfig(enabled=True)))).feed(_dark(adrift.messages, 42.0))
    words = [s for s in run.last_words("rest").values() if _seconds(s.t_ns) > 29.0]
    assert Reason.FUSED not in {s.reason for s in words}
    assert any("but moves at 0." in s.detail for s in words)
    assert _overconfident(run, adrift, 29.0) == 0.0  # up to 65 s; taken for resting in the dark: 76 % of the time


def test_given_an_attitude_of_the_autopilot_a_quarter_turn_off_then_motion_refutes_it(journey: Ride) -> None:
    """Believed, it leads the estimate 88 m off in the dark."""
    sigma = np.radians([2.0, 2.0, 4.0])
    turn = so3.from_euler(0.0, 0.0, 0.5 * math.pi)
    priors: list[Input] = []
    for k in range(25, len(journey.truth.t_ns), 25):
        w, x, y, z = so3.multiply(turn, journey.truth.q_nb_wxyz[k]).tolist()
        t = int(journey.truth.t_ns[k])
        priors.append(AttitudePrior(t, t, (w, x, y, z), np.diag(sigma**2)))
    run = Run(Fusion(CONFIG)).feed(by_arrival([*_dark(journey.messages), *priors]))
    assert Reason.STOPPED in run.reasons("/attitude")
    moving = within(run.aligned, 15.0, DARK_S)
    assert np.degrees(max(np.linalg.norm(error(e, journey.truth)[E.THETA]) for e in moving)) < 3.0
    assert np.linalg.norm(error(within(run.aligned, END_S - 1.0, END_S)[-1], journey.truth)[E.P]) < 20.0
