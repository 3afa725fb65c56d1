"""A run that was interrupted goes on from a Checkpoint."""

import numpy as np
import pytest
from msgspec.structs import asdict

from estimator.fusion import Fusion
from logs.wire.codec import Decoder, encode_input
from models.messages import Checkpoint, Estimate, ImuSample, Input, LastGnss, Mode, Reason
from models.sim.scenario import EPOCH_NS
from models.state import E, local
from tests.estimator.scenes import SECOND, Run, config_of, error, fly, same, simulated

FLIGHT = """
duration_s = 30.0
[imu]
rate_hz = 100.0
[gnss]
outages_s = [[18.0, 30.0]]
[pose_fix]
rate_hz = 1.0
outages_s = [[18.0, 30.0]]
"""
SIMULATION = simulated(FLIGHT)
CUT_NS = EPOCH_NS + 20 * SECOND


def _checkpoint(e: Estimate, last_gnss: LastGnss | None = None) -> Checkpoint:
    return Checkpoint(e.t_ns, e.t_ns, e.nav, e.covariance, e.last_absolute_ns, e.reset_counter, e.origin, last_gnss)


def _after(t_ns: int) -> list[Input]:
    return [m for m in SIMULATION.messages if m.arrived_ns > t_ns]


@pytest.fixture(scope="module")
def whole() -> Run:
    return fly(SIMULATION)


def _resumed(whole: Run, gap_s: float) -> Run:
    last = next(e for e in whole.estimates if e.t_ns >= CUT_NS)
    return Run(Fusion(config_of(SIMULATION))).feed([_checkpoint(last), *_after(CUT_NS + round(gap_s * 1e9))])


def test_without_a_gap_it_is_nearly_as_if_nothing_had_happened(whole: Run) -> None:
    e = _resumed(whole, 0.0).estimates[10]
    other = next(o for o in whole.estimates if o.t_ns == e.t_ns)
    sigma, wider = np.sqrt(np.diag(other.covariance)), np.sqrt(np.diag(e.covariance))
    assert (np.abs(local(other.nav, e.nav)) < 0.5 * sigma).all()
    assert (wider > 0.99 * sigma).all()
    assert (wider < np.hypot(sigma, 0.35) + 1e-9).all()  # of the first 10 ms only the end is known: they are coasted
    assert wider[E.P] == pytest.approx(sigma[E.P], rel=0.1)
    assert (e.mode, e.last_absolute_ns, e.reset_counter) == (other.mode, other.last_absolute_ns, other.reset_counter)


def test_the_gap_is_coasted_and_the_covariance_reports_it(whole: Run) -> None:
    run = _resumed(whole, 2.0)
    first = run.estimates[0]
    assert first.t_ns == CUT_NS + 2 * SECOND + SECOND // 100
    e = error(first, SIMULATION.truth)
    sigma = np.sqrt(np.diag(first.covariance))
    assert np.linalg.norm(e[E.P] / sigma[E.P]) < 4.0
    assert 1.0 < float(sigma[E.P].max()) < 20.0
    assert first.mode is Mode.DEAD_RECKONING


def test_through_the_wire_it_is_the_same_to_the_bit(whole: Run) -> None:
    last = next(e for e in whole.estimates if e.t_ns >= CUT_NS)
    checkpoint = _checkpoint(last, LastGnss(47.0, 8.0, 400.0, 3.5, 2.0))
    topic, schema, data = encode_input(checkpoint)
    read = Decoder().decode(topic, schema, data, checkpoint.arrived_ns)
    assert isinstance(read, Checkpoint)
    assert read.last_gnss is not None
    assert asdict(read.last_gnss) == {"lat_deg": 47.0, "lon_deg": 8.0, "alt_m": 400.0, "age_s": 3.5, "sigma_m": 2.0}
    direct = Run(Fusion(config_of(SIMULATION))).feed([checkpoint, *_after(CUT_NS + SECOND)])
    wired = Run(Fusion(config_of(SIMULATION))).feed([read, *_after(CUT_NS + SECOND)])
    assert all(same(a, b) for a, b in zip(direct.estimates, wired.estimates, strict=True))
    assert direct.health[0].last_gnss is not None
    assert wired.health[0].last_gnss is not None
    assert asdict(direct.health[0].last_gnss) == asdict(wired.health[0].last_gnss)
    assert direct.health[0].last_gnss.age_s == pytest.approx(4.5, abs=0.05)


def test_it_is_refused_once_the_estimate_has_begun(whole: Run) -> None:
    sample = next(m for m in SIMULATION.messages if isinstance(m, ImuSample))
    run = Run(Fusion(config_of(SIMULATION))).feed([sample, _checkpoint(whole.estimates[-1])])
    assert [s.reason for s in run.statuses] == [Reason.TOO_OLD]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"nav": np.full(16, np.nan)}, Reason.NOT_FINITE),
        ({"nav": np.r_[1.7e15, np.zeros(5), 1.0, np.zeros(9)]}, Reason.IMPLAUSIBLE),
        ({"nav": np.r_[np.zeros(6), 1.0, np.zeros(3), 1e15, np.zeros(5)]}, Reason.IMPLAUSIBLE),
        ({"nav": np.zeros(16)}, Reason.IMPLAUSIBLE),
        ({"covariance": np.eye(15) + 2.0 * np.eye(15)[::-1]}, Reason.NOT_PSD),
        ({"covariance": np.eye(15) + np.eye(15, k=9)}, Reason.NOT_PSD),
        ({"covariance": np.eye(15) * 1e40}, Reason.NOT_FINITE),
        ({"last_gnss": LastGnss(47.0, 8.0, 400.0, np.inf, 2.0)}, Reason.IMPLAUSIBLE),
        ({"origin": (np.nan, 2.0, 3.0)}, Reason.IMPLAUSIBLE),
        ({"origin": (1.0, 2.0, 3.0)}, Reason.NO_ORIGIN),
        ({"nav": None}, Reason.MALFORMED),
        ({"covariance": None}, Reason.MALFORMED),
        ({"covariance": np.eye(6)}, Reason.MALFORMED),
        ({"last_gnss": np.zeros(3)}, Reason.MALFORMED),
    ],
)
def test_nonsense_and_another_map_are_refused(whole: Run, change: dict[str, object], reason: Reason) -> None:
    good = _checkpoint(whole.estimates[-1])
    bad = Checkpoint(**{name: getattr(good, name) for name in good.__struct_fields__} | change)
    run = Run(Fusion(config_of(SIMULATION))).feed([bad])
    assert [s.reason for s in run.statuses] == [reason]


def test_samples_from_before_it_are_too_old_and_do_no_harm(whole: Run) -> None:
    last = next(e for e in whole.estimates if e.t_ns >= CUT_NS)
    run = Run(Fusion(config_of(SIMULATION))).feed([_checkpoint(last), *_after(CUT_NS - SECOND)])
    assert not run.internal_errors()
    assert {s.reason for s in run.statuses if s.kind == "ImuSample"} == {Reason.TOO_OLD}
    assert run.estimates[0].t_ns > last.t_ns
