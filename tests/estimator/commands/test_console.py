"""What is printed is text, whatever names hold."""

import pytest

from estimator.commands.common.console import print_table


def test_titles_and_cells_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("[/x].mcap", [("[bold]", "[/gnss]")], ("a", "b"))
    out = capsys.readouterr().out
    assert all(name in out for name in ("[/x].mcap", "[bold]", "[/gnss]"))
