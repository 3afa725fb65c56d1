"""Each shared hostile file through the commands that read it, in processes with a limit on CPU and memory."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import long
from tests.estimator.service.flying import environment

ROOT = Path(__file__).parents[2]
CASES = Path(os.environ.get("LANDFIX_DATA", ROOT.parent / "shared" / "data")).parent / "cases"


@long.parametrize(("areas", "least"), [(["image"], 5), (["log", "import", "map"], 25)])
def test_every_shared_attack_ends_in_one_line(areas: list[str], least: int, tmp_path: Path) -> None:
    if not (CASES / "attacks").is_dir():
        pytest.skip("no shared cases: set LANDFIX_DATA to the data folder that they lie beside")
    words = "--shared", "--areas", *areas, "--cases", str(CASES), "--out", str(tmp_path / "rows.jsonl")
    process = subprocess.run(
        [sys.executable, "-m", "benchmarks.attacks", *words], cwd=ROOT, env=environment(), capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stdout
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert len(rows) > least
    assert {row["verdict"] for row in rows} == {"held"}
    assert all(row["said"] for row in rows)
