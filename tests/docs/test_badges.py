"""The badges say what pyproject.toml says, and targets of make that the README names exist."""

import re
import tomllib
from pathlib import Path

from docs.draw_badges import OUT, drawn, facts

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_badges_are_those_of_this_project() -> None:
    assert OUT.read_text(encoding="utf-8") == drawn(PROJECT), "python -m docs.draw_badges"
    assert dict(facts(PROJECT)) == {
        "licence": "Apache-2.0",
        "python": "3.11 and newer",
        "types": "mypy --strict",
        "checked by": "ruff, pytest",
    }


def test_make_has_the_targets_of_the_readme() -> None:
    asked = set(re.findall(r"(?:^|`)make ([a-z-]+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {"demo", "test", "site"} <= asked <= targets
