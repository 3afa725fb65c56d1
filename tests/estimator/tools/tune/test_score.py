"""The score of what was held back: it is the density it says, and the true noise scores best."""

import dataclasses
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from estimator.config import parse
from estimator.replay.simulate import write
from estimator.tools.tune.score import Job, _compare, _read, _Stretches, _wanted, score, sources, with_values
from estimator.tools.tune.search import summary
from logs.store.reader import LogError
from models import so3
from models.frames import Origin
from models.messages import Array, Estimate, GnssFix, LandmarkFix, Mode, PoseFix, vec3
from models.sim.scenario import Simulation, simulate
from models.sim.scenario_file import loads
from models.state import E, X

FLIGHT = """
duration_s = {seconds}
[vehicle]
kind = "multirotor"
[imu]
rate_hz = 100.0
grade = "hobby"
[pose_fix]
rate_hz = 2.0
sigma_m = [0.02, 0.02, 0.02]
sigma_deg = [0.1, 0.1, 0.1]
{more}
"""
FLOOR6 = math.log(0.05) - 3.0 * math.log(100.0) - 3.0 * math.log(2.0)


def simulated(path: Path, seed: int, seconds: float = 100.0, more: str = "") -> tuple[Path, Simulation]:
    """A flight of a hobby IMU with pose fixes, as a log."""
    simulation = simulate(loads(FLIGHT.format(seconds=seconds, more=more)), seed)
    write(simulation, path)
    return path, simulation


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Log and its own configuration."""
    path, simulation = simulated(tmp_path_factory.mktemp("tune") / "flight.mcap", seed=4)
    return str(path), simulation.config_toml


def _estimate(t_ns: int, covariance: Array, p_n: Array | None = None, theta: Array | None = None) -> Estimate:
    """covariance: (15, 15); theta: attitude as a rotation vector."""
    nav = np.zeros(X.SIZE)
    nav[X.P] = np.zeros(3) if p_n is None else p_n
    nav[X.Q] = so3.quat_exp(np.zeros(3) if theta is None else theta)
    return Estimate(t_ns, t_ns, nav, covariance, (0.0, 0.0, 0.0), Mode.AIDED, 0, t_ns, origin=(47.0, 8.0, 500.0))


def test_the_score_is_the_density_of_the_fix_under_the_estimate() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(15, 15)) * 0.1
    P, theta = root @ root.T, np.array([0.3, -0.4, 1.2])
    noise_root = rng.normal(size=(6, 6)) * 0.1
    R = noise_root @ noise_root.T
    config = parse("[pose_fix]\nnoise_scale = 1.5\n")
    dp, dtheta = np.array([0.1, -0.2, 0.05]), np.array([0.02, -0.01, 0.03])
    q = so3.multiply(so3.quat_exp(dtheta), so3.quat_exp(theta))
    z = PoseFix(1000, 1000, vec3(np.array([5.0, 6.0, -7.0]) + dp), (q[0], q[1], q[2], q[3]), R)
    estimate = _estimate(1000, P, np.array([5.0, 6.0, -7.0]), theta)
    rows = np.r_[E.P, E.THETA]
    turn = np.eye(6)
    turn[3:, 3:] = so3.matrix(so3.quat_exp(theta))
    S = turn @ P[np.ix_(rows, rows)] @ turn.T + 1.5**2 * R
    y = np.concatenate((dp, dtheta))
    said = _compare(z, estimate, config)
    expected = np.logaddexp(math.log(0.95) + multivariate_normal.logpdf(y, cov=S), FLOOR6)
    assert said.score == pytest.approx(expected, rel=1e-9)
    assert said.nis == pytest.approx(y @ np.linalg.solve(S, y))
    assert said.dof == 6
    assert not said.false
    assert said.p_sq_m2 == pytest.approx(float(dp @ dp))
    assert said.covered == (dp @ np.linalg.solve(S[:3, :3], dp) < chi2.ppf(0.95, 3))


def test_what_a_fix_does_not_give_does_not_count() -> None:
    R = np.diag([0.04, 0.04, 0.04, 1e6, 1e6, 0.01])
    z = PoseFix(0, 0, (0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), R)
    said = _compare(z, _estimate(0, np.eye(15) * 0.01), parse(""))
    assert said.dof == 4
    expected = multivariate_normal.logpdf([0.1, 0.0, 0.0, 0.0], cov=np.diag([0.05, 0.05, 0.05, 0.02]))
    assert said.score == pytest.approx(math.log(0.95) + expected, abs=1e-3)


def test_common_errors_of_a_landmark_fix_are_part_of_its_noise() -> None:
    fix = LandmarkFix(0, 0, (0.3, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6) * 0.01, np.eye(6) * 0.05, ("a",), 1.0, 0.1)
    said = _compare(
        fix, _estimate(0, np.eye(15) * 0.02), parse("[landmark_fix]\nnoise_scale = 2.0\n[pose_fix]\nnoise_scale = 5.0\n")
    )
    assert said.nis == pytest.approx(0.3**2 / (0.02 + 4 * 0.01 + 0.05))


def test_gnss_is_compared_at_its_antenna() -> None:
    lat, lon, alt = Origin(47.0, 8.0, 500.0).to_geodetic((2.0, 0.5, -30.0))
    z = GnssFix(0, 0, lat, lon, alt, np.eye(3) * 0.5)
    config = parse("[gnss]\nantenna_b_m = [2.0, 0.0, 0.0]\nslow_sigma_m = 1.0\n")
    said = _compare(z, _estimate(0, np.eye(15) * 0.5, np.array([0.0, 0.0, -30.0])), config)
    assert said.nis == pytest.approx(0.5**2 / (0.5 + 0.5), rel=1e-6)
    assert said.dof == 3


def test_a_false_fix_and_a_silence_cost_a_bounded_amount() -> None:
    config, P = parse(""), np.eye(15) * 1e-4
    lie = PoseFix(0, 0, (30.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6) * 1e-4)
    compared = _compare(lie, _estimate(0, P), config)
    assert compared.score == pytest.approx(FLOOR6)
    assert compared.false, "and is not taken for an error of the estimate"
    assert compared.nis == compared.p_sq_m2 == 0.0
    silence = _compare(lie, None, config)
    assert silence.score == pytest.approx(FLOOR6)
    assert silence.dof == silence.covered == 0
    assert silence.false


def test_every_fix_after_the_first_seconds_is_held_back_in_one_of_two_folds(flight: tuple[str, str]) -> None:
    messages, _ = _read(*flight, "")
    fixes = [m for m in messages if isinstance(m, PoseFix)]
    begin_ns = fixes[0].t_ns + 15 * 10**9
    folds = [_Stretches(begin_ns, 10 * 10**9, fold) for fold in (0, 1)]
    held = [_wanted(messages, None, stretch, 0) for stretch in folds]
    stamps = sorted(z.t_ns for some in held for z in some)
    assert stamps == sorted(m.t_ns for m in fixes if m.t_ns >= begin_ns)
    for stretch, some in zip(folds, held, strict=True):
        shown = {m.t_ns for m in fixes if not stretch.held_back(m)}
        assert shown.isdisjoint(z.t_ns for z in some)
        assert {(z.t_ns - begin_ns) // (10 * 10**9) % 2 for z in some} == {stretch.fold}
    assert not any(stretch.held_back(m) for stretch in folds for m in messages if not isinstance(m, PoseFix))


def test_the_noise_of_the_simulation_scores_best_and_is_consistent(flight: tuple[str, str]) -> None:
    log, config = flight
    noise = parse(config).imu
    truth = summary(score(Job(log, config, {})))
    assert 0.7 < truth.nis_per_dof < 1.4
    assert 0.85 < truth.inside95 <= 1.0
    low, high = (
        summary(score(Job(log, config, {"imu.accel_noise": noise.accel_noise * f, "imu.gyro_noise": noise.gyro_noise * f})))
        for f in (0.2, 5.0)
    )
    assert high.score < truth.score - 0.2
    assert high.nis_per_dof < truth.nis_per_dof
    assert low.score < truth.score  # hardly: the rest of the noise is measured on the samples themselves
    assert truth.nis_per_dof < low.nis_per_dof < 1.4


@pytest.mark.long
def test_fixes_that_claim_too_much_are_found_out(tmp_path: Path) -> None:
    """What fixes claim is half of what they are: scaled by two they score better."""
    path, simulation = simulated(tmp_path / "bold.mcap", seed=7)
    bold = [
        msgspec.structs.replace(m, covariance=m.covariance / 4.0) if isinstance(m, PoseFix) else m for m in simulation.messages
    ]
    write(dataclasses.replace(simulation, messages=bold), path)
    scores = [summary(score(Job(str(path), simulation.config_toml, {"pose_fix.noise_scale": s}))).score for s in (1.0, 2.0, 4.0)]
    assert scores[1] > scores[0] + 0.2
    assert scores[1] > scores[2] + 0.2


@pytest.mark.long
def test_against_a_truth_the_whole_flight_counts(flight: tuple[str, str]) -> None:
    log, config = flight
    windows = score(Job(log, config, {}, truth="/truth"))
    held = score(Job(log, config, {}))
    assert len(windows) == 2 * len(held)
    good = summary(windows)
    assert 0.2 < good.nis_per_dof < 1.2  # a truth without covariance is taken for good to 0.01 m and 0.1 degrees
    noise = parse(config).imu
    bad = summary(score(Job(log, config, {"imu.accel_noise": noise.accel_noise * 0.1}, truth="/truth")))
    assert bad.score < good.score


def test_a_log_that_cannot_be_used_reports_why(flight: tuple[str, str], tmp_path: Path) -> None:
    log, config = flight
    short, _ = simulated(tmp_path / "short.mcap", seed=1, seconds=12.0)
    with pytest.raises(LogError, match="no absolute fix to hold back"):
        score(Job(str(short), config, {}))
    with pytest.raises(LogError, match="/nowhere is not in it"):
        score(Job(log, config, {}, truth="/nowhere"))
    with pytest.raises(LogError, match="holds sensor_msgs/msg/Imu, not poses"):
        score(Job(log, config.replace('imu = "/imu"', 'imu = "/other"'), {}, truth="/imu"))


def test_values_replace_those_of_the_text_and_nothing_else(flight: tuple[str, str]) -> None:
    log, text = flight
    before, after = parse(text), with_values(parse(text), {"imu.gyro_noise": 0.5, "gnss.slow_sigma_m": 2.0})
    assert (after.imu.gyro_noise, after.gnss.slow_sigma_m) == (0.5, 2.0)
    assert with_values(after, {"imu.gyro_noise": before.imu.gyro_noise, "gnss.slow_sigma_m": before.gnss.slow_sigma_m}) == before
    assert sources(log, text) == {"pose_fix"}
