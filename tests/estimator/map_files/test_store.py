from pathlib import Path

import pytest

from estimator.config import ConfigError, load
from estimator.map_files import store as map_store
from models.maps.landmarks import Landmark, LandmarkMap
from models.maps.table import MapError

ORIGIN = (47.0, 8.0, 400.0)


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    path = tmp_path / "map.geojson"
    pad = Landmark.of("pad", [(0, 0), (0, 4), (4, 4), (4, 0)])
    path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, [pad]).to_geojson())
    return path


def test_the_origin_of_our_own_map_costs_no_landmark(ours: Path) -> None:
    """The features are not even looked at: here they are none."""
    head, _, _ = ours.read_bytes().partition(b"\n")
    ours.write_bytes(head + b"\n no landmarks at all")
    assert map_store.origin(ours) == ORIGIN
    with pytest.raises(MapError, match=r"map\.geojson: not a GeoJSON map"):
        map_store.load(ours)


def test_without_one_in_its_head_the_whole_map_is_read(ours: Path) -> None:
    data = ours.read_text()
    own = '"landfix":{"origin":[47.0,8.0,400.0],"version":1},'
    assert own in data
    ours.write_text(data.replace(own, ""))
    lat, lon, _ = map_store.origin(ours)
    assert (lat, lon) == pytest.approx(ORIGIN[:2], abs=1e-4)


def test_a_configuration_takes_the_origin_of_its_map(ours: Path) -> None:
    config = ours.with_name("vehicle.toml")
    config.write_text('[map]\nlandmarks = "map.geojson"\n')
    assert load(config).map.origin == ORIGIN
    ours.write_text("{")
    with pytest.raises(ConfigError, match=r"map\.geojson: not a GeoJSON map"):
        load(config)
