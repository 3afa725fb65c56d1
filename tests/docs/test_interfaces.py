import re
from pathlib import Path

from typer.testing import CliRunner

from estimator.cli import app

PAGE = Path(__file__).parents[2] / "docs" / "interfaces.md"


def test_the_page_shows_what_doctor_prints() -> None:
    printed = CliRunner().invoke(app, ["doctor", "--config"]).stdout
    blocks = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 1
    assert blocks[0] == printed
