"""A step of the recorded hand-held set, where the data are present."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.odometry import sets
from benchmarks.odometry.score import run


@pytest.fixture(autouse=True)
def _data(landfix_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not (landfix_data / "odometry").is_dir():
        pytest.skip("no recorded stereo pairs: LANDFIX_DATA has no odometry/")
    monkeypatch.setenv("LANDFIX_DATA", str(landfix_data))


def test_handheld() -> None:
    """Two seconds of turning and moving, 10 pairs a second."""
    scored = run(sets.euroc(sets.HANDHELD, 140).every(2))
    assert scored.lost <= 3
    assert np.median(np.linalg.norm(scored.errors[:, :3], axis=1)) < 0.003
    assert scored.nees.mean(axis=0).max() < 1.5
    assert (scored.nees < 16.3 / 3).all()


@pytest.mark.long
def test_car(landfix_data: Path) -> None:
    """KITTI 06: 60 m straight on; the constant scale that is known of the set."""
    scored = run(sets.kitti_pairs(landfix_data / "images" / "kitti06_0000_0050_stereo").every(2))
    assert scored.lost == 0
    assert scored.drift()[2] < 2.0
