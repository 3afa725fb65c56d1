"""Alignment where GNSS and fixes disagree: it ends whichever is false, and the covariance covers both."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from models.messages import GnssFix, Input, Mode, PoseFix, vec3
from models.sim.scenario import EPOCH_NS
from tests import long
from tests.estimator.scenes import SECOND, fly, position_errors, radii, simulated, within

SLOW = """
duration_s = 60.0
[vehicle]
kind = "multirotor"
speed_m_s = 0.5
climb_m_s = 0.3
area_m = 10.0
height_m = 5.0
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 0.2
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""
FIRST_FIX_NS = EPOCH_NS + 19 * SECOND


@long.parametrize(("false", "off_m"), [("GNSS", 200.0), ("GNSS", 5000.0), ("the first fix", 200.0)])
def test_the_alignment_ends_and_the_covariance_covers_what_is_false(false: str, off_m: float) -> None:
    # GIVEN a vehicle too slow to show its heading, GNSS, and fixes each 5 s from 19 s on, one of the two far off
    flight, messages, first = simulated(SLOW, seed=3), list[Input](), True
    for m in flight.messages:
        if isinstance(m, PoseFix):
            if m.t_ns < FIRST_FIX_NS:
                continue
            is_false = first and false == "the first fix"
            messages.append(replace(m, p_n=(m.p_n[0] + off_m, *m.p_n[1:])) if is_false else m)
            first = False
        elif isinstance(m, GnssFix) and false == "GNSS":
            messages.append(replace(m, lat_deg=m.lat_deg + off_m / 111_320.0))
        else:
            messages.append(m)
    run = fly(flight, messages=messages)
    # WHEN two fixes have come
    late = [e for e in run.estimates if e.t_ns > FIRST_FIX_NS + 6 * SECOND]
    off, radius = position_errors(late[::20], flight.truth), radii(late[::20])
    # THEN there is an estimate most of the time, no error beyond three radii, and at the end it is aligned, right and certain
    span_s = 60.0 - (FIRST_FIX_NS - EPOCH_NS) / SECOND - 6.0
    assert len(late) > 0.8 * 100.0 * span_s
    assert (off < 3.0 * radius).all()
    assert late[-1].mode is not Mode.ALIGNING_HEADING
    assert off[-1] < 1.0
    assert radius[-1] < 2.0


FAST = 'duration_s = 15.0\n[vehicle]\nkind = "{kind}"\n[imu]\nrate_hz = 100.0\n[gnss]\nrate_hz = 5.0\n[pose_fix]\nrate_hz = 2.0\n'


@pytest.mark.parametrize(("kind", "seed"), [("fixed_wing", 3), ("fixed_wing", 11), ("multirotor", 10), ("multirotor", 21)])
def test_a_map_that_stands_20_m_off_the_receiver_aligns(kind: str, seed: int) -> None:
    """Positions of the receiver that the relinearised stretch leaves out were fused: no run confirmed the other."""
    flight, turn = simulated(FAST.format(kind=kind), seed), 2.0 * math.pi * np.random.default_rng(seed).random()
    off = 20.0 * np.array([math.cos(turn), math.sin(turn), 0.0])
    messages = [replace(m, p_n=vec3(np.array(m.p_n) + off)) if isinstance(m, PoseFix) else m for m in flight.messages]
    found = within(fly(flight, messages=messages).estimates, 8.0, 15.0)
    assert len(found) > 30
    assert (position_errors(found, flight.truth) < 3.0 * radii(found)).all()
