"""What a map costs by its size: 100, 10 000 and 1 000 000 landmarks, equally dense, as ratios (in brackets) within one table.

Loading reads a million landmarks each time, from one file or from many. Nothing is asserted about time.
"""

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from models.maps.landmarks import Columns, LandmarkMap

pytestmark = pytest.mark.benchmark(timer=time.process_time, disable_gc=False, warmup=False)

SIZES = (100, 10_000, 1_000_000)
SPACING_M = 40.0
PLACES = 100  # asked for in a round


def town(count: int) -> LandmarkMap:
    """Buildings of 4 to 8 corners on a square of streets, all with a colour."""
    rng = np.random.default_rng(count)
    side = round(count**0.5)
    north, east = np.divmod(np.arange(count), side)
    centres = SPACING_M * np.column_stack((north, east)) + rng.uniform(-8.0, 8.0, (count, 2))
    corners = rng.integers(4, 9, count)
    offsets = np.concatenate(([0], np.cumsum(corners)))
    turn = 2.0 * np.pi * (np.arange(offsets[-1]) - np.repeat(offsets[:-1], corners)) / np.repeat(corners, corners)
    radius = np.repeat(rng.uniform(4.0, 12.0, count), corners)
    vertices = np.repeat(centres, corners, axis=0) + radius[:, None] * np.column_stack((np.cos(turn), -np.sin(turn)))
    columns = Columns(
        ids=[f"b{i}" for i in range(count)],
        vertices=vertices,
        offsets=offsets,
        base_d=np.zeros(count),
        height_m=rng.uniform(3.0, 20.0, count),
        colour_bgr=rng.integers(0, 256, (count, 3)).astype(np.int16),
        sigma_m=np.full(count, 0.5),
        height_sigma_m=np.full(count, 1.0),
        outline_sigma_m=np.full(count, 0.3),
        corner_sigma_m=np.full(count, 0.3),
        weights={},
        names={},
    )
    return LandmarkMap((47.0, 8.0, 400.0), columns)


@pytest.mark.parametrize("count", SIZES)
@pytest.mark.benchmark(group=f"near(), {PLACES} places, 100 m around each")
def test_near(benchmark: BenchmarkFixture, count: int) -> None:
    the_map = town(count)
    edge = SPACING_M * count**0.5
    places = np.random.default_rng(0).uniform(0.25 * edge, 0.75 * edge, (PLACES, 2)).tolist()
    found = [len(the_map.near(north, east, 100.0)) for north, east in places]
    benchmark.extra_info["landmarks found"] = float(np.mean(found))
    benchmark.pedantic(lambda: [the_map.near(north, east, 100.0) for north, east in places], rounds=20)  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("count", SIZES)
@pytest.mark.benchmark(group=f"loading {SIZES[-1]} landmarks")
def test_load(benchmark: BenchmarkFixture, count: int) -> None:
    data = town(count).to_geojson()
    LandmarkMap.from_geojson(town(10).to_geojson())  # compiles
    benchmark.extra_info["file, MB"] = len(data) / 1e6

    def load() -> None:
        for _ in range(SIZES[-1] // count):
            LandmarkMap.from_geojson(data)

    benchmark.pedantic(load, rounds=1)  # type: ignore[no-untyped-call]
