"""A receiver that the estimate rejects for long stays in the covariance, as far as a map may be wrong."""

import cmath
import math
import re

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.conflict import Apart, Conflicts
from estimator.sources.base.aid import Aid
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from models import so3
from models.frames import Origin
from models.measurements import Measurement
from models.messages import GnssFix, GnssVelocity, PoseFix
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, aid_of, fly, pose_fix, position_errors, radii, simulated, within

FLIGHT = """
duration_s = 100.0
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 1.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""
_S = np.diag([1.0, 4.0, 9.0])


def _apart(off: tuple[float, float, float], lasts_s: float = 5.0) -> Apart:
    return Apart(EPOCH_NS, EPOCH_NS + round(lasts_s * 1e9), np.array(off), _S, 9, False)


def test_what_is_added_is_the_share_of_a_mixture_and_fades_with_the_distance() -> None:
    d = np.array([5.0, 0.0, 0.0])
    expected = 0.05 * math.exp(-((5.0 / 20.0) ** 2)) * (_S + np.outer(d, d))
    np.testing.assert_allclose(_apart((5.0, 0.0, 0.0)).added(_apart((5.0, 0.0, 0.0)).by_map), expected)
    found = [_apart((off, 0.0, 0.0)) for off in (5.0, 20.0, 200.0)]
    reach = [2.8 * math.sqrt(apart.added(apart.by_map)[0, 0]) for apart in found]
    assert 5.0 / 3.0 < reach[0] < 5.0  # an error of 5 m is within three times the 95 % radius
    assert 20.0 / 3.0 < reach[1] < 8.0
    assert reach[2] < 1e-6


@pytest.mark.parametrize(("for_s", "lasts"), [(0.4, False), (1.0, True)])
def test_an_outlier_is_over_before_it_lasts(for_s: float, lasts: bool) -> None:
    assert _apart((10.0, 0.0, 0.0), for_s).lasts == lasts


@pytest.mark.parametrize(("off", "near"), [((0.5, 0.0, 0.0), True), ((0.0, 0.0, 2.0), True), ((2.0, 0.0, 0.0), False)])
def test_it_is_near_again_by_the_sigma_of_each_axis(off: tuple[float, float, float], near: bool) -> None:
    assert _apart(off).is_near == near


ORIGIN, HERE = Origin(47.0, 8.0, 500.0), np.zeros(3)


def _gnss(t_s: float, north_m: float) -> tuple[Aid, Measurement]:
    """A position that far north of the estimate, which is at HERE."""
    t_ns = EPOCH_NS + round(t_s * 1e9)
    aid = position_aid(GnssFix(t_ns, t_ns, *ORIGIN.to_geodetic(np.array((north_m, 0.0, 0.0))), np.eye(3)), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(ORIGIN)
    assert z is not None
    assert not isinstance(z, tuple)
    return aid, z


def _fix(fix: PoseFix) -> tuple[Aid, Measurement]:
    aid = aid_of(fix)
    z = aid.measurement(None)
    assert z is not None
    assert not isinstance(z, tuple)
    return aid, z


def _rejected(until_s: float, north_m: float = 5.0) -> Conflicts:
    found = Conflicts()
    for k in range(int(5 * until_s) + 1):
        found = found.judged(*_gnss(0.2 * k, north_m), HERE, is_rejected=True)
    return found


def test_a_receiver_that_fixes_refuse_counts_once_it_lasts() -> None:
    assert not _rejected(0.8).added({}).any()
    lasting = _rejected(1.0)
    np.testing.assert_allclose(lasting.added({}), lasting.apart["/gnss"].added(lasting.apart["/gnss"].by_map))
    assert lasting.added({})[0, 0] > 1.0


def test_a_receiver_is_not_outweighed_by_fixes_of_whose_path_its_own_is_turned() -> None:
    found = _places(("/a", 0.0), ("/gnss", 50.0))
    assert found.shares(doubts_imu=False) == {}
    assert found.shares(doubts_imu=False, turned=True) == {"/gnss": 1 / 2}


def test_a_source_that_was_near_the_former_estimate_is_no_outlier_and_has_not_jumped() -> None:
    near = Conflicts().judged(*_gnss(0.0, 0.1), HERE, is_rejected=False)
    other = replace(near, moved_ns=EPOCH_NS + SECOND // 10).judged(*_gnss(0.2, 20.0), HERE, is_rejected=True)
    assert other.apart["/gnss"].lasts
    assert not other.apart["/gnss"].jumped
    jumps = near.judged(*_gnss(0.2, 20.0), HERE, is_rejected=True)
    assert not jumps.apart["/gnss"].lasts
    assert jumps.apart["/gnss"].jumped
    returns = replace(near, moved_ns=EPOCH_NS + SECOND // 10).judged(*_gnss(60.0, 20.0), HERE, is_rejected=True)
    assert not returns.apart["/gnss"].lasts  # it may be an outlier


def _places(*of: tuple[str, float], seconds: float = 5.0, every_s: float = 0.5, before: Conflicts | None = None) -> Conflicts:
    """Sources so far north of the estimate; those further than 2 m are rejected."""
    found = before or Conflicts()
    for k in range(int(seconds / every_s) + 1):
        for topic, north_m in of:
            if topic.startswith("/gnss"):
                aid, z = _gnss(every_s * k, north_m)
                aid = replace(aid, topic=topic)
            else:
                t_ns = EPOCH_NS + round(every_s * k * 1e9)
                aid, z = _fix(replace(pose_fix(t_ns, (north_m, 0.0, 0.0)), topic=topic))
            found = found.judged(aid, z, HERE, is_rejected=abs(north_m) > 2.0)
    return found


@pytest.mark.parametrize(
    ("found", "shares"),
    [
        (_places(("/a", 0.0), ("/b", 50.0)), {"/b": 1 / 2}),
        (_places(("/a", 0.0), ("/b", 50.0), seconds=1.0), {}),
        (_places(("/a", 0.0), ("/gnss", 50.0)), {}),
        (_places(("/gnss", 0.0), ("/gnss/2", 50.0)), {"/gnss/2": 1 / 2}),
        (_places(("/gnss", 0.0), ("/b", 50.0)), {"/b": 1 / 2}),
        (_places(("/a", 0.0), ("/gnss", 0.5), ("/b", 50.0)), {}),
        (_places(("/a", 0.0), ("/gnss", 49.0), ("/b", 50.0), seconds=0.0), {"/b": 2 / 3, "/gnss": 2 / 3}),
        (_places(("/a", 0.0), ("/gnss", 1.9), ("/b", 3.5)), {"/b": 2 / 3}),
        (_places(("/a", 0.0), ("/gnss", 0.1), ("/b", 2.5)), {"/b": 1 / 2}),
        (_places(("/a", 0.0), ("/b", 50.0), ("/c", -50.0)), {"/b": 1 / 2, "/c": 1 / 2}),
        (_places(("/b", 50.0), before=_places(("/a", 0.0), ("/b", 0.0), seconds=1.0)), {}),
    ],
    ids=[
        "one-to-one",
        "too-short",
        "receiver",
        "two-receivers",
        "receiver-leads",
        "outvoted",
        "two-to-one",
        "receiver-nearer",
        "receiver-abstains",
        "all-differ",
        "jumped",
    ],
)
def test_witnesses_decide_by_their_number(found: Conflicts, shares: dict[str, float]) -> None:
    assert found.shares(doubts_imu=False) == pytest.approx(shares)


@pytest.mark.parametrize(("gnss_m", "b_m", "leads"), [(50.0, 50.0, True), (30.0, 50.0, False), (6.0, 6.0, False)])
def test_the_majority_leads_where_it_is_clear(gnss_m: float, b_m: float, leads: bool) -> None:
    """A receiver that is half-way, or whose sigma is a third of the distance, does not decide."""
    assert _places(("/a", 0.0), ("/gnss", gnss_m), ("/b", b_m)).outvotes("/b") == leads


def test_an_imu_that_contradicts_the_estimate_is_a_witness_and_a_source_is_forgotten() -> None:
    assert _places(("/a", 0.0), ("/gnss", 50.0), seconds=0.0).shares(doubts_imu=True) == pytest.approx({"/gnss": 2 / 3})
    assert not _places(("/a", 0.0), ("/b", 50.0)).without("/b").apart
    assert _places(("/a", 0.0), ("/b", 50.0)).without("/a").shares(doubts_imu=False) == {"/b": 1.0}


def test_positions_that_do_not_agree_with_one_another_are_no_witness() -> None:
    found, rng = Conflicts(), np.random.default_rng(1)
    for k in range(40):
        north, east, down = 100.0 * rng.standard_normal(3)
        found = found.judged(*_fix(pose_fix(EPOCH_NS + k * SECOND, (north, east, down))), HERE, is_rejected=True)
        assert not found.shares(doubts_imu=False)


@pytest.mark.parametrize(("north_m", "goes_on"), [(4.0, True), (0.5, False)])
def test_it_goes_on_until_a_position_is_near_also_where_the_position_is_accepted(north_m: float, goes_on: bool) -> None:
    after = _rejected(1.0).judged(*_gnss(2.0, north_m), HERE, is_rejected=False)
    assert ("/gnss" in after.apart) == goes_on


@pytest.mark.parametrize(("ago_s", "counts"), [(0.5, True), (1.5, False)])
def test_a_receiver_whose_velocity_was_just_rejected_is_in_conflict(ago_s: float, counts: bool) -> None:
    velocity = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (5.0, 0.0, 0.0), np.eye(3)), GnssConfig())
    assert isinstance(velocity, Aid)
    z = velocity.measurement(ORIGIN)
    assert z is not None
    assert not isinstance(z, tuple)
    found = Conflicts().judged(velocity, z, HERE, is_rejected=True)
    found = found.judged(*_gnss(ago_s, 5.0), HERE, is_rejected=False)
    assert ("/gnss" in found.apart) == counts


def test_a_pose_fix_counts_as_long_as_it_is_rejected_and_none_of_the_alignment_stays() -> None:
    aid, z = _fix(pose_fix(EPOCH_NS, (5.0, 0.0, 0.0)))
    rejected = Conflicts().judged(aid, z, HERE, is_rejected=True)
    assert "/pose_fix" in rejected.apart
    assert not rejected.judged(aid, z, HERE, is_rejected=False).apart
    aligning = Conflicts().compared(aid, z, HERE, disagrees=True)
    assert "/pose_fix" in aligning.apart
    assert not aligning.judged(aid, z, HERE, is_rejected=False).apart


def test_heights_of_another_datum_do_not_keep_the_alignment_from_its_end() -> None:
    flight = simulated(FLIGHT, seed=3)
    shifted = [replace(m, p_n=(*m.p_n[:2], m.p_n[2] + 50.0)) if isinstance(m, PoseFix) else m for m in flight.messages]
    run = fly(flight, messages=shifted)
    assert run.aligned[0].t_ns < EPOCH_NS + 3 * SECOND


@pytest.mark.parametrize("off_m", [5.0, 20.0])
def test_where_the_map_is_shifted_the_estimate_is_not_overconfident(off_m: float) -> None:
    flight = simulated(FLIGHT, seed=3)
    shifted = [replace(m, p_n=(m.p_n[0] + off_m, *m.p_n[1:])) if isinstance(m, PoseFix) else m for m in flight.messages]
    run = fly(flight, messages=shifted)
    late = [e for e in run.estimates if e.t_ns > EPOCH_NS + 60 * SECOND][::20]
    radius = np.array([2.8 * math.sqrt(np.linalg.eigvalsh(e.covariance[E.P, E.P])[-1]) for e in late])
    off = position_errors(late, flight.truth)
    assert off.mean() > 0.9 * off_m  # the fixes are followed
    assert (off > 3.0 * radius).mean() < 0.01
    assert np.median(radius) < 0.8 * off_m
    said = [h.detail for h in run.health if h.t_ns > EPOCH_NS + 60 * SECOND]
    assert any(
        re.match(r"/gnss is \d+\.\d m from the estimate for \d+ s: not used, but the covariance allows for", text)
        for text in said
    )


def test_a_receiver_that_is_hundreds_of_metres_off_does_not_widen_the_covariance_for_good() -> None:
    flight = simulated(FLIGHT, seed=3)
    spoofed = [replace(m, lat_deg=m.lat_deg + 300.0 / 111_320.0) if isinstance(m, GnssFix) else m for m in flight.messages]
    run = fly(flight, messages=spoofed)
    late = [e for e in run.estimates if e.t_ns > EPOCH_NS + 80 * SECOND][::20]
    radius = [2.8 * math.sqrt(np.linalg.eigvalsh(e.covariance[E.P, E.P])[-1]) for e in late]
    assert max(radius) < 2.5
    assert position_errors(late, flight.truth).max() < 1.0
    assert run.health[-1].detail.endswith("s: not used")


def test_where_a_map_is_turned_the_covariance_contains_the_receiver() -> None:
    """By 30 degrees about its origin, positions and headings: the IMU decides nothing, and a receiver does not turn its path."""
    flight, turn = simulated(FLIGHT, seed=3), math.radians(30.0)

    def turned(m: PoseFix) -> PoseFix:
        w, x, y, z = so3.multiply(np.array(so3.from_euler(0.0, 0.0, turn)), np.array(m.q_nb_wxyz)).tolist()
        at = complex(*m.p_n[:2]) * cmath.exp(1j * turn)
        return replace(m, p_n=(at.real, at.imag, m.p_n[2]), q_nb_wxyz=(w, x, y, z))

    run = fly(flight, messages=[turned(m) if isinstance(m, PoseFix) else m for m in flight.messages])
    late = within(run.estimates, 70.0, 100.0)
    off = position_errors(late, flight.truth)
    assert off.max() > 10.0
    assert (off < 1.5 * radii(late)).all()
    said = re.search(r"turned by (-?[\d.]+) deg, times ([\d.]+)", "\n".join(h.detail for h in run.health))
    assert said is not None
    assert float(said[1]) == pytest.approx(-30.0, abs=3.0)
    assert float(said[2]) == pytest.approx(1.0, abs=0.05)
