"""A follower that begins at a fix of a few directions jumps by what these measure, no further."""

import numpy as np
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import follower
from estimator.filter.hypotheses.hypothesis import Hypothesis
from estimator.sources.base.aid import Aid
from estimator.sources.landmark import landmark_aid
from estimator.sources.pose import PoseConfig
from models.imu import Coast, ImuNoise, constants
from models.measurements import DIRECTION_SCALE
from models.messages import LandmarkFix
from models.state import E, X

OFF_M, RADIAN_M = 40.0, DIRECTION_SCALE[-1]


def test_a_direction_that_mixes_place_and_turn_widens_the_turn_by_the_angle_that_explains_it() -> None:
    x = np.zeros(X.SIZE)
    x[X.Q] = (1.0, 0.0, 0.0, 0.0)
    lead = Hypothesis(Eskf(0, x, np.eye(E.SIZE) * 1e-4, constants(ImuNoise(), Coast(), None)))
    directions = np.array([[0.6, 0.0, 0.0, 0.0, 0.8, 0.0]]) * DIRECTION_SCALE
    whole = LandmarkFix(0, 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 1e6 * np.eye(6), None, (), 0.0, 0.0)
    fix = replace(whole, directions=directions, readings=np.array([OFF_M]))
    aid = landmark_aid(fix, PoseConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    before = follower.begin(lead, aid, z, np.zeros(3), 0.0, vouched=False)
    assert before is not None
    angle = OFF_M / (0.8 * RADIAN_M)
    assert np.sqrt(before.filter.cov[E.THETA, E.THETA].trace()) < 2.0 * angle
