from collections import Counter
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from calib.files.formats import load_cameras
from estimator.cli import app
from estimator.config import load
from estimator.tools import demo as demonstration
from logs.evaluation.evaluate import evaluate
from logs.store.reader import LogReader
from models.sim.scenario_file import loads

SHORT = """
duration_s = 36.0
[vehicle]
kind = "multirotor"
[gnss]
outages_s = [[12.0, 36.0]]
[pose_fix]
rate_hz = 0.5
delay_s = 0.3
outages_s = [[20.0, 30.0]]
"""

SHORTEST = """
duration_s = 18.0
[vehicle]
kind = "multirotor"
[imu]
rate_hz = 100.0
[gnss]
outages_s = [[8.0, 18.0]]
[pose_fix]
rate_hz = 1.0
outages_s = [[10.0, 17.0]]
"""

SEEN = """
duration_s = 54.0
origin = [47.3977, 8.5456, 488.0]
[vehicle]
kind = "multirotor"
speed_m_s = 8.0
area_m = 160.0
climb_m_s = 5.0
height_m = 75.0
[gnss]
outages_s = [[30.0, 54.0]]
[cameras]
rate_hz = 1.0
outages_s = [[0.0, 26.0]]
dark_s = [[40.0, 46.0]]
odometry = true
[cameras.world]
painted = 0.7
unmapped = 0.15
"""
FLOWN = ["demo.png", "demo.toml", "estimate.mcap", "input.mcap", "report.html"]


