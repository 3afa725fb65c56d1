"""Extracts that are not as their format says: one line that names the file."""

import time
from pathlib import Path

import pytest

from estimator.map_files.extract.footprint import Place
from estimator.map_files.extract.get import get
from estimator.map_files.extract.text import _joined
from models.maps.table import MapError

PLACE = Place(47.4, 8.5, 3000.0)


@pytest.mark.parametrize(
    "text",
    [
        '{"elements": [{"type": "way", "id": [1], "nodes": [1]}]}',
        '{"elements": [{"type":"relation","tags": {"building": "yes"}, "members": [{"type": "way", "role":"","geometry": 1}]}]}',
        '{"elements": [{"type": "way", "nodes": 7, "id": 1, "tags": {"building": "yes"}}]}',
        '{"type": "FeatureCollection", "crs": {"properties": []}, "features": []}',
    ],
)
def test_any_other_json_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(MapError) as found:
        get(path, PLACE)
    assert str(found.value).startswith(f"{path}: ")
    assert "\n" not in str(found.value)


def test_a_file_that_names_other_files_is_not_opened_by_gdal(tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    path = tmp_path / "a.gpkg"
    path.write_text(
        '<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>/etc/passwd</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>'
    )
    with pytest.raises(MapError, match=r"a.gpkg: is no .gpkg file by its first bytes"):
        get(path, PLACE)


def test_ways_are_joined_in_linear_time() -> None:
    n = 20_000
    ring = [(float(k % n), float(k % n) ** 0.5) for k in range(n + 1)]
    pieces = [ring[k : k + 2] if k % 3 else ring[k : k + 2][::-1] for k in range(n)]
    began = time.process_time()
    (joined,) = _joined(pieces[::2] + pieces[1::2])
    assert len(joined) == n + 1
    assert time.process_time() - began < 5.0
