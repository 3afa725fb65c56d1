"""The scripts of docs/library.md run as they are written there, each in a process of its own, as a user would run them."""

import os
import re
import subprocess
import sys
from pathlib import Path

from estimator.replay.simulate import write
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "library.md"
SCENARIO = 'duration_s = 30.0\n[vehicle]\nkind = "multirotor"\n[imu]\nrate_hz = 100.0\n[gnss]\n'


def _scripts() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def _run(script: str, folder: Path) -> str:
    paths = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, env=paths, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_first_script_follows_the_circle_and_its_radius_grows_without_gps(tmp_path: Path) -> None:
    script = _scripts()[0]
    assert len([line for line in script.splitlines() if line.strip()]) <= 30
    rows = re.findall(r"(\d+) s  (\w+)  north (\S+) m  east (\S+) m  r95 (\S+) m", _run(script, tmp_path))
    modes = {int(row[0]): row[1] for row in rows}
    north, east, radius = ({int(row[0]): float(row[k]) for row in rows} for k in (2, 3, 4))
    assert modes[20] == "aided"
    assert modes[30] == "dead_reckoning"
    assert abs(north[20] - -37.8) < 1.0  # 50 sin(4 rad), 50 (1 - cos(4 rad))
    assert abs(east[20] - 82.7) < 1.0
    assert radius[30] > 2.0 * radius[20]


def test_the_second_script_replays_and_evaluates_a_log(tmp_path: Path) -> None:
    simulation = simulate(loads(SCENARIO), seed=1)
    write(simulation, tmp_path / "flight.mcap")
    (tmp_path / "flight.toml").write_text(simulation.config_toml)
    said = _run(_scripts()[1], tmp_path)
    assert re.search(r"^\d+ estimates, worst 95 % radius \d+\.\d m$", said, re.MULTILINE)
    assert float(re.findall(r"RMSE (\S+) m", said)[0]) < 5.0
    assert re.search(r"^[1-9]\d+ GNSS fixes$", said, re.MULTILINE)
