"""The tracker: what it is at one instant depends on the measurements alone, and a copy goes its own way."""

import numpy as np
import pytest

from estimator.filter.alignment import InitialiseConfig, TrackerConfig
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.tracker import Tracker
from estimator.sources.base.aid import Aid
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from estimator.sources.gnss_anchor import GnssAnchor
from models.frames import Origin
from models.imu import Coast, ImuNoise
from models.messages import GnssFix, GnssVelocity, ImuSample, Mode, Reason
from models.sim.scenario import EPOCH_NS
from models.state import E, X
from tests.estimator.scenes import SECOND, aid_of, pose_fix

HOME = Origin(47.0, 8.0, 500.0)


def _tracker(origin: Origin | None = None) -> Tracker:
    return Tracker(TrackerConfig(imu=ImuNoise(), coast=Coast(), initialise=InitialiseConfig(), origin=origin))


def _samples(duration_s: float, force: float = 9.80665) -> ImuBuffer:
    buffer = ImuBuffer()
    for t in range(EPOCH_NS, EPOCH_NS + round(duration_s * SECOND) + 1, SECOND // 100):
        buffer.insert(ImuSample(t, t, (0.0, 0.0, 0.0), (0.0, 0.0, -force)))
    return buffer


def _take(tracker: Tracker, aid: Aid, samples: ImuBuffer) -> Reason:
    tracker.propagate(samples, aid.t_ns)
    return tracker.process(aid, samples).reason


def _aligned(samples: ImuBuffer, until_s: float = 4.0) -> Tracker:
    tracker = _tracker()
    for k in range(1, round(2 * until_s) + 1):
        _take(tracker, aid_of(pose_fix(EPOCH_NS + k * SECOND // 2)), samples)
    assert tracker.core.is_aligned
    return tracker


def _gnss(t_s: float) -> Aid:
    t = EPOCH_NS + round(t_s * SECOND)
    aid = position_aid(GnssFix(t, t, 47.0, 8.0, 500.0, np.eye(3) * 0.25), GnssConfig())
    assert isinstance(aid, Aid)
    return aid


def _velocity(t_s: float) -> Aid:
    t = EPOCH_NS + round(t_s * SECOND)
    aid = velocity_aid(GnssVelocity(t, t, (0.0, 0.0, 0.0), np.eye(3) * 0.01), GnssConfig())
    assert isinstance(aid, Aid)
    return aid


def test_a_copy_goes_its_own_way() -> None:
    samples = _samples(10.0)
    tracker = _aligned(samples)
    assert tracker.core.hypotheses is not None
    x, t_ns, sources = tracker.core.hypotheses.lead.x.copy(), tracker.core.t_ns, dict(tracker.sources)
    copy = tracker.copy()
    for k in range(9, 20):
        _take(copy, aid_of(pose_fix(EPOCH_NS + k * SECOND // 2, (0.3, 0.0, 0.0))), samples)
    _take(copy, aid_of(pose_fix(EPOCH_NS + 10 * SECOND, (30.0, 0.0, 0.0))), samples)
    np.testing.assert_array_equal(tracker.core.hypotheses.lead.x, x)
    assert (tracker.core.t_ns, tracker.sources, len(tracker.core.hypotheses.members)) == (t_ns, sources, 1)
    assert copy.core.hypotheses is not None
    assert copy.core.hypotheses.lead.x[X.P][0] > 0.1


def test_a_velocity_between_samples_is_seen_with_the_rate_of_its_own_time() -> None:
    """An antenna on a boom of 10 m goes at w x l: the rate grows by 0.1 rad/s in an IMU step, 1 m/s at the antenna."""
    samples, step_ns, share = ImuBuffer(), SECOND // 100, 0.3
    tracker, boom_m = _aligned(_samples(4.0)), 10.0
    for k in range(3):
        t = EPOCH_NS + 4 * SECOND + k * step_ns
        samples.insert(ImuSample(t, t, (0.0, 0.0, 0.1 * k), (0.0, 0.0, -9.80665)))
    t_ns = EPOCH_NS + 4 * SECOND + step_ns + round(share * step_ns)
    rate = 0.1 * (1.0 + share)
    velocity = GnssVelocity(t_ns, t_ns, (0.0, rate * boom_m, 0.0), np.eye(3) * 0.01)
    aid = velocity_aid(velocity, GnssConfig(antenna_b_m=(boom_m, 0.0, 0.0)))
    assert isinstance(aid, Aid)
    tracker.propagate(samples, t_ns)
    decision = tracker.process(aid, samples)
    np.testing.assert_allclose(decision.innovation, 0.0, atol=0.1)


def test_equal_measurements_make_equal_trackers() -> None:
    one, two = _aligned(_samples(5.0)), _aligned(_samples(5.0))
    assert one.core.hypotheses is not None
    assert two.core.hypotheses is not None
    np.testing.assert_array_equal(one.core.hypotheses.lead.x, two.core.hypotheses.lead.x)
    np.testing.assert_array_equal(one.core.hypotheses.lead.cov, two.core.hypotheses.lead.cov)


def test_the_mode_reports_what_the_estimate_rests_on() -> None:
    samples = _samples(30.0)
    fresh, tracker = _tracker(), _aligned(samples)
    assert fresh.mode(samples.newest_ns, EPOCH_NS) is Mode.STARTING
    at = tracker.core.last_absolute_ns
    assert tracker.mode(at, at) is Mode.AIDED
    assert tracker.mode(at + 3 * SECOND, at + 3 * SECOND) is Mode.AIDED
    assert tracker.mode(at + 3 * SECOND + 1, at + 3 * SECOND + 1) is Mode.DEAD_RECKONING
    assert tracker.mode(at, at + SECOND // 10) is Mode.AIDED
    assert tracker.mode(at, at + SECOND // 10 + 1) is Mode.COASTING


def test_while_it_waits_at_rest_the_mode_is_aligning() -> None:
    samples, tracker = _samples(5.0), _tracker(HOME)
    assert _take(tracker, _gnss(3.0), samples) is Reason.ALIGNING
    assert tracker.mode(samples.newest_ns, samples.newest_ns) is Mode.ALIGNING
    assert tracker.core.hypotheses is None


def test_a_stream_without_gravity_is_not_aligned() -> None:
    samples, tracker = _samples(5.0, force=0.0), _tracker()
    assert _take(tracker, aid_of(pose_fix(EPOCH_NS + 3 * SECOND)), samples) is Reason.ALIGNING
    assert tracker.core.hypotheses is None
    assert tracker.mode(samples.newest_ns, samples.newest_ns) is Mode.STARTING


def test_the_first_gnss_fix_is_the_origin_where_none_is_given() -> None:
    samples, tracker = _samples(5.0), _tracker()
    _take(tracker, _gnss(2.0), samples)
    assert tracker.core.origin == Origin(47.0, 8.0, 500.0)
    assert tracker.place == (47.0, 8.0, 500.0)


def test_but_not_once_fixes_on_a_local_map_have_been_taken() -> None:
    samples = _samples(6.0)
    tracker = _aligned(samples)
    assert _take(tracker, _gnss(4.5), samples) is Reason.NO_ORIGIN
    assert tracker.core.origin is None


def test_velocity_alone_starts_nothing() -> None:
    samples, tracker = _samples(5.0), _tracker(HOME)
    tracker.propagate(samples, EPOCH_NS + 2 * SECOND)
    decision = tracker.process(_velocity(2.0), samples)
    assert decision.reason is Reason.ALIGNING
    assert decision.detail == "waiting for a position"


def test_propagation_carries_every_hypothesis() -> None:
    samples = _samples(10.0)
    tracker = _aligned(samples)
    _take(tracker, aid_of(pose_fix(EPOCH_NS + 5 * SECOND, (20.0, 0.0, 0.0))), samples)
    assert tracker.core.hypotheses is not None
    assert len(tracker.core.hypotheses.members) == 2
    before = [float(np.trace(m.filter.cov[E.P, E.P])) for m in tracker.core.hypotheses.members]
    tracker.propagate(samples, EPOCH_NS + 8 * SECOND)
    assert [m.filter.t_ns for m in tracker.core.hypotheses.members] == [EPOCH_NS + 8 * SECOND] * 2
    after = [float(np.trace(m.filter.cov[E.P, E.P])) for m in tracker.core.hypotheses.members]
    assert all(b > a for a, b in zip(before, after, strict=True))


def test_the_last_known_gnss_grows_with_its_age() -> None:
    anchor = GnssAnchor((47.0, 8.0, 500.0), EPOCH_NS, sigma_m=3.0, speed_m_s=2.0)
    assert anchor.at(EPOCH_NS).sigma_m == pytest.approx(3.0)
    later = anchor.at(EPOCH_NS + 2 * SECOND)
    assert later.age_s == pytest.approx(2.0)
    assert later.sigma_m == pytest.approx(5.0)
    assert (later.lat_deg, later.lon_deg, later.alt_m) == (47.0, 8.0, 500.0)
