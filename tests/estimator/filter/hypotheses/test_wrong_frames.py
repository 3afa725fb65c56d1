"""Fixes in another frame than they claim, beside a receiver and an IMU that are right: two witnesses against one."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.contradiction import SAYS
from models import so3
from models.messages import Array, PoseFix, vec3
from models.state import E
from tests import long
from tests.estimator.scenes import Run, fly, position_errors, simulated

ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MOST = 8  # filters at a time, those without a receiver included
UNCOVERED = 0.12  # while the fixes agree with the IMU in a straight climb
FLIGHT = "duration_s = 36.0\n[imu]\nrate_hz = 50.0\n[gnss]\n[pose_fix]\nrate_hz = 2.0\n"

Flown: TypeAlias = tuple[Callable[[PoseFix], PoseFix], Run, Array]


def _all(m: PoseFix) -> PoseFix:
    return replace(m, p_n=vec3(ENU @ m.p_n), q_nb_wxyz=so3.multiply(so3.from_matrix(ENU), np.asarray(m.q_nb_wxyz)))


def _positions(m: PoseFix) -> PoseFix:
    return replace(m, p_n=vec3(ENU @ m.p_n))


@pytest.fixture(scope="module", params=long.some([_all, _positions]), ids=["pose", "position"])
def flown(request: pytest.FixtureRequest) -> Flown:
    """The frame's error, the flight with it, and errors of its estimates [m]."""
    simulation = simulated(FLIGHT, seed=3)
    run = fly(simulation, messages=[request.param(m) if isinstance(m, PoseFix) else m for m in simulation.messages])
    return request.param, run, position_errors(run.estimates, simulation.truth)


def test_the_error_stays_within_three_sigma(flown: Flown) -> None:
    _, run, errors = flown
    sigma = np.array([np.sqrt(e.covariance[E.P, E.P].trace()) for e in run.estimates])
    assert len(errors) > 1000
    assert (errors > 3.0 * sigma).mean() < UNCOVERED


def test_poses_that_gravity_contradicts_begin_no_filter(flown: Flown) -> None:
    frame, run, errors = flown
    if frame is _all:
        assert SAYS in {s.detail for s in run.statuses if s.topic == "/pose_fix"}
        assert errors[-500:].max() < 3.0


def test_the_number_of_filters_is_bounded(flown: Flown) -> None:
    _, run, _ = flown
    assert max(h.hypotheses for h in run.health) <= MOST
