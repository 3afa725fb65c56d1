import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from estimator import demo as demonstration
from estimator.cli import app
from estimator.config import load
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


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> demonstration.DemoResult:
    return demonstration.demo(tmp_path_factory.mktemp("demo") / "out", seed=1, scenario=SHORT)


def test_the_scenario_is_found_and_cuts_gps_at_one_third() -> None:
    scenario = loads(demonstration.scenario_text())
    assert scenario.gnss is not None
    assert scenario.pose_fix is not None
    assert scenario.gnss.outages_s == ((scenario.duration_s / 3, scenario.duration_s),)
    assert scenario.pose_fix.rate_hz == 0.5
    assert scenario.pose_fix.delay_s == 0.3
    assert [end - start for start, end in scenario.pose_fix.outages_s] == [30.0]


def test_everything_is_written(result: demonstration.DemoResult) -> None:
    assert sorted(p.name for p in Path(result.folder).iterdir()) == ["demo.png", "demo.toml", "estimate.mcap", "input.mcap"]
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


def test_the_command_prints_where_everything_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(demonstration, "scenario_text", lambda: SHORT)
    text = CliRunner().invoke(app, ["demo", "-o", str(tmp_path / "out")])
    assert text.exit_code == 0, text.output
    assert f"picture: {tmp_path / 'out' / 'demo.png'}" in text.stdout
    assert "of blackout" in text.stdout
    printed = CliRunner().invoke(app, ["demo", "-o", str(tmp_path / "out"), "--json"])
    assert json.loads(printed.stdout)["replay"]["internal_errors"] == 0
