"""Which faults are counted, and what bounds each."""

import math

import msgspec
import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Doubt, Hypotheses, Hypothesis
from estimator.integrity.config import IntegrityConfig
from estimator.integrity.faults import Fault, Position, Snapshot, Velocity, faults
from models import imu
from models.imu import Coast, ImuNoise
from models.messages import Array
from models.state import E, X

CONFIG = IntegrityConfig()
S = 1_000_000_000
NOW = 100 * S
SHARE = CONFIG.correlation_s / 3600.0


def _filter(p_n: tuple[float, float, float], sigma_m: float) -> Eskf:
    nav = np.zeros(X.SIZE)
    nav[X.P], nav[X.V], nav[X.Q] = p_n, (3.0, 4.0, -2.0), (1.0, 0.0, 0.0, 0.0)
    cov = np.eye(E.SIZE)
    cov[E.P, E.P] *= sigma_m**2
    return Eskf(NOW, nav, cov, imu.constants(ImuNoise(), Coast(), None))


def _position(kind: str, innovation: tuple[float, float, float], *, age_s: float = 0.5) -> Position:
    return Position(kind, NOW - round(age_s * S), innovation, (1.0, 1.0, 2.0), NOW - round(age_s * S))


def _now(members: list[Hypothesis], positions: dict[str, Position], age_s: float = 0.5, variance_factor: float = 1.0) -> Snapshot:
    P: Array = variance_factor * members[0].filter.cov[E.P, E.P]
    return Snapshot(NOW, Hypotheses(members), P, age_s, positions, single=False, variance_factor=variance_factor)


def _by_name(found: list[Fault]) -> dict[str, Fault]:
    return {f.name: f for f in found}


def test_a_source_alone_is_not_bounded_and_has_faults_of_known_size() -> None:
    now = _now([Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))], {"/fix": _position("pose", (0.1, 0.0, 0.0))})
    found = _by_name(faults(now, CONFIG))
    alone = found["/fix wrong for long: no second source checks it"]
    assert math.isinf(alone.sigma_h)
    assert alone.probability == pytest.approx(1e-6 * SHARE)
    assert found["the map shifted"].offset_h == CONFIG.map_shift_m
    assert found["the map's scale wrong"].offset_h == 0.0
    assert found["the cameras turned on their mount"].offset_v == pytest.approx(math.radians(1.0) * 50.0)
    assert found["stamps of /fix wrong"].offset_h == pytest.approx(0.5)
    assert found["stamps of /fix wrong"].offset_v == pytest.approx(0.2)
    assert found["a false fix inside the gate"].offset_h == pytest.approx(2.0)
    assert found["nominal errors"] == Fault("nominal errors", 1.0, 0.0, 0.5, 0.0, 0.5)


def test_the_variance_factor_of_what_is_published_widens_every_solution() -> None:
    members = [Hypothesis(_filter((0.0, 0.0, 0.0), 0.5)), Hypothesis(_filter((3.0, 0.0, 0.0), 0.4), weight=-1.0)]
    members[1].doubts["/fix"] = Doubt(NOW, deliberate=True)
    narrow, wide = (_by_name(faults(_now(members, {}, variance_factor=f), CONFIG)) for f in (1.0, 4.0))
    assert wide["nominal errors"].sigma_h == pytest.approx(2.0 * narrow["nominal errors"].sigma_h) == pytest.approx(1.0)
    assert (
        wide["/fix fused and false"].sigma_h == pytest.approx(2.0 * narrow["/fix fused and false"].sigma_h) == pytest.approx(0.8)
    )


def test_the_imu_falls_away_with_the_time_since_the_last_position() -> None:
    now = _now([Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))], {}, age_s=10.0)
    assert _by_name(faults(now, CONFIG))["the IMU wrong"].offset_h == pytest.approx(15.0)


def test_a_velocity_that_disagrees_makes_the_imu_wrong_by_what_it_does_until_the_next_level() -> None:
    now = _now([Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))], {})
    off = Velocity(NOW - S // 5, (3.0, 0.0, -0.5), (0.1, 0.1, 0.1), NOW - 3 * S // 2)
    name = "the IMU wrong: /gnss says another velocity"
    found = _by_name(faults(now._replace(velocities={"/gnss": off}, holds_s=0.5), CONFIG))[name]
    assert found[1:] == pytest.approx((1.0, 6.0, 0.5, 1.0, 0.5))
    agrees = off._replace(innovation=(0.1, 0.0, 0.0), agreed_ns=off.t_ns)
    found = _by_name(faults(now._replace(velocities={"/gnss": agrees}, holds_s=0.5), CONFIG))[name]
    assert found.probability == pytest.approx(CONFIG.imu_fault_per_hour * SHARE * math.exp(0.5), rel=1e-3)
    assert found.offset_h == pytest.approx(0.07)
    old = off._replace(t_ns=NOW - 3 * S)
    assert name not in _by_name(faults(now._replace(velocities={"/gnss": old}), CONFIG))


def test_sources_that_agree_bound_each_other_and_such_that_do_not_make_the_fault_certain() -> None:
    lead = Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))
    agree = {"/gnss": _position("gnss_position", (0.5, 0.0, 0.0)), "/fix": _position("pose", (0.1, 0.0, 0.0))}
    found = _by_name(faults(_now([lead], agree), CONFIG))
    assert found["/fix wrong for long"] == pytest.approx(
        ("/fix wrong for long", 1e-6 * SHARE * math.exp(0.125), 0.5, 1.0, 0.0, 2.0)
    )
    apart = agree | {"/gnss": _position("gnss_position", (0.0, 30.0, 0.0))}
    found = _by_name(faults(_now([lead], apart), CONFIG))
    assert found["/fix wrong for long"].probability == pytest.approx(1.0)
    assert found["/fix wrong for long"].offset_h == 30.0


