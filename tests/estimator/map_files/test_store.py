from pathlib import Path

import pytest

from estimator.config import ConfigError, load
from models.maps.landmarks import Landmark, LandmarkMap

ORIGIN = (47.0, 8.0, 400.0)


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    path = tmp_path / "map.geojson"
    pad = Landmark.of("pad", [(0, 0), (0, 4), (4, 4), (4, 0)])
    path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, [pad]).to_geojson())
    return path


def test_a_configuration_takes_the_origin_of_its_map(ours: Path) -> None:
    config = ours.with_name("vehicle.toml")
    config.write_text('[map]\nlandmarks = "map.geojson"\n')
    assert load(config).map.origin == ORIGIN
    ours.write_text("{")
    with pytest.raises(ConfigError, match=r"map\.geojson: not a GeoJSON map"):
        load(config)
