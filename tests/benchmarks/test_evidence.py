"""The evidence pack names tests that exist, and what it cannot show."""

import ast
from pathlib import Path

import pytest

from benchmarks.drawn.faults import Fault
from benchmarks.evidence.pack import REQUIREMENTS, Requirement, document
from tests.benchmarks.test_drawn import flown

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=lambda r: r.name)
def test_the_tests_of_a_requirement_exist(requirement: Requirement) -> None:
    assert requirement.tests
    for test in requirement.tests:
        file, _, function = test.partition("::")
        tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_what_exceeds_the_level_stands_in_the_first_paragraph() -> None:
    fault = Fault("map north", 10.0, 5.0, 60.0)
    some = [flown(0, (), 2.5, 0), flown(1, (fault,), 1e-5, 1)]
    text = document(some, "- the campaign", 0.1)
    assert "**Not covered**: map north (GNSS and fixes); kinds that were not drawn" in text
    assert text.index("Not covered") < text.index("## Assumptions")
    assert "map north 10 deg from 5 to 60 s" in text
    assert "PL-3" in text
    assert "the map shifted by up to 3 m" in text  # the fault table of docs/integrity.md
    assert "- Attitude and velocity have no levels." in text
