"""What can be taken for something else: pairs, and arrangements that a shift finds again."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.tools.maps import ambiguity
from models.maps.landmarks import Landmark, LandmarkMap
from models.maps.table import Alike

ORIGIN = (47.0, 8.0, 400.0)
RED = (40, 40, 200)
PAINTS = [(205, 110, 25), (30, 190, 225), (70, 165, 35), (170, 40, 160), (235, 235, 235)]


def house(name: str, north: float, east: float, length: float = 14.0, colour: tuple[int, int, int] = RED) -> Landmark:
    half = np.array([[length, 9.0], [length, -9.0], [-length, -9.0], [-length, 9.0]]) / 2
    return Landmark.of(name, half + np.array([north, east]), 0.0, 4.0, colour, 0.5, 0.5, 0.3)


def terraces(rows: int = 3, columns: int = 5, north: float = 0.0) -> list[Landmark]:
    return [house(f"t{r}{c}", north + 30.0 * r, 24.0 * c) for r in range(rows) for c in range(columns)]


def village(north: float) -> list[Landmark]:
    """Fifteen that differ in colour or length, where the terraces would stand."""
    places = [(r, c) for r in range(3) for c in range(5)]
    return [house(f"v{k}", north + 30.0 * r, 24.0 * c, 10.0 + 5.0 * (k // 5), PAINTS[k % 5]) for k, (r, c) in enumerate(places)]


def marks(landmarks: list[Landmark], radius_m: float = 50.0) -> dict[str, tuple[int, float, float]]:
    the_map = LandmarkMap.from_landmarks(ORIGIN, landmarks)
    pairs, distances, _ = ambiguity.look_alikes(the_map, radius_m, 0.9)
    found: Alike = ambiguity.marks(the_map, pairs, distances)
    rows = zip(found.count.tolist(), found.nearest_m.tolist(), found.repeats_m.tolist(), strict=True)
    return dict(zip(the_map.columns.ids, rows, strict=True))


def test_how_many_and_how_near() -> None:
    found = marks([house("a", 0, 0), house("b", 0, 30), house("c", 0, 70), house("d", 0, 300), house("e", 20, 0, 25.0)])
    assert found["a"][:2] == pytest.approx((1, 30.0))
    assert found["b"][:2] == pytest.approx((2, 30.0))
    assert found["c"][:2] == pytest.approx((1, 40.0))
    assert found["d"][:2] == found["e"][:2] == (0, np.inf)


def test_a_row_of_houses_is_found_again_a_house_further() -> None:
    found = marks([*terraces(), *village(-200.0)])
    assert all(found[f"t{r}{c}"][2] == pytest.approx(24.0) for r in range(3) for c in range(5))
    assert all(found[f"v{k}"] == (0, np.inf, np.inf) for k in range(15))


def test_two_that_are_alike_among_others_that_differ_are_no_arrangement() -> None:
    landmarks = [*village(0.0)[1:], house("a", 0.0, 0.0), house("b", 12.0, -20.0)]
    assert marks(landmarks)["a"] == pytest.approx((1, np.hypot(12, 20), np.inf))


def test_what_differs_in_between_breaks_the_repetition() -> None:
    """Of a terrace every second house painted in colours of its own: most of what is in view is no longer the same."""
    landmarks = terraces()
    for k in range(0, 15, 2):
        landmarks[k] = house(landmarks[k].id, *landmarks[k].centre_n, 14.0 + 4.0 * (k % 3), PAINTS[k // 2 % 5])
    found = marks(landmarks)
    assert not any(repeat < np.inf for _, _, repeat in found.values())
    assert found["t01"][0] > 0


def test_it_is_written_into_the_map_said_and_drawn(tmp_path: Path) -> None:
    source, out, image = tmp_path / "in.geojson", tmp_path / "map.geojson", tmp_path / "map.png"
    source.write_bytes(LandmarkMap.from_landmarks(ORIGIN, [*terraces(), *village(-200.0)]).to_geojson())
    built = CliRunner().invoke(app, ["map", "build", str(source), "-o", str(out)])
    assert built.exit_code == 0
    assert "15 of 30 landmarks look like another one near by" in built.stderr
    written = {f["id"]: f["properties"] for f in json.loads(out.read_bytes())["features"]}
    # of t00 within 50 m: t01, t02, t10, t11 and no more
    assert [written["t00"][key] for key in ("look_alikes", "look_alike_m", "repeats_m")] == [4, 24.0, 24.0]
    assert not {"look_alikes", "look_alike_m", "repeats_m"} & set(written["v3"])
    checked = json.loads(CliRunner().invoke(app, ["map", "check", str(out), "--json"]).stdout)
    assert [r["id"] for r in checked["repeats"]] == [landmark.id for landmark in terraces()]
    assert {c["name"]: c["state"] for c in checked["checks"]}["repetition"] == "warn"
    assert "repeated arrangements" in CliRunner().invoke(app, ["map", "check", str(out)]).stdout
    assert CliRunner().invoke(app, ["map", "show", str(out), "-o", str(image)]).exit_code == 0
    drawn = cv2.imread(str(image))
    assert drawn is not None
    magenta = np.all(np.abs(drawn.astype(int) - (204, 0, 204)) < 40, axis=2)
    rows = np.flatnonzero(magenta.any(axis=1))
    assert magenta.sum() > 1000
    assert rows.min() < 0.3 * len(drawn), "the terraces stand in the north"


def test_too_dense_a_map_is_written_without_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ambiguity, "MOST_PAIRS", 10)
    assert ambiguity.marked(LandmarkMap.from_landmarks(ORIGIN, terraces())) is None


def test_an_empty_map_has_none() -> None:
    found = ambiguity.marked(LandmarkMap.from_landmarks(ORIGIN, []))
    assert found is not None
    assert len(found.count) == 0
