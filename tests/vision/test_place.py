"""From a place of the coarse search to a fit."""

import numpy as np

from tests.vision.test_predict import MARKS, RIG, View, drawn, whole
from vision.coarse import Candidate
from vision.pictures import Pictures
from vision.place import Fitter
from vision.pose import PoseConfig
from vision.verify import Fitted, VerifyConfig, decided
from vision.visibility import MapError

LENGTH = np.full(len(MARKS), 100.0)


def place(view: View, east_m: float) -> Candidate:
    """The true pose, where the search thinks that every landmark is off the map by east_m."""
    shift_m = np.zeros((len(MARKS), len(MapError)))
    shift_m[:, MapError.EAST] = east_m
    return Candidate(view.p_n, view.R_nb, np.zeros(6), shift_m, 0.5 * LENGTH, LENGTH, 100.0)


def test_one_pose_from_two_places_is_one() -> None:
    """Where landmarks are off the map by what the search thought of them does not tell two poses apart."""
    view, config = whole(), VerifyConfig(moved_px=2.0)
    fitter = Fitter(RIG, PoseConfig(), VerifyConfig(), 6)
    tried = [fitter.fit(Pictures(view.left, view.right, ""), list(MARKS), place(view, e), drawn(view, 1)) for e in (0.0, 0.15)]
    assert all(isinstance(one, Fitted) for one in tried)
    assert isinstance(decided(tried, config), Fitted)
