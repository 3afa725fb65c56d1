"""Real photos with the tags that their drone wrote: located by landfix locate with nothing else."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.aerial import brighton
from estimator.cli import app
from tests.real.tagged_photos import tagged


@pytest.fixture(scope="module")
def photos(landfix_data: Path) -> Path:
    if not (landfix_data / brighton.FOLDER).is_dir():
        pytest.skip("no photos: LANDFIX_DATA has no images/brighton_beach_uav")
    return landfix_data


def test_a_photo_of_a_phantom_3_is_located_by_its_tags(photos: Path, tmp_path: Path) -> None:
    """Within its own 95 % of the reference, and of the GPS in its tags, which is that of the map."""
    landmarks, name = brighton.landmark_map(), "DJI_0034.jpg"
    result = CliRunner().invoke(
        app,
        [
            "locate",
            str(tagged(photos, name, tmp_path)),
            "--map",
            str(brighton.MAP_FILE),
            "--json",
            "-o",
            str(tmp_path / "seen.png"),
        ],
    )
    assert result.exit_code == 0, result.output
    assert "camera by its tag FocalLengthIn35mmFilm" in result.stderr
    found, where = json.loads(result.stdout), brighton.references(photos, landmarks, [name])[name]
    off = np.array(found["with_prior"]["p_n_m"]) - where.p_nc
    assert np.linalg.norm(off) < min(2.0, found["with_prior"]["within_m"])
    assert {"island west", "island east"} <= set(found["fix"]["landmarks"])
    assert abs(found["with_prior"]["yaw_deg"] - 41.7) < 1.0


def test_a_photo_that_a_viewer_turned_is_refused_and_remarked_on(photos: Path, tmp_path: Path) -> None:
    """DJI_0026 stands on its head, its tags do not."""
    photo = tagged(photos, "DJI_0026.jpg", tmp_path)
    result = CliRunner().invoke(app, ["locate", str(photo), "--map", str(brighton.MAP_FILE)])
    assert result.exit_code == 1
    assert "saved by Microsoft Windows Photo Viewer" in result.stderr