def test_an_old_position_or_a_second_receiver_checks_nothing() -> None:
    lead = Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))
    old = {"/gnss": _position("gnss_position", (0.5, 0.0, 0.0), age_s=2.5), "/fix": _position("pose", (0.1, 0.0, 0.0))}
    assert "/fix wrong for long: no second source checks it" in _by_name(faults(_now([lead], old), CONFIG))
    two = {"/gnss": _position("gnss_position", (0.5, 0.0, 0.0)), "/gnss2": _position("gnss_position", (0.1, 0.0, 0.0))}
    assert "/gnss wrong for long: no second source checks it" in _by_name(faults(_now([lead], two), CONFIG))


def test_the_hypothesis_without_gnss_bounds_gnss() -> None:
    lead, without = Hypothesis(_filter((0.0, 0.0, 0.0), 0.5)), Hypothesis(_filter((3.0, 4.0, 1.0), 2.0), weight=-4.6)
    without.without, without.fused_ns = "/gnss", NOW - 20 * S
    gnss = {"/gnss": _position("gnss_position", (0.1, 0.0, 0.0)), "/fix": _position("pose", (0.1, 0.0, 0.0), age_s=20.0)}
    found = faults(_now([lead, without], gnss), CONFIG)
    (wrong,) = [f for f in found if f.name == "/gnss wrong for long"]
    assert (wrong.offset_h, wrong.sigma_h, wrong.offset_v, wrong.sigma_v) == (5.0, 2.0, 1.0, 2.0)
    prior = 1e-4 * SHARE
    assert wrong.probability == pytest.approx(prior / (prior + math.exp(-0.5 * (2.5**2 + 0.5**2))))
    assert found[0].probability == 1.0  # a spare hypothesis takes nothing from the nominal one
    without.fused_ns = NOW - 10 * S  # it began since the last fix, as the leading one
    assert "/gnss wrong for long: no second source checks it" in _by_name(faults(_now([lead, without], gnss), CONFIG))


def test_what_the_filter_has_not_decided_counts_with_its_weight() -> None:
    lead, other = Hypothesis(_filter((0.0, 0.0, 0.0), 0.5)), Hypothesis(_filter((0.0, 40.0, 0.0), 1.0), weight=-3.0)
    other.doubts["/fix"] = Doubt(NOW, deliberate=True)
    nominal, second = faults(_now([lead, other], {}), CONFIG)[:2]
    assert nominal.probability + second.probability == pytest.approx(1.0)
    assert second == pytest.approx(("/fix fused and false", math.exp(-3.0) / (1.0 + math.exp(-3.0)), 40.0, 1.0, 0.0, 1.0))


def test_a_rejected_source_can_be_left_out() -> None:
    lead = Hypothesis(_filter((0.0, 0.0, 0.0), 0.5))
    lead.doubts["/gnss"] = Doubt(NOW, deliberate=False)
    apart = {"/gnss": _position("gnss_position", (0.0, 30.0, 0.0)), "/fix": _position("pose", (0.1, 0.0, 0.0))}
    excluding = msgspec.structs.replace(CONFIG, exclude_rejected=True)
    assert _by_name(faults(_now([lead], apart), CONFIG))["/fix wrong for long"].offset_h == 30.0
    assert "/fix wrong for long" not in _by_name(faults(_now([lead], apart), excluding))


def test_a_wrong_scale_grows_with_the_distance_from_the_origin() -> None:
    now = _now([Hypothesis(_filter((300.0, 400.0, -100.0), 0.5))], {"/fix": _position("pose", (0.1, 0.0, 0.0))})
    scale = _by_name(faults(now, msgspec.structs.replace(CONFIG, map_scale_percent=2.0)))["the map's scale wrong"]
    assert scale.offset_h == pytest.approx(10.0)
    assert scale.offset_v == pytest.approx(2.0)
    assert scale.probability == pytest.approx(CONFIG.map_fault_per_hour * SHARE)
