"""How right the disparities of `correspond` are on recorded pairs, region by region.

    python -m pytest benchmarks/fixes/test_disparity.py -q -s

Nothing is asserted.
"""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.flights.tasks import data_folder
from models.messages import Array
from tests.vision import real_pairs
from tests.vision.real_pairs import RealPair
from vision.describe.correspond import Match, Search, correspond
from vision.describe.regions import Limits
from vision.describe.survey import Settings, grey, segment_regions


def _line(name: str, errors: Array, regions: Array) -> str:
    return (
        f"{name:24s} {len(regions):4d} regions: median |error| {np.median(np.abs(regions)):.3f} px, "
        f"90 % {np.percentile(np.abs(regions), 90):.2f} px; {len(errors):5d} cells: median {np.median(np.abs(errors)):.3f} px, "
        f"> 2 px {(np.abs(errors) > 2).mean():.1%}"
    )


def _errors(pair: RealPair) -> tuple[Array, Array]:
    settings = Settings(limits=Limits(least_px=200), search=Search(nearest_m=pair.nearest_m))
    found = correspond(grey(pair.left), grey(pair.right), segment_regions(pair.left, None, settings), pair.rig, settings.search)
    cells, regions = [], []
    for match in found:
        if isinstance(match, Match):
            error = match.disparities - real_pairs.at(pair.truth, match.points)
            error = error[np.isfinite(error)]
            if len(error) >= 5:
                cells.append(error)
                regions.append(float(np.median(error)))
    return np.concatenate(cells), np.array(regions)


def test_disparity_on_recorded_pairs() -> None:
    """Region by region: the median of its cells' errors against the truth at the same positions."""
    folder = data_folder()
    if not (folder / "images").is_dir():
        pytest.skip("no recorded images: set LANDFIX_DATA to the folder that holds images/")
    makers: list[tuple[str, Callable[[], list[RealPair]]]] = [
        ("Middlebury motorcycle", lambda: [real_pairs.motorcycle(folder)]),
        ("Middlebury aloe", lambda: [real_pairs.aloe(folder)]),
        ("KITTI 06 against SGM", lambda: [real_pairs.kitti(folder, k) for k in range(0, 51, 5)]),
    ]
    print()
    for name, make in makers:
        parts = [_errors(pair) for pair in make()]
        print(_line(name, np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])))
