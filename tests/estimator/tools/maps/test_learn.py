"""A map is learned from one rendered flight with GPS, and flown with without GPS in another over the same village."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.replay import flight_images
from models.maps.landmarks import Landmark, LandmarkMap
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

SCENARIO = """
duration_s = 80.0
origin = [47.3977, 8.5456, 488.0]
[vehicle]
kind = "multirotor"
speed_m_s = 8.0
area_m = 100.0
climb_m_s = 5.0
height_m = 70.0
[gnss]
slow_sigma_m = 0.5
slow_tau_s = 60.0
outages_s = {without_gnss}
[cameras]
rate_hz = {rate_hz}
width = 480
height = 360
focal_px = 450.0
outages_s = [[0.0, 27.0]]
[cameras.world]
seed = 4
area_m = 220.0
painted = 0.8
sigma_m = 0.0
height_sigma_m = 0.0
outline_sigma_m = 0.0
"""
LEARNING = SCENARIO.format(without_gnss="[]", rate_hz=1.0)
FLYING = SCENARIO.format(without_gnss="[[34.0, 80.0]]", rate_hz=0.5)


def run(*args: object) -> Result:
    result = CliRunner().invoke(app, [str(arg) for arg in args])
    assert result.exit_code == 0, result.output
    return result


def simulated(scenario: Path, log: Path, seed: int) -> None:
    """The log and its configuration, which knows that this receiver has little slow error."""
    run("simulate", scenario, "-o", log, "--seed", seed)
    config = log.with_suffix(".toml")
    text = config.read_text()
    config.write_text(
        text.replace("[gnss]\n", "[gnss]\nslow_sigma_m = 0.5\n") if "[gnss]\n" in text else text + "[gnss]\nslow_sigma_m = 0.5\n"
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """learn.mcap with its configuration, and what was learned: learned.geojson, learned.json."""
    folder = tmp_path_factory.mktemp("learn")
    (folder / "scenario.toml").write_text(LEARNING)
    simulated(folder / "scenario.toml", folder / "learn.mcap", 3)
    learned = run(
        "map", "learn", folder / "learn.mcap", "--rig", folder / "learn_rig.yaml", "-c", folder / "learn.toml",
        "-o", folder / "learned.geojson", "--json",
    )  # fmt: skip
    (folder / "learned.json").write_text(learned.stdout)
    return folder


def things() -> list[Landmark]:
    """All that stands in the village, in the map or not."""
    plan = loads(LEARNING)
    assert plan.cameras is not None
    world = flight_images.plan(plan.cameras, simulate(plan, 3), 3).scene.world
    return [*world.landmarks, *(Landmark.of(f"c{k}", s.outline_n, s.base_d, s.height_m) for k, s in enumerate(world.clutter))]


def pairs(the_map: LandmarkMap) -> list[tuple[Landmark, Landmark]]:
    """Learned landmarks, each with the thing that it is."""
    there, found = things(), []
    for mark in the_map:
        apart = [np.hypot(*np.subtract(t.centre_n, mark.centre_n)) + 5.0 * abs(np.log(t.size_m2 / mark.size_m2)) for t in there]
        best = there[int(np.argmin(apart))]
        if min(apart) < 3.0:
            found.append((mark, best))
    return found


@pytest.mark.long
def test_what_is_learned_is_there_as_exactly_as_it_reports(flown: Path) -> None:
    the_map = LandmarkMap.from_geojson((flown / "learned.geojson").read_bytes())
    matched = pairs(the_map)
    assert len(the_map) >= 8
    assert len(matched) >= 0.85 * len(the_map)
    errors = np.array([[*np.subtract(m.centre_n, t.centre_n), m.roof_d - t.roof_d] for m, t in matched])
    own = np.array([[m.sigma_m, m.sigma_m, m.height_sigma_m] for m, _ in matched])
    common = np.array(the_map.common_sigma_m)[[0, 0, 1]]
    assert 0.35 < common[0] < 0.55 < common[2] < 1.1, "the slow error of GNSS"
    shift, rest = errors.mean(axis=0), errors - errors.mean(axis=0)
    assert np.sum((shift / common) ** 2) < 16.3, "99.9 %"
    assert 0.1 < np.mean((rest / own) ** 2) < 1.7
    assert np.mean(own[:, 0]) < 0.45
    sides = np.array([[m.width_m - t.width_m, m.length_m - t.length_m] for m, t in matched])
    assert np.median(np.abs(sides)) < 0.15


@pytest.mark.long
def test_the_summary_reports_what_became_of_the_images(flown: Path) -> None:
    summary = json.loads((flown / "learned.json").read_text())
    assert summary["images"] + sum(summary["skipped"].values()) == 53
    assert summary["images"] > 40
    assert min(summary["seen"].values()) >= 4
    assert summary["ground_alt_m"] == pytest.approx(488.0, abs=2.0)
    assert summary["left_out"]["seen in fewer than 4 images"] > 0


@pytest.mark.long
def test_the_map_is_one_that_check_accepts(flown: Path) -> None:
    checked: dict[str, Any] = json.loads(run("map", "check", flown / "learned.geojson", "--json").stdout)
    assert checked["usable"]
    assert checked["rejected"] == checked["remarks"] == checked["nested"] == []
    states = {check["name"]: check["state"] for check in checked["checks"]}
    assert [states[f"without {name}"] for name in ("height_m", "ground_alt_m", "sigma_m", "colour")] == ["ok"] * 4


@pytest.mark.long
def test_it_is_marked_automatic_until_somebody_has_checked_it(flown: Path, tmp_path: Path) -> None:
    def automatic(path: Path) -> tuple[bool, str]:
        states = {c["name"]: c["state"] for c in json.loads(run("map", "check", path, "--json").stdout)["checks"]}
        return LandmarkMap.from_geojson(path.read_bytes()).automatic, states["automatic"]

    assert automatic(flown / "learned.geojson") == (True, "warn")
    again, checked = tmp_path / "again.geojson", tmp_path / "checked.geojson"
    assert "marked automatic" in run("map", "build", flown / "learned.geojson", "-o", again).stderr
    assert automatic(again) == (True, "warn")
    run("map", "build", flown / "learned.geojson", "-o", checked, "--checked")
    assert automatic(checked) == (False, "ok")
    kept, was = (LandmarkMap.from_geojson(path.read_bytes()) for path in (checked, flown / "learned.geojson"))
    assert kept.common_sigma_m == was.common_sigma_m
    assert len(kept) == len(was)


@pytest.mark.long
def test_without_gps_it_carries_the_flight_and_the_covariance_is_consistent(flown: Path, tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(FLYING)
    simulated(tmp_path / "scenario.toml", tmp_path / "fly.mcap", 8)
    (tmp_path / "fly_map.geojson").write_bytes((flown / "learned.geojson").read_bytes())
    run("replay", tmp_path / "fly.mcap", "-o", tmp_path / "out.mcap", "-c", tmp_path / "fly.toml", "--from-images")
    found = json.loads(run("evaluate", tmp_path / "out.mcap", "--json").stdout)
    (without,) = (o for o in found["outages"] if o["source"] == "/gnss")
    (fixes,) = (aid["reasons"] for aid in found["aids"] if aid["topic"] == "/landfix/fix")
    assert fixes["fused"] >= 8
    assert fixes.get("gated", 0) <= 0.1 * fixes["fused"]
    assert 0.05 < without["drift"]["rmse_m"] < 2.0
    assert 0.03 < without["nees_position"] < 3.5, "the whole map's shift is in it, drawn once"
    assert without["radius95_end_m"] < 3.0


@pytest.mark.parametrize(
    ("more", "words"),
    [(["--pick", "reddish"], "'reddish'"), (["--least-frames", "1"], "least-frames")],
)
def test_wrong_usage(tmp_path: Path, more: list[str], words: str) -> None:
    arguments = ["map", "learn", str(tmp_path / "a.mcap"), "--rig", "rig.yaml", "-o", str(tmp_path / "out.geojson"), *more]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert words in result.stderr


@pytest.mark.long
def test_a_log_from_which_nothing_can_be_learned_gets_one_line(flown: Path, tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(LEARNING.replace("duration_s = 80.0", "duration_s = 40.0"))
    run("simulate", tmp_path / "scenario.toml", "-o", tmp_path / "dark.mcap", "--no-images")
    rest = ["--rig", str(flown / "learn_rig.yaml"), "-o", str(tmp_path / "out.geojson")]
    for log, words in ((tmp_path / "dark.mcap", "no image could be used"), (tmp_path / "none.mcap", "no such file")):
        result = CliRunner().invoke(app, ["map", "learn", str(log), *rest])
        assert result.exit_code == 1
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
