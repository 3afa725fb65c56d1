import csv
import io
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from logs.evaluation.evaluate import evaluate
from logs.evaluation.records import Evaluation
from logs.evaluation.runs import Run, comma_separated, compare_runs, markdown, print_runs
from tests.logs import flight_log
from tests.logs.flight_log import Flight


@pytest.fixture(scope="module")
def evaluations(tmp_path_factory: pytest.TempPathFactory) -> list[Evaluation]:
    """A consistent flight, one that is too sure of itself, and one without truth."""
    folder = tmp_path_factory.mktemp("runs")
    flights = {
        "consistent": Flight(duration_s=60.0, outages=((20.0, 30.0),)),
        "sure": Flight(duration_s=60.0, outages=((20.0, 30.0),), error_scale=3.0),
        "alone": Flight(duration_s=60.0, outages=((20.0, 30.0),), truth=False),
    }
    for name, flight in flights.items():
        flight_log.write(folder / f"{name}.mcap", flight)
    return [evaluate(folder / f"{name}.mcap") for name in flights]


def test_a_row_reports_what_the_evaluation_reports(evaluations: list[Evaluation]) -> None:
    consistent, sure, alone = compare_runs(evaluations)
    e = evaluations[0]
    assert e.accuracy is not None
    assert e.consistency is not None
    assert (consistent.run, consistent.duration_s, consistent.position_m) == (
        "consistent",
        e.duration_s,
        e.accuracy.position_m.rmse,
    )
    (outage,) = (o for o in e.outages if o.source == "all")
    assert outage.drift is not None
    assert consistent.longest_outage_s == outage.duration_s
    assert consistent.outage_end_m == pytest.approx(outage.drift.end_m)
    assert consistent.nees_position == e.consistency.position.mean
    assert consistent.fused + consistent.not_fused == sum(n for a in e.aids for n in a.reasons.values())
    assert consistent.fused == sum(a.reasons["fused"] for a in e.aids)
    assert consistent.position_m is not None
    assert sure.position_m == pytest.approx(3.0 * consistent.position_m)
    assert alone.position_m is alone.nees_position is alone.inside95 is None
    assert alone.without_absolute_s == consistent.without_absolute_s


def test_markdown_marks_the_best_and_ends_with_the_medians(evaluations: list[Evaluation]) -> None:
    runs = compare_runs(evaluations)
    header, rule, consistent, sure, alone, median = (line.strip("| \n").split(" | ") for line in markdown(runs).splitlines())
    assert len({len(row) for row in (header, rule, consistent, sure, alone, median)}) == 1
    at = header.index("RMSE m")
    assert consistent[at].startswith("**")
    assert not sure[at].startswith("**")
    assert alone[at] == "-"
    assert consistent[header.index("NEES p")].startswith("**")  # nearest to 1, though not always the least
    assert median[0] == "median"
    assert float(median[at]) == pytest.approx(0.5 * sum(float(r[at].strip("*")) for r in (consistent, sure)), rel=0.01)
    assert "median" not in markdown(runs[:2])


def test_a_nees_far_below_one_is_not_the_best(evaluations: list[Evaluation]) -> None:
    consistent = compare_runs(evaluations)[0]
    timid = msgspec.structs.replace(consistent, run="timid", nees_position=0.01, inside95=1.0)
    right = msgspec.structs.replace(consistent, run="right", nees_position=1.1, inside95=0.95)
    lines = markdown([timid, right]).splitlines()
    assert "**1.1**" in lines[3]
    assert "**95.0%**" in lines[3]
    assert "**" not in lines[2]


def test_csv_holds_all_digits_and_nothing_where_nothing_is_known(evaluations: list[Evaluation]) -> None:
    runs = compare_runs(evaluations)
    rows = list(csv.DictReader(io.StringIO(comma_separated(runs))))
    assert [r["run"] for r in rows] == ["consistent", "sure", "alone"]
    assert float(rows[0]["position_m"]) == runs[0].position_m
    assert rows[2]["position_m"] == ""
    assert tuple(rows[0]) == Run.__struct_fields__


@pytest.mark.parametrize("copies", [1, 2])
def test_the_table_fits_a_terminal(evaluations: list[Evaluation], copies: int) -> None:
    """Up to three runs stand side by side, more below each other; nothing is cut off."""
    out = io.StringIO()
    print_runs(compare_runs(evaluations * copies), Console(file=out, width=80, no_color=True))
    text = out.getvalue()
    assert ("largest 95 % radius, m" in text) == (copies == 1)
    assert "…" not in text
    for name in ("consistent", "sure", "alone", "median"):
        assert name in text


def test_files_of_one_name_are_distinguished_by_their_folders(evaluations: list[Evaluation], tmp_path: Path) -> None:
    logs = [tmp_path / "before" / "e.mcap", tmp_path / "after" / "e.mcap"]
    named = [msgspec.structs.replace(e, log=str(log)) for e, log in zip(evaluations, logs, strict=False)]
    assert [r.run for r in compare_runs(named)] == [str(Path("before/e")), str(Path("after/e"))]
