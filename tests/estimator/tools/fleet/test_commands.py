"""landfix fleet, as a person and a CI call it; the notebook of the examples."""

import json
from pathlib import Path

import duckdb
import pytest
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.tools.fleet import engine

ROOT = Path(__file__).parents[4]


def landfix(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["fleet", *map(str, arguments)])


@pytest.fixture(scope="module")
def results(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Label before, and label after with the antenna 5 m from where it is."""
    folder = tmp_path_factory.mktemp("results")
    changed = fleet / "changed.toml"
    text = (fleet / "vehicle.toml").read_text()
    assert "antenna_b_m = [0.0, 0.0, 0.0]" in text
    changed.write_text(text.replace("antenna_b_m = [0.0, 0.0, 0.0]", "antenna_b_m = [5.0, 0.0, 0.0]"))
    for label, config in (("before", fleet / "vehicle.toml"), ("after", changed)):
        done = landfix("run", f"{fleet}/[0-2].mcap", "-c", config, "-o", folder, "--label", label, "--jobs", 1)
        assert done.exit_code == 0, done.output
        assert "3 flights, dashboard http://127.0.0.1:" in done.stderr
    return folder


@pytest.mark.long
def test_a_wrong_antenna_is_found_and_breaks_the_budget(results: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    budget = ("--fail-if", "max_m worse 10 % on 50 %")
    done = landfix("compare", results, "--labels", "before,after", "-o", page, "--reports", 1, *budget)
    assert done.exit_code == 1
    assert "landfix: budget broken: max_m worse 10 % on 50 %: " in done.stderr
    assert (tmp_path / "page-reports/1-after.html").stat().st_size > 10_000
    assert '<a href="page-reports/1-after.html">after</a>' in page.read_text()
    assert landfix("compare", results, "--labels", "before,before", *budget).exit_code == 0


@pytest.mark.long
def test_rows_are_shown_and_asked(results: Path) -> None:
    assert {row["label"]: row["flights"] for row in json.loads(landfix("show", results, "--json").stdout)} == {
        "before": 3,
        "after": 3,
    }
    asked = landfix("show", results, "--sql", "SELECT max(rmse_m) AS m FROM rows", "--json")
    assert json.loads(asked.stdout)[0]["m"] > 0.0
    assert json.loads(landfix("show", results, "--failed", "--json").stdout) == []


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("run", "no/*.mcap", "-o", "{}"), "no/*.mcap: no log there"),
        (("run", "{}/x.txt", "-o", "{}"), "no list of logs can be read there"),
        (("run", "{log}", "-o", "{}", "--scheduler", "tcp://127.0.0.1:1"), "no scheduler answers"),
        (("run", "{log}", "-o", "{}", "--from-images"), "--from-images needs"),
        (("show", "{}/nothing"), "holds no rows"),
        (("compare", "{}/nothing", "--labels", "a,b"), "no label a"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], line: str
) -> None:
    monkeypatch.setattr(engine, "_ANSWERS", "0.5s")
    done = landfix(*(a.format(tmp_path, log=fleet / "0.mcap") for a in arguments))
    assert done.exit_code == 1
    assert line in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.long
def test_the_notebook_runs(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("results").symlink_to(results)
    scope: dict[str, object] = {}
    for cell in json.loads((ROOT / "examples/fleet.ipynb").read_text())["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), scope)
    assert duckdb.execute("SELECT count(*) FROM rows").fetchall() == [(6,)]
