"""What is sent to an autopilot, and as what: fixes, quality and reset counter."""

import numpy as np
import pytest

from estimator.service.autopilot.output_policy import AutopilotConfig, OutputPolicy
from models import so3
from models.messages import AidStatus, Alert, Estimate, Integrity, Mode, Reason, Vec3, vec3
from models.state import E, X

T0, SECOND = 1_795_000_000_000_000_000, 1_000_000_000


def _estimate(
    t_s: float = 0.0,
    mode: Mode = Mode.AIDED,
    *,
    sigma: float = 0.1,
    sigma_v: float = 1.0,
    p_n: Vec3 = (0.0, 0.0, 0.0),
    counter: int = 3,
) -> Estimate:
    """Flies north at 5 m/s; p_n: from where that brings it."""
    nav, covariance = np.zeros(16), np.eye(15)
    nav[X.P], nav[X.V] = np.add(p_n, (5.0 * t_s, 0.0, 0.0)), (5.0, 0.0, 0.0)
    nav[X.Q] = so3.from_euler(0.0, 0.0, 1.0)
    covariance[E.P, E.P] *= sigma**2
    covariance[E.V, E.V] *= sigma_v**2
    t_ns = T0 + round(t_s * SECOND)
    return Estimate(t_ns, t_ns, nav, covariance, (0.0, 0.0, 0.0), mode, counter, t_ns)


def _quality(policy: OutputPolicy, estimate: Estimate, *, one_at_a_time: bool = False) -> int:
    return policy.quality(estimate, one_source_at_a_time=one_at_a_time)[0]


def _fused(kind: str, t_s: float, reason: Reason = Reason.FUSED) -> AidStatus:
    t_ns = T0 + round(t_s * SECOND)
    return AidStatus(t_ns, t_ns, f"/{kind}", kind, reason)


def test_nothing_is_a_fix_while_it_rests_on_the_autopilots_own_gnss() -> None:
    policy = OutputPolicy(AutopilotConfig())
    assert not policy.note([_fused("gnss_position", 0), _fused("pose", 0, Reason.GATED)])
    assert policy.note([_fused("pose", 1)])
    assert not policy.is_fix(_estimate(2))
    assert policy.note([_fused("pose", 6)])
    assert policy.is_fix(_estimate(6))
    assert not policy.note([_fused("gnss_velocity", 7)])


def _integrity(state: Alert, sigma_m: float = 0.1) -> Integrity:
    return Integrity(T0, T0, state, "", 1e-5, 3.0, 3.0, 10.0, 10.0, (), (), (), sigma_m, 2.0 * sigma_m)


def test_what_integrity_forbids_is_neither_odometry_nor_fix() -> None:
    policy = OutputPolicy(AutopilotConfig())
    policy.note([_fused("pose", 0), _integrity(Alert.CAUTION)])
    assert _quality(policy, _estimate()) > 0
    assert policy.is_fix(_estimate())
    policy.note([_integrity(Alert.DO_NOT_USE)])
    assert _quality(policy, _estimate()) == -1
    assert not policy.is_fix(_estimate())
    policy.note([_integrity(Alert.USABLE)])
    assert _quality(policy, _estimate()) > 0


def test_an_accuracy_is_that_of_the_protection_level_where_one_is_judged() -> None:
    policy = OutputPolicy(AutopilotConfig())
    policy.note([_integrity(Alert.NOT_JUDGED, 5.0)])
    np.testing.assert_array_equal(policy.widened(_estimate()).covariance, _estimate().covariance)
    policy.note([_integrity(Alert.USABLE, 0.5)])
    P = policy.widened(_estimate()).covariance
    np.testing.assert_allclose(np.sqrt(P.diagonal()[:3]), [0.5, 0.5, 1.0])
    np.testing.assert_array_equal(P[3:, 3:], _estimate().covariance[3:, 3:])
    policy.note([_integrity(Alert.USABLE, 0.01)])
    np.testing.assert_array_equal(policy.widened(_estimate()).covariance, _estimate().covariance)


def test_a_second_receiver_is_news_to_the_autopilot() -> None:
    policy = OutputPolicy(AutopilotConfig(own_gnss=False))
    assert policy.note([_fused("gnss_position", 0)])
    assert policy.is_fix(_estimate())
    assert _quality(policy, _estimate()) > 0


@pytest.mark.parametrize(
    ("gnss_quality", "one_at_a_time", "is_used"),
    [("auto", False, False), ("auto", True, True), ("zero", True, False), ("radius", False, True)],
)
def test_whether_what_rests_on_its_own_gnss_has_a_quality_is_configured(
    gnss_quality: str, one_at_a_time: bool, is_used: bool
) -> None:
    """By default: for PX4, which fuses both at once, none; ArduPilot may switch to it, for it takes one source at a time."""
    policy = OutputPolicy(AutopilotConfig(own_gnss_quality=gnss_quality))  # type: ignore[arg-type]

    def is_of_use(t_s: float) -> bool:
        quality = _quality(policy, _estimate(t_s), one_at_a_time=one_at_a_time)
        assert quality >= 0
        return quality > 0

    policy.note([_fused("gnss_position", 0)])
    assert is_of_use(0.1) == is_used
    policy.note([_fused("pose", 1)])
    assert is_of_use(1) == is_used
    policy.note([_fused("pose", 6)])
    assert is_of_use(6)
    policy.note([_fused("gnss_velocity", 7)])
    assert is_of_use(20) == is_used  # nothing from outside since


