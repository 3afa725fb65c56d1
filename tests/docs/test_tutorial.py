"""The tutorial's commands run as they stand, one after the other."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from estimator.cli import app

ROOT = Path(__file__).parents[2]
COMMANDS = re.findall(r"^landfix (.*)$", (ROOT / "docs" / "tutorial_replay.md").read_text(), re.MULTILINE)


def test_every_command_of_the_first_tutorial_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "tutorial").mkdir(parents=True)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    said = {}
    for command in COMMANDS:
        result = CliRunner().invoke(app, shlex.split(command))
        assert result.exit_code == 0, f"landfix {command}\n{result.output}"
        said[command.split()[0]] = result.output
    assert set(said) == {"simulate", "doctor", "replay", "evaluate", "report"}
    assert "careless" in said["evaluate"]
    assert (tmp_path / "out" / "tutorial" / "report.html").stat().st_size > 100_000
