import math

import numpy as np
import pytest

from models.frames import GRAVITY, Origin
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, PoseFix
from models.sim import faults

ORIGIN = Origin(47.4, 8.5, 450.0)
EPOCH_NS = 1_700_000_000_000_000_000
P_N = (10.0, 20.0, -30.0)


def flight() -> list[Input]:
    """Ten seconds: IMU at 20 Hz, GNSS and fixes at 2 Hz, everything punctual, the vehicle in one place."""
    messages: list[Input] = []
    lat, lon, alt = ORIGIN.to_geodetic(P_N)
    for k in range(200):
        t = EPOCH_NS + k * 50_000_000
        if k % 10 == 0:
            messages.append(GnssFix(t, t, lat, lon, alt, np.eye(3)))
            messages.append(GnssVelocity(t, t, (1.0, 2.0, 3.0), 0.01 * np.eye(3)))
            messages.append(PoseFix(t, t, P_N, (1.0, 0.0, 0.0, 0.0), np.eye(6)))
        messages.append(ImuSample(t, t, (0.1, 0.2, 0.3), (0.0, 0.0, -GRAVITY)))
    return messages


def strike(fault: faults.Fault, run_seed: int = 0) -> list[Input]:
    before = flight()
    after = fault.apply(before, EPOCH_NS, ORIGIN, run_seed)
    assert [m.arrived_ns for m in after] == sorted(m.arrived_ns for m in after)
    for old, pristine in zip(before, flight(), strict=True):  # the messages given are untouched
        assert same(old, pristine)
    return after


def same(a: Input, b: Input) -> bool:
    return repr(a) == repr(b)


def of(kind: type[Input], messages: list[Input]) -> list[Input]:
    return [m for m in messages if isinstance(m, kind)]


def seconds(messages: list[Input]) -> list[float]:
    return [(m.t_ns - EPOCH_NS) * 1e-9 for m in messages]


def place(message: Input) -> tuple[float, float, float]:
    assert isinstance(message, GnssFix)
    return ORIGIN.to_ned(message.lat_deg, message.lon_deg, message.alt_m)


def test_outside_interval_and_topics_nothing_changes() -> None:
    for fault in (
        faults.Drop(start_s=20.0, topics=("/imu",)),
        faults.SpoofJump(start_s=3.0, end_s=3.0),
        faults.NotFinite(topics=("/other",), share=1.0),
    ):
        assert all(same(a, b) for a, b in zip(strike(fault), flight(), strict=True))


def test_jam_silences_gnss_in_its_interval() -> None:
    after = strike(faults.Jam(start_s=2.0, end_s=5.0))
    for kind in (GnssFix, GnssVelocity):
        assert seconds(of(kind, after)) == pytest.approx([0.0, 0.5, 1.0, 1.5, *np.arange(5.0, 10.0, 0.5)])
    assert len(of(PoseFix, after)) == 20
    assert len(of(ImuSample, after)) == 200


def test_jammed_receiver_may_go_on_without_a_fix() -> None:
    after = strike(faults.Jam(start_s=2.0, end_s=5.0, silent=False))
    assert [m.status for m in after if isinstance(m, GnssFix)] == [0] * 4 + [-1] * 6 + [0] * 10
    assert len(of(GnssVelocity, after)) == 14


def test_spoof_jump_displaces_positions_only() -> None:
    after = strike(faults.SpoofJump(start_s=5.0, offset_n_m=(100.0, -50.0, 7.0)))
    for m in of(GnssFix, after):
        expected = np.add(P_N, (100.0, -50.0, 7.0)) if seconds([m])[0] >= 5.0 else P_N
        np.testing.assert_allclose(place(m), expected, atol=1e-6)
    assert {m.v_n for m in after if isinstance(m, GnssVelocity)} == {(1.0, 2.0, 3.0)}


def test_spoof_pull_grows_and_its_velocity_agrees() -> None:
    after = strike(faults.SpoofPull(start_s=4.0, end_s=8.0, rate_n_m_s=(0.5, 0.0, -1.0)))
    for m in of(GnssFix, after):
        since = seconds([m])[0] - 4.0
        pulled = since if 0.0 <= since < 4.0 else 0.0
        np.testing.assert_allclose(place(m), np.add(P_N, (0.5 * pulled, 0.0, -pulled)), atol=1e-6)
    v = [m.v_n for m in after if isinstance(m, GnssVelocity)]
    assert v[8] == (1.5, 2.0, 2.0)
    assert v[0] == v[16] == (1.0, 2.0, 3.0)


def test_meacon_reports_where_the_repeater_stands_at_rest() -> None:
    after = strike(faults.Meacon(place_n_m=(200.0, 100.0, -5.0)))
    places = np.array([place(m) for m in of(GnssFix, after)])
    np.testing.assert_allclose(places.mean(axis=0), (200.0, 100.0, -5.0), atol=4.5 / math.sqrt(20))
    assert 0.5 < places.std(axis=0).mean() < 1.5  # the receiver's own noise
    assert np.abs([m.v_n for m in after if isinstance(m, GnssVelocity)]).max() < 0.5


def test_positions_cannot_be_moved_without_an_origin() -> None:
    for fault in (faults.SpoofJump(), faults.SpoofPull(), faults.Meacon()):
        with pytest.raises(ValueError, match="origin"):
            fault.apply(flight(), EPOCH_NS, None)


