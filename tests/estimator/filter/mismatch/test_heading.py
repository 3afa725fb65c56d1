"""Headings of a source that are off by a constant: found from the motion, with their sigma, and never where there is nothing."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Hypothesis
from estimator.filter.mismatch import score
from estimator.filter.mismatch.heading import HEADING
from estimator.filter.mismatch.score import Sums
from models import so3
from models.imu import Coast, ImuNoise, constants
from models.measurements import Pose
from models.messages import Array, PoseFix
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests.estimator.scenes import Run, aid_of, error, fly, pose_fix, position_errors, simulated, within

U = np.zeros(6)
Q = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])


def _turned(q: Array, psi: float) -> Array:
    return so3.multiply(np.array([math.cos(psi / 2), 0.0, 0.0, math.sin(psi / 2)]), q)


def _eskf() -> Eskf:
    x = np.zeros(X.SIZE)
    x[X.Q] = Q
    return Eskf(EPOCH_NS, x, 0.01 * np.eye(E.SIZE), constants(ImuNoise(), Coast(), None))


def _pose(psi: float) -> Pose:
    return Pose(np.zeros(3), _turned(Q, psi), np.eye(6), np.arange(6))


def test_the_jacobian_is_how_a_turned_reading_differs() -> None:
    x, psi = _eskf().x, 1e-4
    j = HEADING.jacobian(_pose(0.0), x, U)
    assert j is not None
    turned, straight = (_pose(a).evaluate(x, U[:3])[0] for a in (psi, 0.0))
    np.testing.assert_allclose(j, (turned - straight) / psi, atol=1e-3)
    without = Pose(np.zeros(3), Q, np.eye(3), np.arange(3), "none")
    assert HEADING.jacobian(without, x, U) is None


def test_a_filter_that_was_aligned_with_turned_headings_foresees_them() -> None:
    eskf, z = _eskf(), _pose(0.0)
    score.begin(HEADING, eskf, "/fix", U)
    j = HEADING.jacobian(z, eskf.x, U)
    assert j is not None
    seen = eskf.innovation(z, U[:3], [(HEADING.block("/fix"), j[:, None])])
    assert np.abs(seen.hp[:, -1]).max() < 1e-20


def test_a_filter_that_is_aligned_anew_has_what_was_found_before_and_another_one_keeps_its_own() -> None:
    member, other, psi = Hypothesis(_eskf()), Hypothesis(_eskf()), math.radians(15.0)
    found = {HEADING.block("/pose_fix"): Sums(EPOCH_NS, 1e4, psi * 1e4, is_state=True)}
    for members in ([other], [member, other]):
        before = other.filter.cov.copy()
        score.carried([HEADING], aid_of(pose_fix(EPOCH_NS)), _pose(psi), U, found, members, alone=True)
    np.testing.assert_array_equal(other.filter.cov, before)
    at = member.filter.slow.columns[HEADING.block("/pose_fix")].start
    assert member.filter.slow.mean[at - E.SIZE] == pytest.approx(psi, rel=0.01)
    assert member.filter.slow.estimated[at - E.SIZE] == 1.0
    heading = so3.multiply(member.filter.x[X.Q], Q * np.array([1.0, -1.0, -1.0, -1.0]))
    assert 2.0 * math.asin(heading[3]) == pytest.approx(-psi, rel=0.02)  # it had the headings of the source


FLIGHT = """
duration_s = 60.0
[vehicle]
kind = "{kind}"
[imu]
rate_hz = 100.0
[pose_fix]
rate_hz = 2.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""


def _flown(kind: str, psi_deg: float, seed: int) -> tuple[Simulation, Run]:
    flight = simulated(FLIGHT.format(kind=kind), seed=seed)

    def turned(m: PoseFix) -> PoseFix:
        w, x, y, z = _turned(np.array(m.q_nb_wxyz), math.radians(psi_deg)).tolist()
        return replace(m, q_nb_wxyz=(w, x, y, z))

    return flight, fly(flight, messages=[turned(m) if isinstance(m, PoseFix) else m for m in flight.messages])


@pytest.mark.parametrize(("kind", "psi_deg"), [("multirotor", 20.0), ("multirotor", -10.0), ("fixed_wing", 8.0)])
def test_headings_that_are_off_are_found_and_no_longer_mislead(kind: str, psi_deg: float) -> None:
    flight, run = _flown(kind, psi_deg, seed=3)
    tracker = run.fusion._history.tracker
    assert tracker.core.hypotheses is not None
    lead = tracker.core.hypotheses.lead
    at = lead.slow.columns[HEADING.block("/pose_fix")].start
    found, sigma = math.degrees(lead.slow.mean[at - E.SIZE]), math.degrees(math.sqrt(lead.cov[at, at]))
    assert abs(found - psi_deg) < max(3.0 * sigma, 1.0)
    assert sigma < 2.0
    off = position_errors(within(run.estimates, 30.0, 60.0), flight.truth)
    assert math.sqrt((off**2).mean()) < 0.35
    side = "right" if psi_deg > 0.0 else "left"
    assert f"headings of /pose_fix are {abs(found):.1f} deg to the {side}" in run.health[-1].detail
    last = run.estimates[-1]
    turn = so3.matrix(last.nav[X.Q]) @ error(last, flight.truth)[E.THETA]
    assert abs(math.degrees(turn[2])) < 2.5
