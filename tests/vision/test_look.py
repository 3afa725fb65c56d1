"""What one look at a picture takes for a landmark's colour."""

import numpy as np
import pytest

from vision.look import _roof_beside
from vision.outline import profiles

POINTS, HALF = 20, 8


@pytest.mark.parametrize(("raised", "expected"), [(True, 120.0), (False, 100.0)])
def test_what_lies_farther_inside_is_the_other_slope_of_a_roof_but_other_paint_of_a_mark(raised: bool, expected: float) -> None:
    """Grey value 100 on ground of 60, and 120 within a rim of 10 px: a gable in other light, or the disc of a helipad."""
    picture = np.full((200, 200, 3), 60, np.uint8)
    picture[60:140, 60:140], picture[70:130, 70:130] = 100, 120
    px = np.column_stack((np.full(POINTS, 60.0), np.linspace(85.0, 115.0, POINTS)))
    normal, usable, one = np.tile((-1.0, 0.0), (POINTS, 1)), np.ones(POINTS, dtype=np.bool_), np.ones(1, dtype=np.bool_)
    edge, landmark = np.zeros(POINTS, dtype=np.int64), np.zeros(1, dtype=np.int64)
    values = profiles(picture, px, normal, HALF, 1.0, 1, usable)
    beside = _roof_beside(picture, values, px, normal, edge, landmark, one, np.array([raised]), HALF, usable)
    np.testing.assert_allclose(beside, expected, atol=1.0)
