"""Fusion from the outside: what it says while sources come and go, and while the IMU itself is silent."""

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from estimator.fusion import EstimatorConfig, Fusion, FusionConfig
from estimator.sources.base.rules import RULES
from models import so3
from models.imu import Coast
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, Mode, PoseFix, Reason, Tick, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X, local
from tests.estimator.scenes import (
    SECOND,
    Run,
    by_arrival,
    config_of,
    displaced,
    fly,
    hover,
    pose_fix,
    position_errors,
    simulated,
    within,
)


def _horizontal_sigma(cov: Array) -> float:
    return math.sqrt(float(np.trace(cov[E.P, E.P][:2, :2])))


# --- the stream of estimates -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hovering() -> Run:
    return Run(Fusion(FusionConfig())).feed(hover(8.0))


def test_there_is_one_estimate_for_each_imu_sample_at_its_stamp(hovering: Run) -> None:
    stamps = [e.t_ns for e in hovering.estimates]
    assert {b - a for a, b in pairwise(stamps)} == {SECOND // 100}
    assert stamps[-1] == EPOCH_NS + 8 * SECOND


def test_each_measurement_is_reported_once_and_punctually(hovering: Run) -> None:
    reported = [s.t_ns for s in hovering.statuses]
    assert len(reported) == len(set(reported)) == 15
    assert [s.revision for s in hovering.statuses] == [0] * 15
    last = hovering.statuses[-1]
    assert (last.topic, last.kind, last.reason, last.replayed) == ("/pose_fix", "pose", Reason.FUSED, 0)
    assert len(last.innovation) == len(last.innovation_sigma) == 6
    assert 0.0 <= last.test_ratio < 0.1


def test_test_ratio_is_the_distance_by_the_gate_and_sigma_that_of_the_innovation(hovering: Run) -> None:
    fusion = Run(Fusion(FusionConfig())).feed(hover(4.0)).fusion
    bank = fusion._history.tracker.core.hypotheses
    assert bank is not None
    prior, p_n = bank.lead.cov.copy(), bank.lead.x[X.P].copy()
    fix = pose_fix(EPOCH_NS + 4 * SECOND, (0.3, 0.0, 0.0))
    run = Run(fusion).feed([fix, *(_sample(EPOCH_NS + 4 * SECOND + k * SECOND // 100) for k in (1, 2))])
    (status,) = run.statuses
    sigma = np.sqrt(np.diag(prior[E.P, E.P]) + 0.01)
    np.testing.assert_allclose(status.innovation_sigma[:3], sigma, rtol=1e-6)
    assert status.innovation[0] == pytest.approx(0.3 - p_n[0], abs=0.3)
    assert 0.0 < status.test_ratio < 1.0
    assert len(hovering.statuses) == 15


def _sample(t_ns: int) -> ImuSample:
    return ImuSample(t_ns, t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))


def test_angular_rate_is_the_gyros_less_its_bias() -> None:
    simulation = simulated("duration_s = 15.0\n[imu]\nrate_hz = 100.0\n[pose_fix]\nrate_hz = 4.0\n")
    run = fly(simulation)
    samples = {m.t_ns: m for m in simulation.messages if isinstance(m, ImuSample)}
    for e in run.estimates[::100]:
        np.testing.assert_allclose(np.add(e.gyro_b, e.nav[X.BG]), samples[e.t_ns].gyro_b, atol=1e-12)


def test_health_comes_at_its_rate_and_reports_how_good_it_is(hovering: Run) -> None:
    gaps = {b.t_ns - a.t_ns for a, b in pairwise(hovering.health)}
    assert gaps == {SECOND // 2}
    last, estimate = hovering.health[-1], hovering.estimates[-1]
    assert last.mode is Mode.AIDED
    assert 0.0 <= last.absolute_age_s <= 0.5
    assert last.radius95_m == pytest.approx(2.4477 * math.sqrt(np.linalg.eigvalsh(estimate.covariance[:2, :2])[-1]), rel=1e-3)
    assert last.attitude_sigma_deg == pytest.approx(
        math.degrees(math.sqrt(np.diag(estimate.covariance)[E.THETA].max())), rel=1e-6
    )
    assert last.sources == {"/pose_fix": "active"}
    assert last.counts == {Reason.ALIGNING: 3, Reason.FUSED: 12}


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_the_rate_of_health_is_configured(rate_hz: float) -> None:
    run = Run(Fusion(FusionConfig(estimator=EstimatorConfig(health_hz=rate_hz)))).feed(hover(4.0))
    assert {b.t_ns - a.t_ns for a, b in pairwise(run.health)} == {round(SECOND / rate_hz)}


def test_a_fix_newer_than_the_newest_sample_waits_for_it() -> None:
    run = Run(Fusion(FusionConfig())).feed(hover(4.0))
    before = len(run.statuses)
    run.feed([pose_fix(EPOCH_NS + 4 * SECOND + 5_000_000)])
    assert len(run.statuses) == before
    run.feed([_sample(EPOCH_NS + 4 * SECOND + 10_000_000)])
    assert run.statuses[-1].reason is Reason.FUSED
    assert run.estimates[-1].last_absolute_ns == EPOCH_NS + 4 * SECOND + 5_000_000


# --- dead reckoning --------------------------------------------------------------------------------------------------------


def test_without_fixes_the_mode_is_dead_reckoning_and_sigma_grows_with_the_age() -> None:
    messages = [m for m in hover(20.0) if isinstance(m, ImuSample) or m.t_ns < EPOCH_NS + 6 * SECOND]
    run = Run(Fusion(FusionConfig())).feed(messages)
    lost_ns = max(m.t_ns for m in messages if isinstance(m, PoseFix))
    modes = {e.t_ns: e.mode for e in run.estimates}
    assert modes[EPOCH_NS + 6 * SECOND] is Mode.AIDED
    assert all(mode is (Mode.AIDED if t_ns - lost_ns <= 3 * SECOND else Mode.DEAD_RECKONING) for t_ns, mode in modes.items())
    after = [h for h in run.health if h.t_ns > lost_ns]
    assert all(b.radius95_m > a.radius95_m for a, b in pairwise(after))
    assert after[-1].absolute_age_s == pytest.approx((after[-1].t_ns - lost_ns) * 1e-9)
    assert after[-1].radius95_m > 5.0 * after[0].radius95_m
    reported = [(h.t_ns - lost_ns, h.sources["/pose_fix"]) for h in after]
    assert [phase for _, phase in reported] == ["active" if silent_ns <= 5 * SECOND else "stopped" for silent_ns, _ in reported]
    assert "stopped" in dict(reported).values()


# --- the IMU is silent -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dropout() -> Run:
    """A hover whose IMU is silent from 6 s to 8 s, with fixes going on until 7 s; a clock ticks at 20 Hz."""
    quiet = [m for m in hover(11.0) if not (isinstance(m, ImuSample) and _between(m, 6.0, 8.0))]
    kept = [m for m in quiet if not (isinstance(m, PoseFix) and _between(m, 7.0, 9.0))]
    ticks = [Tick(t, t) for t in range(EPOCH_NS, EPOCH_NS + 11 * SECOND, SECOND // 20)]
    return Run(Fusion(FusionConfig())).feed(by_arrival([*kept, *ticks]))


def _between(m: Input, start_s: float, end_s: float) -> bool:
    return EPOCH_NS + start_s * 1e9 < m.t_ns < EPOCH_NS + end_s * 1e9


def test_ticks_lead_to_coasting_estimates_while_the_imu_is_silent(dropout: Run) -> None:
    silent = [e for e in dropout.estimates if EPOCH_NS + 6 * SECOND < e.t_ns < EPOCH_NS + 8 * SECOND]
    assert len(silent) == pytest.approx(2.0 * 20, abs=3)
    assert {e.mode for e in silent} == {Mode.COASTING}
    assert {e.mode for e in dropout.estimates if e.t_ns < EPOCH_NS + 6 * SECOND} == {Mode.AIDED}
    assert not dropout.internal_errors()


def test_the_covariance_grows_while_coasting_and_much_faster_than_on_the_imu(dropout: Run) -> None:
    alone = [e for e in dropout.estimates if EPOCH_NS + 7 * SECOND < e.t_ns < EPOCH_NS + 8 * SECOND]
    sigma = [_horizontal_sigma(e.covariance) for e in alone]
    assert all(b > a for a, b in pairwise(sigma))
    assert sigma[-1] > sigma[0] + 0.5
    turn = [float(np.trace(e.covariance[E.THETA, E.THETA])) for e in alone]
    assert all(b > a for a, b in pairwise(turn))


def test_fixes_are_fused_while_coasting(dropout: Run) -> None:
    fused = [s for s in dropout.statuses if _between_ns(s.t_ns, 6.0, 7.0)]
    assert [s.reason for s in fused] == [Reason.FUSED] * 2
    assert all(s.arrived_ns == s.t_ns for s in fused)


def _between_ns(t_ns: int, start_s: float, end_s: float) -> bool:
    return EPOCH_NS + start_s * 1e9 < t_ns < EPOCH_NS + end_s * 1e9


def test_when_the_imu_is_back_it_is_aided_again(dropout: Run) -> None:
    assert dropout.estimates[-1].mode is Mode.AIDED
    assert np.linalg.norm(dropout.estimates[-1].nav[X.P]) < 0.2


def test_coasting_does_not_commit_what_the_imu_may_still_tell(dropout: Run) -> None:
    """An estimate published between two ticks is not the start of the next: sigma is that of one stretch."""
    once = Fusion(FusionConfig())
    Run(once).feed(m for m in hover(6.0))
    whole = Run(once).feed([Tick(EPOCH_NS + 7 * SECOND, EPOCH_NS + 7 * SECOND)]).estimates[-1]
    often = Fusion(FusionConfig())
    Run(often).feed(m for m in hover(6.0))
    ticks = [Tick(t, t) for t in range(EPOCH_NS + 6 * SECOND, EPOCH_NS + 7 * SECOND + 1, SECOND // 50)]
    parts = Run(often).feed(ticks).estimates[-1]
    np.testing.assert_allclose(np.sqrt(np.diag(whole.covariance)), np.sqrt(np.diag(parts.covariance)), rtol=0.02)
    assert len(dropout.estimates) > 100


def test_a_gap_shorter_than_configured_is_not_coasted() -> None:
    messages = [m for m in hover(6.0) if not (isinstance(m, ImuSample) and _between(m, 3.0, 3.09))]
    ticks = [Tick(t, t) for t in range(EPOCH_NS, EPOCH_NS + 6 * SECOND, SECOND // 50)]
    run = Run(Fusion(FusionConfig(coast=Coast(gap_s=0.1)))).feed(by_arrival([*messages, *ticks]))
    assert Mode.COASTING not in {e.mode for e in run.estimates}


@pytest.mark.parametrize("first", [True, False])
def test_a_topic_may_tell_its_common_error_with_some_fixes_only(first: bool) -> None:
    messages: list[Input] = []
    for k, m in enumerate(hover(8.0)):
        shared = isinstance(m, PoseFix) and (k > 400) is first
        messages.append(msgspec.structs.replace(m, covariance_common=np.eye(6) * 0.01) if shared else m)
    run = Run(Fusion(FusionConfig())).feed(messages)
    assert {s.reason for s in run.statuses} == {Reason.ALIGNING, Reason.FUSED}


# --- resets ----------------------------------------------------------------------------------------------------------------


def test_a_jump_is_reported_with_its_size_and_counted() -> None:
    """Fixes say 8 m east for longer than the filter itself can be right."""
    messages = [
        displaced(m, (0.0, 8.0, 0.0)) if isinstance(m, PoseFix) and m.t_ns > EPOCH_NS + 10 * SECOND else m
        for m in hover(45.0, rate_hz=50.0)
    ]
    run = Run(Fusion(FusionConfig())).feed(messages)
    assert run.resets
    assert [r.counter for r in run.resets] == list(range(1, len(run.resets) + 1))
    assert run.estimates[-1].reset_counter == run.health[-1].reset_counter == len(run.resets)
    big = max(run.resets, key=lambda r: float(np.linalg.norm(r.delta_p_n)))
    before = next(e for e in reversed(run.estimates) if e.t_ns < big.t_ns)
    after = next(e for e in run.estimates if e.t_ns == big.t_ns)
    assert after.reset_counter == before.reset_counter + 1
    np.testing.assert_allclose(np.add(before.nav[X.P], big.delta_p_n), after.nav[X.P], atol=0.05)
    np.testing.assert_allclose(np.add(before.nav[X.V], big.delta_v_n), after.nav[X.V], atol=0.05)
    turned = so3.multiply(so3.quat_exp(np.array(big.delta_theta_n)), before.nav[X.Q])
    assert 2.0 * math.acos(min(1.0, abs(float(turned @ after.nav[X.Q])))) < 0.01
    assert big.delta_p_n[1] == pytest.approx(8.0, abs=1.5)


def test_a_jump_in_attitude_is_reported_about_the_axes_of_n() -> None:
    """R_new = exp(delta_theta_n) R_old: fixes on a vehicle that lies on its side, nose up, turn about the vertical."""
    rest, turn_n = so3.from_euler(1.3, 0.6, 0.4), np.array([0.0, 0.0, 0.8])
    felt = vec3(so3.matrix(rest).T @ np.array([0.0, 0.0, -9.80665]))
    messages: list[Input] = []
    for m in hover(45.0, rate_hz=50.0):
        if isinstance(m, PoseFix):
            q = so3.multiply(so3.quat_exp(turn_n), rest) if m.t_ns > EPOCH_NS + 10 * SECOND else rest
            messages.append(msgspec.structs.replace(m, q_nb_wxyz=(float(q[0]), float(q[1]), float(q[2]), float(q[3]))))
        else:
            messages.append(msgspec.structs.replace(m, accel_b=felt))
    run = Run(Fusion(FusionConfig())).feed(messages)
    big = max(run.resets, key=lambda r: float(np.linalg.norm(r.delta_theta_n)))
    np.testing.assert_allclose(big.delta_theta_n, turn_n, atol=0.05)


def test_an_ordinary_correction_is_no_reset(hovering: Run) -> None:
    assert not hovering.resets
    assert {e.reset_counter for e in hovering.estimates} == {0}


# --- GNSS ------------------------------------------------------------------------------------------------------------------

BESIDE = """
duration_s = 45.0
[vehicle]
kind = "multirotor"
seed = 5
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
{gnss}
[pose_fix]
rate_hz = 2.0
sigma_m = [0.2, 0.2, 0.2]
{rest}
"""


def _beside(gnss: str = "", rest: str = "") -> Simulation:
    return simulated(BESIDE.format(gnss=gnss, rest=rest), seed=2)


def test_the_last_known_gnss_is_reported_with_its_age_and_a_radius_that_grows() -> None:
    simulation = _beside(gnss="outages_s = [[20.0, 45.0]]", rest="outages_s = [[20.0, 45.0]]")
    run = fly(simulation)
    last_fix = max((m for m in simulation.messages if isinstance(m, GnssFix)), key=lambda m: m.t_ns)
    reported = [h for h in run.health if h.t_ns > EPOCH_NS + 21 * SECOND]
    for h in reported:
        assert h.last_gnss is not None
        assert (h.last_gnss.lat_deg, h.last_gnss.lon_deg, h.last_gnss.alt_m) == (
            last_fix.lat_deg,
            last_fix.lon_deg,
            last_fix.alt_m,
        )
        assert h.last_gnss.age_s == pytest.approx((h.t_ns - last_fix.t_ns) * 1e-9)
        assert h.mode is (Mode.AIDED if h.absolute_age_s <= 3.0 else Mode.DEAD_RECKONING)
    radii = [h.last_gnss.sigma_m for h in reported if h.last_gnss]
    assert all(b > a for a, b in pairwise(radii))
    speed = float(np.linalg.norm(simulation.truth.v_n[int(np.searchsorted(simulation.truth.t_ns, last_fix.t_ns))]))
    assert (radii[-1] - radii[0]) / (reported[-1].t_ns - reported[0].t_ns) * 1e9 > 0.9 * speed
    age_before = [h.last_gnss.age_s for h in run.health if h.last_gnss and h.t_ns < EPOCH_NS + 20 * SECOND]
    assert max(age_before) < 0.5


def test_health_reports_the_biases_of_the_imu_as_the_estimate_has_them() -> None:
    run = fly(_beside())
    by_stamp = {e.t_ns: e for e in run.estimates}
    reported = [(h, by_stamp[h.t_ns]) for h in run.health if h.biases and h.t_ns in by_stamp]
    assert len(reported) > 10
    for health, estimate in reported[-3:]:
        sigma = np.sqrt(np.diag(estimate.covariance))
        for name, value, error in (("gyro", X.BG, E.BG), ("accel", X.BA, E.BA)):
            assert [health.biases[f"{name}_{a}"] for a in "xyz"] == pytest.approx(estimate.nav[value].tolist(), abs=1e-4)
            assert [health.biases[f"{name}_{a}_sigma"] for a in "xyz"] == pytest.approx(sigma[error].tolist(), rel=0.05)


def test_a_gnss_that_jumps_does_not_win_beside_landmarks() -> None:
    simulation = _beside(rest='[[faults]]\nkind = "spoof_jump"\nstart_s = 15.0\noffset_n_m = [60.0, -40.0, 5.0]')
    run = fly(simulation)
    assert position_errors(within(run.estimates, 15.0, 45.0), simulation.truth).max() < 1.5
    spoofed = [s for s in run.last_words("/gnss").values() if s.t_ns > EPOCH_NS + 15.3 * SECOND]
    assert len(spoofed) > 140
    assert {s.reason for s in spoofed} <= {Reason.GATED, Reason.STOPPED, Reason.PROBATION}
    assert run.health[-1].sources["/pose_fix"] == "active"


def test_a_gnss_that_comes_back_is_on_probation_beside_landmarks() -> None:
    simulation = _beside(gnss="outages_s = [[15.0, 28.0]]")
    run = fly(simulation)
    back = [s for s in run.last_words("/gnss").values() if s.t_ns > EPOCH_NS + 28 * SECOND and s.kind == "gnss_position"]
    reasons = [s.reason for s in sorted(back, key=lambda s: s.t_ns)]
    probation = reasons.index(Reason.FUSED)
    assert set(reasons[:probation]) == {Reason.PROBATION}
    assert probation == RULES["gnss"].probation
    assert reasons[probation:].count(Reason.FUSED) > 0.95 * len(reasons[probation:])


def test_a_spoofed_gnss_that_comes_back_never_leaves_probation() -> None:
    """Silence, then a place 60 m away: what the jammer and spoofer of a convoy do."""
    spoof = '[[faults]]\nkind = "spoof_jump"\nstart_s = 28.0\noffset_n_m = [60.0, 0.0, 0.0]\ntopics = ["/gnss"]'
    simulation = _beside(gnss="outages_s = [[15.0, 28.0]]", rest=spoof)
    run = fly(simulation)
    back = [s.reason for s in run.last_words("/gnss").values() if s.t_ns > EPOCH_NS + 28 * SECOND]
    assert Reason.FUSED not in back
    assert position_errors(within(run.estimates, 20.0, 45.0), simulation.truth).max() < 1.5


def test_without_origin_gnss_beside_a_local_map_is_refused_with_what_to_do() -> None:
    fixes: list[Input] = [
        GnssFix(t, t, 47.0, 8.0, 500.0, np.eye(3)) for t in range(EPOCH_NS + 3 * SECOND, EPOCH_NS + 5 * SECOND, SECOND // 5)
    ]
    run = Run(Fusion(FusionConfig())).feed(by_arrival([*hover(6.0), *fixes]))
    assert run.reasons("/gnss") == {Reason.NO_ORIGIN: 10}
    assert any("[map] origin" in s.detail for s in run.statuses)
    assert run.estimates[-1].origin is None


def test_a_velocity_alone_does_not_count_as_an_absolute_fix() -> None:
    messages = [m for m in hover(15.0) if isinstance(m, ImuSample) or m.t_ns < EPOCH_NS + 5 * SECOND]
    rng = np.random.default_rng(0)
    speeds: list[Input] = [
        GnssVelocity(t, t, vec3(0.05 * rng.standard_normal(3)), np.eye(3) * 0.0025)
        for t in range(EPOCH_NS + 5 * SECOND, EPOCH_NS + 15 * SECOND, SECOND // 5)
    ]
    run = Run(Fusion(FusionConfig())).feed(by_arrival([*messages, *speeds]))
    assert run.reasons("/gnss/velocity") == {Reason.PROBATION: 10, Reason.FUSED: 40}
    assert run.estimates[-1].mode is Mode.DEAD_RECKONING
    assert np.sqrt(np.diag(run.estimates[-1].covariance)[E.V]).max() < 0.15  # 0.1 downwards is GNSS's slow error


# --- together --------------------------------------------------------------------------------------------------------------


def test_equal_inputs_give_equal_outputs() -> None:
    simulation = _beside(rest="outlier_share = 0.2\ndelay_s = [0.0, 1.0]")
    messages = [m for m in simulation.messages if m.arrived_ns < EPOCH_NS + 15 * SECOND]
    encoder = msgspec.msgpack.Encoder(enc_hook=lambda a: a.tobytes())
    first, second = (
        [encoder.encode(out) for m in messages for out in fusion.handle(m)]
        for fusion in (Fusion(config_of(simulation)), Fusion(config_of(simulation)))
    )
    assert first == second
    assert len(first) > 1000


def test_local_error_of_the_state_is_what_the_covariance_is_of() -> None:
    """A body that looks east with a tilt error about north: the covariance must say so about the body's axes."""
    covariance = np.diag([0.01, 0.01, 0.01, 0.09, 1e-4, 1e-4])  # rx: about north
    q = so3.from_euler(0.0, 0.0, math.pi / 2)
    fixes = [
        msgspec.structs.replace(m, q_nb_wxyz=tuple(q.tolist()), covariance=covariance) if isinstance(m, PoseFix) else m
        for m in hover(1.5)
    ]
    run = Run(Fusion(FusionConfig())).feed(fixes)
    bank = run.fusion._history.tracker.core.hypotheses
    assert bank is not None
    about_body = np.diag(bank.lead.cov)[E.THETA]
    assert about_body[1] > 5.0 * about_body[0]  # north is to the left: about body y
    assert np.linalg.norm(local(bank.lead.x, bank.lead.x)) == 0.0
