"""An attitude estimated by an autopilot: it begins the alignment, and is never fused."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from estimator.config import parse
from estimator.filter.alignment.initialise import InitialiseConfig, agrees, start_from_pose
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.aids import aid_of
from estimator.sources.base.aid import Aid, Refusal
from logs.importers import dataflash
from logs.importers.recording import Truth
from models import so3
from models.frames import GRAVITY, Origin
from models.imu import Coast, ImuNoise, constants
from models.measurements import Pose
from models.messages import AttitudePrior, GnssFix, ImuSample, Input, Reading, Reason, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests.estimator.scenes import SECOND, Run, by_arrival, error, fly, same, simulated

TILT, HEADING = math.radians(2.0), math.radians(4.0)
CONFIG, CONSTANTS = InitialiseConfig(), constants(ImuNoise(), Coast(), None)
NOISE = np.diag([TILT**2, TILT**2, HEADING**2])
TOML = 'duration_s = 12.0\n[vehicle]\nkind = "multirotor"\n[imu]\nrate_hz = 100.0\n[gnss]\nrate_hz = 5.0\n'


@cache
def _simulation(seed: int = 1) -> Simulation:
    return simulated(TOML, seed)


def _prior(simulation: Simulation, k: int, off_n: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> AttitudePrior:
    """The truth, k half seconds on, turned by off_n [rad] about the axes of n."""
    truth = simulation.truth
    at = int(np.searchsorted(truth.t_ns, EPOCH_NS + k * SECOND // 2))
    w, x, y, z = so3.multiply(so3.quat_exp(np.array(off_n)), so3.from_matrix(truth.R_nb[at])).tolist()
    return AttitudePrior(int(truth.t_ns[at]), int(truth.t_ns[at]), (w, x, y, z), NOISE)


def _flown(priors: list[AttitudePrior], seed: int = 1) -> Run:
    simulation = _simulation(seed)
    return fly(simulation, messages=by_arrival([*simulation.messages, *priors]))


def _drawn(seed: int) -> tuple[float, float, float]:
    """An error as large as it says; the same in every message, as an autopilot's is."""
    return vec3(np.random.default_rng(seed).normal(size=3) * [TILT, TILT, HEADING])


def test_with_it_the_estimate_begins_at_once_and_is_consistent() -> None:
    """GIVEN a hover in which GNSS does not show the heading; THEN it begins after 3 s, with NEES / 15 about 1."""
    assert not any(e.t_ns < EPOCH_NS + 6 * SECOND for e in _flown([]).aligned)
    nees = []
    for seed in range(1, 6):
        simulation = _simulation(seed)
        run = _flown([_prior(simulation, k, _drawn(seed)) for k in range(24)], seed)
        first = run.aligned[0]
        assert first.t_ns < EPOCH_NS + 3 * SECOND
        off = error(first, simulation.truth)
        nees.append(off @ np.linalg.solve(first.covariance, off) / E.SIZE)
        assert not run.internal_errors()
        assert "/attitude" not in run.health[-1].sources
    assert 0.4 < np.mean(nees) < 2.2


def test_once_it_has_begun_no_prior_changes_a_bit() -> None:
    simulation = _simulation()
    true = _flown([_prior(simulation, k) for k in range(24)])
    false = _flown([_prior(simulation, k, (0.0, 0.0, 0.0) if k < 6 else (1.0, -0.5, 2.0)) for k in range(24)])
    assert len(true.estimates) == len(false.estimates) > 900
    assert all(same(a, b) for a, b in zip(true.estimates, false.estimates, strict=True))
    reasons = true.reasons("/attitude")
    assert set(reasons) == {Reason.ALIGNING, Reason.THINNED}
    assert reasons[Reason.THINNED] > 15


