"""A flight of ArduPilot's simulator on landfix, GPS switched off: landfix' log and both of the autopilot's against the truth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from logs.importers import dataflash
from logs.importers.recording import Truth
from models.frames import Origin
from models.messages import OdometryPose
from tests import long

DATA = Path(__file__).parent / "data"
MAP = Origin(-35.366, 149.167, 590.0)  # of sitl.toml
GEOID_M = 19.5


def run(*args: object) -> str:
    result = CliRunner().invoke(app, [str(a) for a in args])
    assert result.exit_code == 0, result.output
    return result.stdout


def evaluated(log: Path, config: Path, folder: Path) -> Any:
    run("replay", log, "-o", folder / "estimate.mcap", "-c", config)
    return json.loads(run("evaluate", folder / "estimate.mcap", "--json"))


def test_replayed_the_estimate_is_near_the_truth_and_knows_how_near(tmp_path: Path) -> None:
    """Measured: 0.55 m RMSE while there are fixes, 5.1 m after 6.7 s without, all within the 95 % radius, NEES/3 0.58."""
    found = evaluated(DATA / "sitl.mcap", DATA / "sitl.toml", tmp_path)
    assert (found["compared_with"], found["compared"] > 350) == ("truth", True)
    assert found["accuracy"]["aided_position_m"]["rmse"] < 0.8
    assert found["accuracy"]["aided_position_m"]["max"] < 2.0
    assert found["accuracy"]["heading_deg"]["rmse"] < 1.5
    assert found["consistency"]["radius95_covered"] > 0.95
    assert 0.2 < found["consistency"]["position"]["mean"] < 1.5
    (blackout,) = (o for o in found["outages"] if o["source"] == "all")
    assert 6.0 < blackout["duration_s"] < 7.5
    assert blackout["drift"]["end_m"] < blackout["radius95_end_m"] < 12.0
    (gnss,) = (o for o in found["outages"] if o["source"] == "/gnss")
    assert gnss["duration_s"] > 20.0
    assert gnss["drift"]["end_m"] < 2.0


@long.parametrize(("kind", "name"), [("dataflash", "sitl.bin"), ("tlog", "sitl.tlog")])
def test_the_autopilots_logs_are_imported_and_replayed_against_the_truth(kind: str, name: str, tmp_path: Path) -> None:
    """There are no fixes in them, so GPS off is dead reckoning for 24 s; before and after it the position is that of GPS."""
    summary = json.loads(run("import", kind, DATA / name, "-o", tmp_path / "log.mcap", "--json"))
    assert "/truth is the state of the simulator" in summary["notes"]
    found = evaluated(tmp_path / "log.mcap", tmp_path / "log.toml", tmp_path)
    assert (found["compared_with"], found["compared"] > 350) == ("truth", True)
    assert found["accuracy"]["aided_position_m"]["rmse"] < 0.6
    assert found["accuracy"]["heading_deg"]["rmse"] < 3.0
    assert found["consistency"]["radius95_covered"] > 0.95
    field = next(aid for aid in found["aids"] if aid["kind"] == "magnetometer")
    assert "implausible" not in field["reasons"]
    assert field["reasons"]["fused"] > 20


def test_odometry_reached_the_autopilot_about_its_own_origin() -> None:
    """VISP is ODOMETRY as ArduPilot read it: metres from EKF3's origin, 344 m from the map's, near the simulator's truth."""
    recording = dataflash.read(DATA / "sitl.bin")
    assert recording.settings.origin is not None
    lat, lon, sea_m = recording.settings.origin
    assert np.linalg.norm(MAP.to_ned(lat, lon, sea_m + GEOID_M)[:2]) == pytest.approx(344.0, abs=3.0)
    sent = [m for m in recording if isinstance(m, OdometryPose)]
    truths = [m for m in recording if isinstance(m, Truth)]
    t_s = np.array([m.t_ns - truths[0].t_ns for m in truths]) * 1e-9
    at_s = np.array([m.t_ns - truths[0].t_ns for m in sent]) * 1e-9
    true_n = np.stack([np.interp(at_s, t_s, [m.p_n[axis] for m in truths]) for axis in range(3)], axis=1)
    off_m = np.linalg.norm((np.array([m.p_o for m in sent]) - true_n)[:, :2], axis=1)
    assert len(sent) > 1000
    assert np.median(np.diff(at_s)) < 0.04
    assert np.median(off_m) < 1.0
    assert off_m.max() < 7.0