def test_delay_is_constant_or_random() -> None:
    constant = of(PoseFix, strike(faults.Late(delay_s=0.3)))
    assert {m.arrived_ns - m.t_ns for m in constant} == {300_000_000}
    random = of(PoseFix, strike(faults.Late(delay_s=(0.0, 5.0))))
    delays = [(m.arrived_ns - m.t_ns) * 1e-9 for m in random]
    assert 0.0 <= min(delays) < 1.0
    assert 4.0 < max(delays) <= 5.0
    assert seconds(random) != sorted(seconds(random))  # out of order
    assert sorted(seconds(random)) == seconds(of(PoseFix, flight()))


def test_drop_takes_its_share() -> None:
    left = of(ImuSample, strike(faults.Drop(topics=("/imu",), share=0.3)))
    assert 110 < len(left) < 165


def test_imu_dropout() -> None:
    t = seconds(of(ImuSample, strike(faults.ImuDropout(start_s=3.0, end_s=4.0))))
    assert len(t) == 180
    assert not any(3.0 <= x < 4.0 for x in t)


def test_duplicates_are_the_same_message_again_later() -> None:
    after = of(PoseFix, strike(faults.Duplicate(share=1.0, delay_s=0.7)))
    assert len(after) == 40
    for t in {m.t_ns for m in after}:
        first, second = (m for m in after if m.t_ns == t)
        assert second.arrived_ns - first.arrived_ns == 700_000_000
        assert isinstance(first, PoseFix)
        assert isinstance(second, PoseFix)
        assert second.p_n == first.p_n
    assert 21 < len(of(PoseFix, strike(faults.Duplicate(share=0.5)))) < 39


def test_shuffle_delivers_each_window_at_its_end_in_another_order() -> None:
    after = of(PoseFix, strike(faults.Shuffle(window_s=2.5)))
    for m in after:
        end = 2.5 * (seconds([m])[0] // 2.5 + 1)
        assert 0.0 <= (m.arrived_ns - EPOCH_NS) * 1e-9 - end <= 1e-3
    assert len(after) == 20
    assert seconds(after) != sorted(seconds(after))
    assert seconds(after)[:5] != seconds(after)[5:10]


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_not_finite_reaches_every_kind(value: str) -> None:
    after = strike(faults.NotFinite(share=1.0, value=value))  # type: ignore[arg-type]
    for m in after:
        match m:
            case ImuSample():
                bad = m.accel_b[2]
            case GnssFix():
                bad = m.lat_deg
            case GnssVelocity():
                bad = m.v_n[0]
            case PoseFix():
                bad = m.p_n[0]
            case _:
                raise AssertionError
        assert not math.isfinite(bad)
    some = strike(faults.NotFinite(share=0.2, topics=("/imu",)))
    assert 20 < sum(math.isnan(m.accel_b[2]) for m in some if isinstance(m, ImuSample)) < 65


def test_zero_covariance() -> None:
    for m in strike(faults.ZeroCovariance(start_s=5.0)):
        if isinstance(m, ImuSample):
            continue
        covariance = m.covariance if isinstance(m, PoseFix) else m.covariance_n  # type: ignore[union-attr]
        assert covariance is not None
        assert np.any(covariance) == (seconds([m])[0] < 5.0)


def test_clock_step_moves_stamps_and_not_arrivals() -> None:
    after = of(PoseFix, strike(faults.ClockStep(start_s=5.0, step_s=-2.0)))
    assert [m.arrived_ns for m in after] == [m.arrived_ns for m in of(PoseFix, flight())]
    assert [m.t_ns - m.arrived_ns for m in after] == [0] * 10 + [-2_000_000_000] * 10


def test_wrong_units() -> None:
    def first(unit: str, kind: type[Input]) -> Input:
        return of(kind, strike(faults.WrongUnits(unit=unit)))[0]  # type: ignore[arg-type]

    gyro = first("deg/s", ImuSample)
    assert isinstance(gyro, ImuSample)
    assert gyro.gyro_b == pytest.approx(np.degrees([0.1, 0.2, 0.3]))
    accel = first("g", ImuSample)
    assert isinstance(accel, ImuSample)
    assert accel.accel_b == pytest.approx((0.0, 0.0, -1.0))
    free = first("no_gravity", ImuSample)
    assert isinstance(free, ImuSample)
    assert free.accel_b == pytest.approx((0.0, 0.0, 0.0))
    fix = first("feet", PoseFix)
    assert isinstance(fix, PoseFix)
    assert fix.p_n == pytest.approx(np.array(P_N) / 0.3048)
    gnss = first("feet", GnssFix)
    assert isinstance(gnss, GnssFix)
    assert gnss.alt_m == pytest.approx(ORIGIN.to_geodetic(P_N)[2] / 0.3048)


def test_equal_seeds_equal_faults_and_other_seeds_others() -> None:
    def drops(seed: int, run_seed: int) -> list[float]:
        return seconds(of(ImuSample, strike(faults.Drop(topics=("/imu",), share=0.5, seed=seed), run_seed)))

    assert drops(1, 1) == drops(1, 1)
    assert drops(1, 1) != drops(2, 1)
    assert drops(1, 1) != drops(1, 2)


def test_faults_compose_in_order() -> None:
    once = faults.Late(delay_s=0.2).apply(strike(faults.Duplicate(share=1.0, delay_s=0.5)), EPOCH_NS, ORIGIN)
    assert sorted({m.arrived_ns - m.t_ns for m in of(PoseFix, once)}) == [200_000_000, 700_000_000]