def command(scenario: str, *arguments: str) -> str:
    """What `landfix demo` prints, of another flight."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstration, "scenario_text", lambda: scenario)
        done = CliRunner().invoke(app, ["demo", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> demonstration.DemoResult:
    """As the command prints it for programs."""
    printed = command(SHORT, "-o", str(tmp_path_factory.mktemp("demo") / "out"), "--seed", "1", "--json")
    return msgspec.json.decode(printed, type=demonstration.DemoResult)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> demonstration.DemoResult:
    return demonstration.demo(tmp_path_factory.mktemp("seen") / "out", seed=1, scenario=SEEN)


def test_the_scenario_is_found_cuts_gps_at_one_third_and_covers_the_lens_for_a_while() -> None:
    scenario = loads(demonstration.scenario_text())
    assert scenario.gnss is not None
    assert scenario.gnss.outages_s == ((scenario.duration_s / 3, scenario.duration_s),)
    assert scenario.pose_fix is None
    assert scenario.cameras is not None
    ((dark, light),) = scenario.cameras.dark_s
    assert light - dark == 20.0
    assert scenario.duration_s / 3 < dark < light < scenario.duration_s


def test_everything_is_written(result: demonstration.DemoResult) -> None:
    assert sorted(p.name for p in Path(result.folder).iterdir()) == FLOWN
    assert result.overlay == ""
    assert load(Path(result.config)).map.origin is not None
    assert Path(result.picture).read_bytes().startswith(b"\x89PNG")
    assert 20_000 < Path(result.picture).stat().st_size < 300_000


def test_the_blackout_is_found_and_survived(result: demonstration.DemoResult) -> None:
    blackouts = [o for o in result.evaluation.outages if o.source == "all"]
    assert [round(o.duration_s) for o in blackouts] == [12]  # the last fix before it, 2 s apart, and 0.3 s of delay
    assert blackouts[0].drift is not None
    assert blackouts[0].radius95_end_m is not None
    assert blackouts[0].drift.end_m < 3.0 * blackouts[0].radius95_end_m
    assert result.evaluation.accuracy is not None
    assert 0.01 < result.evaluation.accuracy.aided_position_m.rmse < 1.0
    assert result.replay.internal_errors == 0
    assert sum(result.replay.fixes["/pose_fix"].values()) >= 12


@pytest.mark.long
def test_of_a_flight_with_cameras_map_rig_and_overlay_are_written_too(seen: demonstration.DemoResult) -> None:
    beside = ["map.geojson", "overlay.png", "rig.yaml", "without_odometry.mcap"]
    assert sorted(p.name for p in Path(seen.folder).iterdir()) == sorted([*FLOWN, *beside])
    assert Path(seen.overlay).read_bytes().startswith(b"\x89PNG")
    config = load(Path(seen.config))
    assert (config.map.landmarks, config.rig.file) == ("map.geojson", "rig.yaml")


@pytest.mark.long
def test_the_report_shows_what_the_cameras_saw_and_why_there_was_no_fix(seen: demonstration.DemoResult) -> None:
    page = Path(seen.report).read_text()
    assert 8 <= page.count("data:image/jpeg;base64,") <= 13
    assert ">fused</b>" in page
    assert ">no image</b>" in page
    assert "left: black" in page
    assert '"used":true' in page  # landmarks on the map
    assert "gyroscope bias" in page


@pytest.mark.long
def test_what_the_cameras_see_carries_on_without_gps_but_not_in_the_dark(seen: demonstration.DemoResult) -> None:
    assert seen.replay.internal_errors == 0
    assert 12 <= seen.replay.fixes["/landfix/fix"]["fused"] <= 22  # of 28 pairs 6 are dark
    (blackout,) = (o for o in seen.evaluation.outages if o.source == "all")
    assert 6.0 < blackout.duration_s < 9.0
    (without_gps,) = (o for o in seen.evaluation.outages if o.source == "/gnss")
    for outage in (blackout, without_gps):
        assert outage.drift is not None
        assert outage.radius95_end_m is not None
        assert 0.01 < outage.drift.end_m < 2.0 * outage.radius95_end_m < 6.0
    assert without_gps.duration_s > 20.0


@pytest.mark.long
def test_odometry_is_used_but_not_in_the_dark_and_the_flight_without_it_stands_beside(seen: demonstration.DemoResult) -> None:
    (blackout,) = (o for o in seen.evaluation.outages if o.source == "all")
    (without_gps,) = (o for o in seen.evaluation.outages if o.source == "/gnss")
    assert blackout.increments == 0
    assert without_gps.increments >= 5
    assert blackout.drift is not None
    assert blackout.without_odometry_m is not None
    assert 0.01 < blackout.without_odometry_m < 6.0
    without = evaluate(Path(seen.without_odometry), outage_s=5.0)
    assert not any(a.kind == "odometry" for a in without.aids)
    assert "Odometry in outages" in Path(seen.report).read_text()


@pytest.mark.long
def test_one_camera_carries_the_flight_as_well(tmp_path: Path) -> None:
    """No right image is rendered, recorded or waited for; fixes and odometry of the left one carry the estimate without GPS."""
    flown = demonstration.demo(tmp_path / "mono", seed=1, scenario=SEEN, one_camera=True)
    assert load_cameras(Path(flown.folder) / "rig.yaml").one_camera
    assert load(Path(flown.config)).inputs.right_image == ()
    with LogReader(Path(flown.log)) as reader:
        topics = Counter(record.topic for record in reader)
    assert topics["/left/image"] == 28
    assert "/right/image" not in topics
    assert flown.replay.internal_errors == 0
    assert 10 <= flown.replay.fixes["/landfix/fix"]["fused"] <= 22  # of 28 images 6 are dark
    (without_gps,) = (o for o in flown.evaluation.outages if o.source == "/gnss")
    assert without_gps.increments >= 5
    assert without_gps.drift is not None
    assert without_gps.radius95_end_m is not None
    assert 0.01 < without_gps.drift.end_m < 2.0 * without_gps.radius95_end_m < 6.0


def test_one_camera_of_a_scenario_without_cameras_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no \[cameras\]"):
        demonstration.demo(tmp_path / "none", scenario=SHORT, one_camera=True)


def test_the_command_prints_where_everything_is(tmp_path: Path) -> None:
    printed = command(SHORTEST, "-o", str(tmp_path / "out"))
    assert f"pictures: {tmp_path / 'out' / 'demo.png'}" in printed
    assert "of blackout" in printed
