import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import parse
from estimator.fusion import Fusion
from estimator.integrity.config import IntegrityConfig
from estimator.integrity.faults import GNSS
from logs.evaluation.integrity import against_truth
from models.frames import Origin
from models.messages import (
    AidStatus,
    Alert,
    Array,
    Estimate,
    GnssFix,
    Health,
    ImuSample,
    Input,
    Integrity,
    LandmarkFix,
    Output,
    PoseFix,
    vec3,
)
from models.sim.aids import Gnss, PoseFixes
from models.sim.scenario import Scenario, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import Multirotor
from tests.estimator.partial import in_part, orthonormal

S = 1_000_000_000
LIMITS = IntegrityConfig(hal_m=10.0, val_m=12.0)


class Run:
    """A simulated flight through Fusion, with truth at hand."""

    def __init__(
        self,
        config: IntegrityConfig,
        *,
        gnss: bool = True,
        shift_m: float = 0.0,
        until_s: float = 99.0,
        rate_hz: float = 2.0,
        changed: Callable[[Input], Input] = lambda m: m,
    ) -> None:
        scenario = Scenario(
            duration_s=40.0,
            vehicle=Multirotor(seed=0),
            imu=Imu(rate_hz=100.0),
            gnss=Gnss() if gnss else None,
            pose_fix=PoseFixes(rate_hz=rate_hz, outages_s=()),
        )
        made = simulate(scenario, 0)
        self.truth = made.truth
        self.start_ns = made.messages[0].t_ns
        fusion = Fusion(msgspec.structs.replace(parse(made.config_toml, "simulated").fusion(), integrity=config))
        self.fusion = fusion
        self.outputs: list[Output] = []
        for message in made.messages:
            late = (message.t_ns - self.start_ns) * 1e-9
            if isinstance(message, PoseFix) and late > until_s:
                continue
            self.outputs += fusion.handle(changed(_shifted(message, shift_m if late > 20.0 else 0.0)))
        self.integrity = [o for o in self.outputs if isinstance(o, Integrity)]

    def estimates(self) -> list[Estimate]:
        return [o for o in self.outputs if isinstance(o, Estimate)]

    def at(self, t_s: float) -> Integrity:
        return min(self.integrity, key=lambda i: abs(i.t_ns - self.start_ns - t_s * 1e9))

    def errors(self) -> Array:
        """Horizontal error and HPL at the first risk, where there is an estimate, (n, 2)."""
        nav = {e.t_ns: e.nav for e in self.estimates()}
        rows = []
        for i in (i for i in self.integrity if i.t_ns in nav):
            k = int(np.searchsorted(self.truth.t_ns, i.t_ns))
            rows.append((math.hypot(*(self.truth.p_n[k] - nav[i.t_ns][:3])[:2]), i.hpls_m[0]))
        return np.array(rows)


def _shifted(message: Input, shift_m: float) -> Input:
    if not isinstance(message, GnssFix) or not shift_m:
        return message
    origin = Origin(message.lat_deg, message.lon_deg, message.alt_m)
    lat, lon, alt = origin.to_geodetic(vec3([shift_m, 0.0, 0.0]))
    return msgspec.structs.replace(message, lat_deg=lat, lon_deg=lon, alt_m=alt)


@pytest.fixture(scope="module")
def both() -> Run:
    return Run(LIMITS)


def test_two_sources_that_agree_are_usable_and_the_bound_holds(both: Run) -> None:
    settled = [i for i in both.integrity if i.t_ns > both.start_ns + 15 * S]
    assert {i.state for i in settled} == {Alert.USABLE}
    assert all(math.isfinite(i.hpls_m[-1]) and i.hpl_m < 5.0 for i in settled)
    error, level = both.errors().T
    assert (error < level).all()


def _along_directions(count: int) -> Callable[[Input], Input]:
    """Fixes as landmarks give them: along orthonormal directions that mix position and attitude."""
    rows = orthonormal(np.random.default_rng(5).standard_normal((count, 6)))
    return lambda m: in_part(m, rows, np.zeros(6 - count)) if isinstance(m, PoseFix) else m


def _whole(message: Input) -> Input:
    found = _along_directions(6)(message)
    return msgspec.structs.replace(found, directions=None) if isinstance(found, LandmarkFix) else found


def test_fixes_along_six_directions_check_a_receiver_as_whole_ones_do() -> None:
    seen, whole = Run(LIMITS, changed=_along_directions(6)), Run(LIMITS, changed=_whole)
    settled = [i for i in seen.integrity if i.t_ns > seen.start_ns + 15 * S]
    assert {i.state for i in settled} == {Alert.USABLE}
    at_once = {i.t_ns: i for i in whole.integrity}
    pairs = [(i, at_once[i.t_ns]) for i in settled if i.t_ns in at_once]
    assert len(pairs) > 10
    for one, other in pairs:
        assert one.hpls_m == pytest.approx(other.hpls_m, rel=0.02)
        assert one.vpls_m == pytest.approx(other.vpls_m, rel=0.02)


def test_fixes_in_part_check_no_position() -> None:
    seen = Run(LIMITS, changed=_along_directions(5))
    assert math.isinf(seen.at(38.0).hpls_m[1])


def test_the_levels_keep_the_variance_factor_as_long_as_the_published_covariance() -> None:
    run = Run(LIMITS)
    t_ns = run.integrity[-1].t_ns
    tracker, monitor = run.fusion._history.tracker, run.fusion._integrity
    usual = monitor.at(tracker, t_ns, t_ns)
    tracker.core.variance_factor = replace(tracker.core.variance_factor, lasting=9.0)
    wide = monitor.at(tracker, t_ns, t_ns)
    assert wide.hpls_m[0] > 1.5 * usual.hpls_m[0]