@pytest.mark.parametrize(
    ("radius_m", "quality"), [(0.0, 100), (0.1, 99), (5.0, 67), (14.0, 7), (14.99, 1), (15.01, -1), (1e5, -1)]
)
@pytest.mark.parametrize("mode", [Mode.AIDED, Mode.DEAD_RECKONING])
def test_the_quality_is_the_radius_and_ends_before_it_is_too_large(radius_m: float, quality: int, mode: Mode) -> None:
    policy = OutputPolicy(AutopilotConfig())
    policy.note([_fused("pose", 0)])
    estimate = _estimate(mode=mode, sigma=radius_m / 2.4477)  # 95 % of a circular normal distribution
    assert policy.quality(estimate, one_source_at_a_time=True) == (quality, quality > 0)


@pytest.mark.parametrize(
    ("sigma", "sigma_v", "px4", "ardupilot"),
    [(1.0, 9.0, (84, True), (84, True)), (20.0, 0.1, (76, False), (-1, False)), (20.0, 0.45, (-1, False), (-1, False))],
)
def test_px4_may_use_a_good_velocity_beside_a_position_that_it_may_not(
    sigma: float, sigma_v: float, px4: tuple[int, bool], ardupilot: tuple[int, bool]
) -> None:
    policy = OutputPolicy(AutopilotConfig())
    policy.note([_fused("pose", 0)])
    estimate = _estimate(mode=Mode.ODOMETRY, sigma=sigma, sigma_v=sigma_v)
    assert policy.quality(estimate, one_source_at_a_time=False) == px4
    assert policy.quality(estimate, one_source_at_a_time=True) == ardupilot


@pytest.mark.parametrize(("mode", "t_s", "quality"), [(Mode.ODOMETRY, 6, 98), (Mode.ODOMETRY, 4, 0), (Mode.DEAD_RECKONING, 6, 0)])
def test_odometry_after_its_own_gnss_is_news_to_the_autopilot_and_its_imu_is_not(mode: Mode, t_s: float, quality: int) -> None:
    policy = OutputPolicy(AutopilotConfig())
    policy.note([_fused("gnss_position", 0)])
    assert _quality(policy, _estimate(t_s, mode)) == quality


@pytest.mark.parametrize("mode", [Mode.COASTING, Mode.ALIGNING_HEADING, Mode.STARTING])
def test_what_is_not_to_be_used_has_no_quality(mode: Mode) -> None:
    assert _quality(OutputPolicy(AutopilotConfig()), _estimate(mode=mode)) == -1


def test_a_covariance_that_is_none_has_no_quality() -> None:
    assert _quality(OutputPolicy(AutopilotConfig()), _estimate(sigma=np.nan, sigma_v=np.nan)) == -1


def _counters(*sent: tuple[Estimate, int]) -> list[int]:
    policy = OutputPolicy(AutopilotConfig())
    return [policy.reset_counter(e, vec3(e.nav[X.P]), usable=quality >= 0) for e, quality in sent]


def test_the_counter_counts_the_steps_of_what_is_sent() -> None:
    jumped: Vec3 = (0.0, 12.0, 0.0)
    assert _counters((_estimate(), 50), (_estimate(0.1), 50), (_estimate(0.2), 50)) == [3, 3, 3]  # it flies, that is no step
    assert _counters((_estimate(), 50), (_estimate(0.1, p_n=jumped), 90), (_estimate(0.2, p_n=jumped), 90)) == [3, 4, 4]
    assert _counters((_estimate(), 50), (_estimate(0.1, p_n=(0.9, 0.0, 0.0)), 90)) == [3, 3]
    wide = _estimate(0.1, p_n=(2.0, 0.0, 0.0), sigma=1.0), 90
    assert _counters((_estimate(), 50), wide) == [3, 3]  # within its noise
    assert _counters((_estimate(), 50), (_estimate(0.1, p_n=jumped, counter=4), 90)) == [3, 4]  # the estimator's own, once
    assert _counters((_estimate(counter=255), 50), (_estimate(0.1, p_n=jumped, counter=255), 90)) == [255, 0]


def test_the_counter_counts_a_return_to_use() -> None:
    """The autopilot has gone on without, so it is somewhere else."""
    for period_s, counts in ((0.6, [3, 3, 3, 4, 4]), (0.1, [3, 3, 3, 3, 3])):  # a moment without its IMU is none
        sent = [(_estimate(period_s * k), quality) for k, quality in enumerate((90, -1, -1, 40, 40))]
        assert _counters(*sent) == counts
    assert _counters((_estimate(), 90), (_estimate(5.0), 90)) == [3, 4]  # nothing was sent meanwhile
