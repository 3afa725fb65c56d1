"""A receiver that the estimate rejects for long stays in the covariance, as far as a map may be wrong."""

import math
import re

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.conflict import Apart
from models.messages import GnssFix, PoseFix
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, fly, position_errors, simulated

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
    return Apart(EPOCH_NS, EPOCH_NS + round(lasts_s * 1e9), np.array(off), _S)


def test_what_is_added_is_the_share_of_a_mixture_and_fades_with_the_distance() -> None:
    d = np.array([5.0, 0.0, 0.0])
    expected = 0.05 * math.exp(-((5.0 / 20.0) ** 2)) * (_S + np.outer(d, d))
    np.testing.assert_allclose(_apart((5.0, 0.0, 0.0)).added, expected)
    reach = [2.8 * math.sqrt(_apart((off, 0.0, 0.0)).added[0, 0]) for off in (5.0, 20.0, 200.0)]
    assert 5.0 / 3.0 < reach[0] < 5.0  # an error of 5 m is within three times the 95 % radius
    assert 20.0 / 3.0 < reach[1] < 8.0
    assert reach[2] < 1e-6


@pytest.mark.parametrize(("for_s", "lasts"), [(0.4, False), (1.0, True)])
def test_an_outlier_is_over_before_it_lasts(for_s: float, lasts: bool) -> None:
    assert _apart((10.0, 0.0, 0.0), for_s).lasts == lasts


@pytest.mark.parametrize(("off", "near"), [((0.5, 0.0, 0.0), True), ((0.0, 0.0, 2.0), True), ((2.0, 0.0, 0.0), False)])
def test_it_is_near_again_by_the_sigma_of_each_axis(off: tuple[float, float, float], near: bool) -> None:
    assert _apart(off).is_near == near


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