def test_it_comes_twice_in_the_time_to_alert(both: Run) -> None:
    steps = np.diff([i.t_ns for i in both.integrity]) * 1e-9
    assert steps.max() <= 0.5 + 0.011
    assert steps.mean() > 0.45
    assert both.integrity[0].state is Alert.DO_NOT_USE  # there is no estimate yet
    assert both.integrity[0].reason == "there is no estimate"
    assert math.isinf(both.integrity[0].hpl_m)


def test_it_comes_at_once_with_a_position_that_is_off() -> None:
    run = Run(LIMITS, shift_m=40.0)
    alert_ns = next(i.t_ns for i in run.integrity if i.state is Alert.DO_NOT_USE and i.t_ns > run.start_ns + 20 * S)
    wrong_ns = next(o.t_ns for o in run.outputs if isinstance(o, AidStatus) and o.t_ns > run.start_ns + 20 * S and o.kind == GNSS)
    assert alert_ns - wrong_ns <= 0.02 * S


def test_the_estimate_is_the_same_to_the_bit_whatever_is_configured(both: Run) -> None:
    other = Run(IntegrityConfig(time_to_alert_s=0.3, gnss_fault_per_hour=1.0))
    for a, b in zip(both.estimates(), other.estimates(), strict=True):
        assert a.t_ns == b.t_ns
        assert a.nav.tobytes() == b.nav.tobytes()
        assert a.covariance.tobytes() == b.covariance.tobytes()


def test_a_source_that_nothing_checks_has_no_bound_below_its_own_fault_rate() -> None:
    alone = Run(LIMITS, gnss=False).at(30.0)
    assert alone.hpls_m[0] < alone.hpls_m[1] < 10.0
    assert math.isinf(alone.hpls_m[2])  # fix_fault_per_hour is 1e-6
    rarer = Run(msgspec.structs.replace(LIMITS, fix_fault_per_hour=1e-8), gnss=False).at(30.0)
    assert math.isfinite(rarer.hpls_m[2])


def test_sources_that_disagree_are_not_used_within_a_second_and_the_bound_covers_both() -> None:
    run = Run(LIMITS, shift_m=40.0)
    alerts = [i.t_ns for i in run.integrity if i.state is Alert.DO_NOT_USE and i.t_ns > run.start_ns + 15 * S]
    assert alerts[0] - run.start_ns - 20 * S <= 1.0 * S
    error, level = run.errors().T
    assert (error < level).all()
    assert run.at(22.0).hpls_m[0] > 40.0
    without = Run(msgspec.structs.replace(LIMITS, exclude_rejected=True), shift_m=40.0)
    assert without.at(39.0).hpl_m < 10.0 < run.at(39.0).hpl_m


def test_an_imu_that_runs_away_beside_gnss_is_covered_and_alerted_before_the_error_passes_the_limit(both: Run) -> None:
    def biased(message: Input) -> Input:
        if not isinstance(message, ImuSample) or message.t_ns < begin_ns:
            return message
        ax, ay, az = message.accel_b
        return msgspec.structs.replace(message, accel_b=(ax + 7.0, ay, az))

    begin_ns = both.start_ns + 41 * S // 2
    run = Run(LIMITS, rate_hz=0.5, changed=biased)
    nav = {e.t_ns: e.nav[:3] for e in run.estimates()}
    t_ns = np.array(sorted(nav))
    p_n = run.truth.p_n[np.clip(np.searchsorted(run.truth.t_ns, t_ns), 0, len(run.truth.t_ns) - 1)]
    found = against_truth(run.integrity, t_ns, p_n - np.array([nav[t] for t in t_ns.tolist()]))
    at = [run.integrity[k] for k in found.row.tolist()]
    assert found.horizontal.max() > 5.0
    assert (found.horizontal < [i.hpls_m[1] for i in at]).all()
    alert = next(k for k, i in enumerate(at) if i.t_ns > begin_ns and i.state is not Alert.USABLE)
    assert at[alert].t_ns - begin_ns < 1.5 * S
    assert found.horizontal[:alert].max() < 10.0


def test_an_outage_ends_the_use_before_the_error_passes_the_limit() -> None:
    run = Run(LIMITS, gnss=False, until_s=20.0)
    states = [(i.state, (i.t_ns - run.start_ns) * 1e-9) for i in run.integrity if i.t_ns > run.start_ns + 15 * S]
    first = {state: min(t for s, t in states if s is state) for state in {s for s, _ in states}}
    assert 20.0 < first[Alert.CAUTION] < first[Alert.DO_NOT_USE]
    error, level = run.errors().T
    assert (error < level).all()
    t_s = np.array([(i.t_ns - run.start_ns) * 1e-9 for i in run.integrity])[-len(error) :]
    too_far = t_s[error > 10.0]
    assert not len(too_far) or first[Alert.DO_NOT_USE] <= too_far[0]
    assert run.at(39.0).reason.startswith("HPL ")
    assert "limit 10 m" in run.at(39.0).reason


def test_health_reports_the_state() -> None:
    run = Run(LIMITS)
    said = [o.integrity for o in run.outputs if isinstance(o, Health)]
    assert said[0] == "do not use: there is no estimate"
    assert said[-1] == "usable"


def test_a_defect_costs_the_level_and_not_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> float:
        raise ZeroDivisionError("of sigma")

    whole = Run(LIMITS, gnss=False)
    monkeypatch.setattr("estimator.integrity.monitor.faults", broken)
    run = Run(LIMITS, gnss=False)
    assert len(run.estimates()) == len(whole.estimates())
    assert run.integrity[-1].state is Alert.DO_NOT_USE
    assert run.integrity[-1].reason == "internal error: ZeroDivisionError: of sigma"
    assert math.isinf(run.integrity[-1].hpl_m)
