"""The tree keeps its rules, and the drawing of its layers is that of the import contracts."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from docs.draw_architecture import OUT, drawn

ROOT = Path(__file__).parents[2]
PACKAGES = ("landfix", "estimator", "vision", "models", "calib", "logs")
FOLDERS = sorted({p.parent for top in (*PACKAGES, "benchmarks", "tests") for p in (ROOT / top).rglob("*.py")})
SOURCES = [f for f in FOLDERS if f.relative_to(ROOT).parts[0] != "tests"]


def _name(folder: Path) -> str:
    return folder.relative_to(ROOT).as_posix()


def test_the_drawing_is_that_of_the_contracts() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert OUT.read_text(encoding="utf-8") == drawn(project), "python -m docs.draw_architecture"


@pytest.mark.parametrize("folder", FOLDERS, ids=_name)
def test_a_folder_is_small_flat_and_does_not_repeat_its_name(folder: Path) -> None:
    files = [p.stem for p in folder.glob("*.py") if p.name != "__init__.py"]
    source_depth = len([part for part in folder.relative_to(ROOT).parts if part != "tests"])
    assert len(files) <= 15
    assert source_depth <= 3  # the file is the fourth
    assert [f for f in files if f.startswith((f"{folder.name}_", f"test_{folder.name}_"))] == []


@pytest.mark.parametrize("folder", SOURCES, ids=_name)
def test_a_folder_reports_what_it_is_for_and_what_it_may_import(folder: Path) -> None:
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    assert text
    assert folder.relative_to(ROOT).parts[0] == "benchmarks" or "ay import " in text


def test_tests_mirror_the_tree() -> None:
    of_packages = [
        f
        for f in FOLDERS
        if f.relative_to(ROOT).parts[0] == "tests" and f.relative_to(ROOT).parts[1:2] in [(p,) for p in PACKAGES]
    ]
    assert [_name(f) for f in of_packages if not (ROOT / f.relative_to(ROOT / "tests")).is_dir()] == []


def test_the_page_names_files_that_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    roots = (
        ROOT,
        ROOT / "estimator",
        ROOT / "logs" / "wire",
        ROOT / "estimator" / "sources",
        ROOT / "estimator" / "service" / "mavlink",
    )
    named = re.findall(r"`([a-z_0-9/]+(?:\.py|/))`", page)
    assert len(named) > 30
    assert [path for path in named if not any((root / path).exists() for root in roots)] == []


def test_the_page_is_one_page() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert len(page) < 4500  # beside the drawing, on A4
    assert page.count("![") == 1
