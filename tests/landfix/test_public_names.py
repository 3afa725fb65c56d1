"""The package re-exports: what it lists is there, comes from elsewhere, and is enough for every input and output."""

import ast
from pathlib import Path
from typing import get_args

import landfix
from models.messages import Input, Output

SOURCE = Path(landfix.__file__)


def test_it_has_imports_and_a_list_of_names_and_nothing_else() -> None:
    assert [p.name for p in SOURCE.parent.glob("*.py")] == ["__init__.py"]
    docstring, *body = ast.parse(SOURCE.read_text(encoding="utf-8")).body
    assert isinstance(docstring, ast.Expr)
    *imports, names = body
    assert {type(node) for node in imports} == {ast.ImportFrom}
    assert isinstance(names, ast.Assign)
    imported = {alias.asname or alias.name for node in imports if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported == set(landfix.__all__)


def test_every_message_a_user_passes_in_is_there() -> None:
    assert {t.__name__ for t in get_args(Input)} <= set(landfix.__all__)


def test_every_output_of_fusion_is_there() -> None:
    of_vision = {"VisionReport", "VisionRequest", "OdometryRequest"}  # of the daemon's visual front-end
    assert {t.__name__ for t in get_args(Output)} - of_vision <= set(landfix.__all__)
