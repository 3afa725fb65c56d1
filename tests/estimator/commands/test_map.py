"""landfix map as a user calls it: polygons in, a map out, a picture of it, and what is wrong with it."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.tools.maps.ambiguity import look_alikes
from models.maps.landmarks import Landmark, LandmarkMap

ORIGIN = (47.0, 8.0, 400.0)


def run(*args: object) -> Result:
    return CliRunner().invoke(app, ["map", *map(str, args)])


def box(
    name: str, north: float, east: float, length: float, width: float, colour: tuple[int, int, int] | None = None
) -> Landmark:
    half = np.array([[length, width], [length, -width], [-length, -width], [-length, width]]) / 2
    return Landmark.of(name, half + np.array([north, east]), 0.0, 4.0, colour, 0.5, 0.5, 0.3)


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    """Three landmarks in red, green and unknown colour."""
    path = tmp_path / "yard.geojson"
    red, green = (30, 30, 200), (40, 160, 40)
    landmarks = [box("hangar", 0, 0, 40, 20, red), box("shed", 60, 50, 20, 20, green), box("pad", -60, 60, 10, 10)]
    path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, landmarks).to_geojson())
    return path


def footprints(path: Path, **properties: Any) -> Path:
    """One building and one bow tie, as somebody else writes them."""
    square = [[8.0, 47.0], [8.0002, 47.0], [8.0002, 47.0001], [8.0, 47.0001], [8.0, 47.0]]
    bow_tie = [[8.0, 47.0], [8.0001, 47.0001], [8.0001, 47.0], [8.0, 47.0001], [8.0, 47.0]]
    features = [
        {"type": "Feature", "id": name, "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
        for name, ring in (("good", square), ("bad", bow_tie))
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_build_writes_a_map_and_reports_what_it_left_out(tmp_path: Path) -> None:
    out = tmp_path / "map.geojson"
    source = footprints(tmp_path / "in.geojson", **{"building:levels": "2"})
    result = run("build", source, "-o", out, "--sigma-m", 0.8, "--origin", "47,8,400")
    assert result.exit_code == 0
    assert "landmarks 1, from 2 features; origin 47.000000, 8.000000, 400.0 m" in result.stdout
    assert "rejected: feature 2 (bad): the outline crosses itself" in result.stderr
    (landmark,) = LandmarkMap.from_geojson(out.read_bytes())
    assert (landmark.sigma_m, landmark.height_m) == (0.8, 6.0)
    assert landmark.length_m == pytest.approx(0.0002 * 111_320 * math.cos(math.radians(47.0)), rel=0.003)


def test_build_takes_the_height_it_is_reported(tmp_path: Path) -> None:
    out = tmp_path / "map.geojson"
    found = json.loads(run("build", footprints(tmp_path / "in.geojson"), "-o", out, "--height-m", 0, "--json").stdout)
    assert found["landmarks"] == 1
    assert found["report"]["missing"]["height_m"] == 1
    assert [finding["id"] for finding in found["report"]["rejected"]] == ["bad"]
    (landmark,) = LandmarkMap.from_geojson(out.read_bytes())
    assert (landmark.height_m, landmark.height_sigma_m, landmark.outline_sigma_m) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("command", ["build", "show"])
def test_without_a_landmark_nothing_is_written(tmp_path: Path, command: str) -> None:
    empty, out = tmp_path / "empty.geojson", tmp_path / "out.png"
    empty.write_text('{"type": "FeatureCollection", "features": []}')
    result = run(command, empty, "-o", out)
    assert result.exit_code == 1
    assert "no usable landmark" in result.stderr
    assert not out.exists()


@pytest.mark.parametrize("command", ["build", "show", "check"])
def test_what_is_no_map_gets_one_line(tmp_path: Path, command: str) -> None:
    torn = tmp_path / "torn.geojson"
    torn.write_text('{"type": "FeatureColl')
    for path, words in ((torn, "torn.geojson: not a GeoJSON map"), (tmp_path / "none.geojson", "No such file")):
        result = run(command, path, *([] if command == "check" else ["-o", tmp_path / "out.png"]))
        assert result.exit_code == 1
        assert words in result.stderr
        assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("args", [["--origin", "47,8"], ["--origin", "8,47,x"], ["--origin", "97,8,0"], ["--height-m", "-1"]])
def test_wrong_usage(tmp_path: Path, args: list[str]) -> None:
    result = run("build", footprints(tmp_path / "in.geojson"), "-o", tmp_path / "out.geojson", *args)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_the_picture_shows_every_landmark_in_its_colour(yard: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.png"
    assert run("show", yard, "-o", out).exit_code == 0
    picture = cv2.imread(str(out))
    assert picture is not None
    red, green = (np.all(np.abs(picture.astype(int) - colour) < 12, axis=2) for colour in ((30, 30, 200), (40, 160, 40)))
    assert np.sum(red) / np.sum(green) == pytest.approx(40 * 20 / (20 * 20), rel=0.1), "areas in proportion"
    (row_red, column_red), (row_green, column_green) = (np.argwhere(mask).mean(axis=0) for mask in (red, green))
    assert row_green < row_red, "60 m north is up"
    assert column_green > column_red, "50 m east is right"
    assert (row_red - row_green) / (column_green - column_red) == pytest.approx(60 / 50, rel=0.05)


def test_small_landmarks_are_drawn_over_large_ones(tmp_path: Path) -> None:
    path, out = tmp_path / "map.geojson", tmp_path / "map.png"
    landmarks = [box("yard", 0, 0, 60, 60, (40, 160, 40)), box("hut", 15, 15, 20, 20, (30, 30, 200))]
    for order in (landmarks, landmarks[::-1]):
        path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, order).to_geojson())
        assert run("show", path, "-o", out).exit_code == 0
        picture = cv2.imread(str(out))
        assert picture is not None
        green, red = (np.sum(np.all(np.abs(picture.astype(int) - c) < 12, axis=2)) for c in ((40, 160, 40), (30, 30, 200)))
        assert red / green == pytest.approx(400 / 3200, rel=0.15)


def test_pictures_have_known_endings(yard: Path, tmp_path: Path) -> None:
    result = run("show", yard, "-o", tmp_path / "map.docx")
    assert result.exit_code == 2
    assert ".png" in result.stderr
    assert run("show", yard, "-o", tmp_path / "map.svg").exit_code == 0


def test_many_and_odd_maps_are_drawn(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    row = [box(f"b{i}", 30.0 * i, 0.0, 10, 8) for i in range(40)]
    town = [box(f"b{i}", n, e, 12, 9, (90, 90, 160)) for i, (n, e) in enumerate(rng.uniform(-1500, 1500, (2500, 2)))]
    for name, landmarks in (("one", row[:1]), ("row", row), ("town", town)):
        path = tmp_path / f"{name}.geojson"
        path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, landmarks).to_geojson())
        result = run("show", path, "-o", path.with_suffix(".png"))
        assert result.exit_code == 0, result.output


def test_check_reports_what_is_missing(tmp_path: Path) -> None:
    result = run("check", footprints(tmp_path / "in.geojson"), "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert (found["landmarks"], found["features"], found["usable"]) == (1, 2, True)
    states = {c["name"]: c["state"] for c in found["checks"]}
    assert states["without height_m"] == states["without colour"] == states["rejected"] == states["landmarks"] == "warn"
    assert [(finding["feature"], finding["text"]) for finding in found["rejected"]] == [(2, "the outline crosses itself")]


def test_check_of_a_complete_map_has_nothing_to_say(yard: Path, tmp_path: Path) -> None:
    coloured = tmp_path / "coloured.geojson"
    landmarks = [x for x in LandmarkMap.from_geojson(yard.read_bytes()) if x.colour_bgr] + [
        box("pool", 90, -50, 25, 10, (200, 150, 0))
    ]
    coloured.write_bytes(LandmarkMap.from_landmarks(ORIGIN, landmarks).to_geojson())
    found = json.loads(run("check", coloured, "--json").stdout)
    assert {c["state"] for c in found["checks"]} == {"ok"}
    text = run("check", coloured)
    assert text.exit_code == 0
    assert "3, from 3 features" in text.stdout


def test_check_fails_when_nothing_is_usable(tmp_path: Path) -> None:
    path = tmp_path / "in.geojson"
    footprints(path)
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"features": data["features"][1:]}))
    result = run("check", path)
    assert result.exit_code == 1
    assert "the outline crosses itself" in result.stderr
    assert "fail" in result.stdout


def test_check_names_what_lies_in_another(tmp_path: Path) -> None:
    path = tmp_path / "map.geojson"
    path.write_bytes(LandmarkMap.from_landmarks(ORIGIN, [box("hall", 0, 0, 40, 20), box("part", 5, 3, 10, 8)]).to_geojson())
    assert json.loads(run("check", path, "--json").stdout)["nested"] == [{"outer": "hall", "inner": "part"}]
    assert "part lies in hall" in run("check", path).stderr


def test_similar_landmarks_are_near_and_of_one_kind() -> None:
    red, blue = (0, 0, 200), (200, 0, 0)
    the_map = LandmarkMap.from_landmarks(
        ORIGIN,
        [
            box("a", 0, 0, 12, 8, red), box("twin", 20, 0, 12, 8.3, red), box("blue", 0, 20, 12, 8, blue),
            box("grey", 20, 20, 8, 12), box("larger", 0, -20, 18, 12, red), box("far", 500, 0, 12, 8, red),
        ],
    )  # fmt: skip
    pairs, distances, similarities = look_alikes(the_map, 50.0, 0.9)
    names = the_map.columns.ids
    found = {(names[a], names[b]): k for k, (a, b) in enumerate(np.sort(pairs, axis=1).tolist())}
    assert set(found) == {("a", "twin"), ("a", "grey"), ("twin", "grey"), ("blue", "grey")}
    assert distances[found["a", "twin"]] == pytest.approx(20.0)
    ratio = 8 / 8.3
    expected = (0.20966 * ratio + 0.30413 * ratio + 0.302214 + 0.209658) / 1.025662
    assert similarities[found["a", "twin"]] == pytest.approx(expected, abs=1e-6)
    assert similarities[found["a", "grey"]] == pytest.approx(1.0)


def test_a_real_set_of_footprints_becomes_a_map(landfix_data: Path, tmp_path: Path) -> None:
    source = landfix_data / "images/spacenet_atlanta_footprints/geotiff_labels.geojson"
    out, picture = tmp_path / "map.geojson", tmp_path / "map.png"
    assert run("build", source, "-o", out, "--sigma-m", 1.0, "--origin", "33.638,-84.479,280").exit_code == 0
    assert run("show", out, "-o", picture).exit_code == 0
    found = json.loads(run("check", out, "--json").stdout)
    assert found["landmarks"] == 43
    assert found["origin"] == [33.638, -84.479, 280.0]
    assert 3 <= len(found["look_alikes"]) <= 20