def test_a_late_prior_leads_where_a_punctual_one_does() -> None:
    priors = [_prior(_simulation(), k) for k in range(24)]
    late = [AttitudePrior(p.t_ns, p.arrived_ns + SECOND // 2, p.q_nb_wxyz, p.covariance) for p in priors]
    assert same(_flown(priors).estimates[-1], _flown(late).estimates[-1])


def test_a_real_flight_begins_with_its_first_position(landfix_data: Path) -> None:
    """A copter that stands: without prior and magnetometer its heading shows a minute after the first fix, in the air."""
    recording = dataflash.read(landfix_data / "native_logs/ardupilot_log171.bin")
    text = recording.settings.toml("dataflash", Path("log.bin"), tuple(s.topic for s in recording.streams))
    config = parse(text)
    assert config.inputs.attitude == ("/attitude",)
    everything = [m for m in recording if not isinstance(m, Truth)]
    messages = [m for m in everything if not (isinstance(m, Reading) and m.kind == "magnetometer")]
    first_fix = next(m for m in messages if isinstance(m, GnssFix) and m.status >= 0)
    run = Run(Fusion(config.fusion())).feed(m for m in messages if m.arrived_ns < first_fix.arrived_ns + 10 * SECOND)
    assert 0 < run.aligned[0].t_ns - first_fix.t_ns < 3 * SECOND
    without = Run(Fusion(config.fusion())).feed(
        m for m in messages if m.arrived_ns < first_fix.arrived_ns + 10 * SECOND and not isinstance(m, AttitudePrior)
    )
    assert not without.aligned
    by_field = Run(Fusion(config.fusion())).feed(
        m for m in everything if m.arrived_ns < first_fix.arrived_ns + 10 * SECOND and not isinstance(m, AttitudePrior)
    )
    assert 0 < by_field.aligned[0].t_ns - first_fix.t_ns < 3 * SECOND
    assert by_field.reasons("/mag")[Reason.FUSED] > 5


def _without_motion(rate: float, duration_s: float = 6.0) -> list[Input]:
    """Level, on the spot, turning at `rate` [rad/s] from north at EPOCH_NS on, shaken: GNSS shows no heading."""
    rng, origin = np.random.default_rng(0), Origin(46.0, 7.0, 500.0)
    messages = list[Input]()
    for k in range(round(duration_s * 100)):
        t = EPOCH_NS + k * SECOND // 100
        gyro = np.array([0.0, 0.0, rate]) + rng.normal(scale=0.05, size=3)
        messages.append(ImuSample(t, t, vec3(gyro), (0.0, 0.0, -GRAVITY)))
        if k % 20 == 10:
            place = origin.to_geodetic(rng.normal(scale=0.5, size=3))
            messages.append(GnssFix(t + 1, t + 1, *place, np.eye(3) * 0.25))
    return messages


def _sent(t_s: float, heading: float) -> AttitudePrior:
    t = EPOCH_NS + round(t_s * SECOND) + 3
    w, x, y, z = so3.from_euler(0.0, 0.0, heading).tolist()
    return AttitudePrior(t, t, (w, x, y, z), NOISE)


def test_a_prior_is_turned_on_by_the_gyroscope_until_it_is_used() -> None:
    rate = 0.7
    messages = [m for m in _without_motion(rate) if not (isinstance(m, GnssFix) and m.t_ns < EPOCH_NS + 2.5 * SECOND)]
    run = Run(Fusion(FusionConfig())).feed(by_arrival([*messages, _sent(1.0, rate * 1.0)]))
    first = run.aligned[0]
    assert first.t_ns > EPOCH_NS + 2.5 * SECOND  # the prior was 1.5 s old, and 60 degrees off by then
    off = so3.to_euler(first.nav[X.Q])[2] - rate * (first.t_ns - EPOCH_NS) * 1e-9
    assert abs(math.remainder(off, 2.0 * math.pi)) < math.radians(4.0)


def test_a_prior_that_comes_during_the_search_ends_it() -> None:
    """GNSS alone has begun with eight headings; an autopilot that speaks up two seconds later is heard."""
    messages = _without_motion(0.0)
    assert not Run(Fusion(FusionConfig())).feed(messages).aligned
    run = Run(Fusion(FusionConfig())).feed(by_arrival([*messages, *(_sent(3.0 + 0.1 * k, 2.0) for k in range(20))]))
    assert EPOCH_NS + 3 * SECOND < run.aligned[0].t_ns < EPOCH_NS + 5 * SECOND
    assert abs(so3.to_euler(run.aligned[0].nav[X.Q])[2] - 2.0) < math.radians(4.0)
    assert run.reasons("/attitude")[Reason.THINNED] > 5  # once it has begun, it changes nothing


def test_a_prior_that_the_search_has_ruled_out_changes_nothing() -> None:
    """A fixed wing has shown its heading to 7 degrees when an autopilot says the opposite."""
    simulation = simulated(TOML.replace("multirotor", "fixed_wing").replace("12.0", "20.0"), 1)
    opposite = [_prior(simulation, k, (0.0, 0.0, math.pi)) for k in range(12, 39)]
    alone, lied_to = fly(simulation), fly(simulation, messages=by_arrival([*simulation.messages, *opposite]))
    assert len(alone.aligned) == len(lied_to.aligned) > 50
    assert all(same(a, b) for a, b in zip(alone.aligned, lied_to.aligned, strict=True))


def test_the_odds_of_a_heading_count_where_a_prior_agrees_with_it() -> None:
    fix = Pose(np.zeros(3), so3.from_euler(0.0, 0.0, 1.0), np.eye(6) * 0.01, np.arange(6))
    bank = start_from_pose(EPOCH_NS, fix, CONSTANTS, CONFIG)
    for heading, weight, expected in ((1.0, 0.0, True), (1.3, 0.0, True), (-2.0, 0.0, False), (1.3, -10.0, False)):
        bank.members[0].weight = weight
        assert agrees(bank, Pose(np.zeros(3), so3.from_euler(0.0, 0.0, heading), NOISE, np.arange(6))) is expected


@pytest.mark.parametrize("off_n", [(1.5, 0.0, 0.0), (0.0, -1.5, 0.0)])
def test_one_against_gravity_is_not_begun_with(off_n: tuple[float, float, float]) -> None:
    run = _flown([_prior(_simulation(), k, off_n) for k in range(24)])
    assert not any(e.t_ns < EPOCH_NS + 6 * SECOND for e in run.aligned)
    assert not run.internal_errors()


def test_one_of_long_ago_is_not_begun_with() -> None:
    sent = _prior(_simulation(), 0)
    stale = AttitudePrior(EPOCH_NS - 2 * SECOND, EPOCH_NS, sent.q_nb_wxyz, sent.covariance)
    assert not any(e.t_ns < EPOCH_NS + 6 * SECOND for e in _flown([stale]).aligned)


def test_it_starts_with_its_covariance_about_the_bodys_axes() -> None:
    run = _flown([_prior(_simulation(), k) for k in range(24)])
    first = run.aligned[0]
    r_nb = so3.matrix(first.nav[X.Q])
    sigma = np.sqrt(np.diag(r_nb @ first.covariance[E.THETA, E.THETA] @ r_nb.T))
    drift = InitialiseConfig().gyro_bias_sigma * 1.0  # rad: of the first second, until it has proved itself
    assert 0.5 * HEADING < sigma[2] < 1.1 * math.hypot(HEADING, drift)
    assert (sigma[:2] < 1.1 * TILT).all()


@pytest.mark.parametrize(
    ("prior", "reason"),
    [
        (AttitudePrior(1, 1, (1.0, 0.0, 0.0, 0.0), np.diag([1e-3, 1e-3, 100.0])), Reason.UNSUPPORTED),
        (AttitudePrior(1, 1, (1.0, 0.0, 0.0, 0.0), np.zeros((3, 3))), Reason.UNSUPPORTED),
        (AttitudePrior(1, 1, (math.nan, 0.0, 0.0, 0.0), NOISE), Reason.NOT_FINITE),
        (AttitudePrior(1, 1, (2.0, 0.0, 0.0, 0.0), NOISE), Reason.IMPLAUSIBLE),
    ],
)
def test_what_is_no_attitude_is_refused_with_its_reason(prior: AttitudePrior, reason: Reason) -> None:
    refusal = aid_of(prior, FusionConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


def test_it_is_no_absolute_source() -> None:
    aid = aid_of(_prior(_simulation(), 3), FusionConfig())
    assert isinstance(aid, Aid)
    assert (aid.kind, aid.absolute, aid.alignment_only, aid.slow_errors) == ("attitude", False, True, ())


def test_a_prior_that_a_gap_of_the_imu_has_blurred_before_the_alignment_gives_way_to_the_next_one() -> None:
    """Otherwise a vehicle at rest waits for its heading for ever: nothing but a prior shows it there."""
    simulation = _simulation(2)
    gap = range(EPOCH_NS + 12 * SECOND // 10, EPOCH_NS + 24 * SECOND // 10)
    messages = [m for m in simulation.messages if not isinstance(m, ImuSample) or m.t_ns not in gap]
    first, all_of_them = [_prior(simulation, 0)], [_prior(simulation, k) for k in range(8)]
    with_one, with_all = (fly(simulation, messages=by_arrival([*messages, *priors])).aligned for priors in (first, all_of_them))
    at_5s = EPOCH_NS + 5 * SECOND
    assert not any(e.t_ns < at_5s for e in with_one)
    begun = [e for e in with_all if e.t_ns < at_5s]
    assert begun
    assert math.degrees(math.sqrt(begun[0].covariance[E.THETA, E.THETA].diagonal().max())) < 10.0
