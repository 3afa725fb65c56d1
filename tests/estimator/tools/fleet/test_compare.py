"""Two runs compared: pairs, noise, groups, budgets."""

from pathlib import Path
from typing import Any

import pytest

from estimator.tools.fleet.ask import ask, with_columns
from estimator.tools.fleet.compare import Comparison, compare, words
from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.page import write
from estimator.tools.fleet.results import Results, configuration, keep_configuration, read
from estimator.tools.fleet.rows import Row

FLIGHTS = 40


def row(k: int, label: str, **values: Any) -> Row:
    """A flight whose errors are those of its number."""
    given = {
        "rmse_m": 1.0 + 0.1 * k,
        "max_m": 3.0,
        "nees_position": 1.0,
        "nis_per_dof": 1.1,
        "vehicle": "wing" if k % 2 else "rotor",
    }
    return Row(key=f"{label}{k:03}", label=label, log=f"s3://flights/{k:03}.mcap", parts=1, stored_bytes=10, **given | values)


def compared(folder: Path, after: dict[int, dict[str, Any]], **options: Any) -> Comparison:
    """Equal runs but for these flights."""
    for label in ("before", "again"):
        Results(str(folder), label).add([row(k, label) for k in range(FLIGHTS)])
    Results(str(folder), "after").add([row(k, "after", **after.get(k, {})) for k in range(FLIGHTS)])
    return compare(read(str(folder)), ("before", "after"), **options)


def test_equal_runs_show_no_difference(tmp_path: Path) -> None:
    found = compared(tmp_path, {}, budgets=["rmse_m worse 0 % on 0 %"])
    assert (found.pairs, found.worse, found.better, found.broken) == (FLIGHTS, 0, 0, ())
    assert all(m.worse == m.better == 0 and m.p is None for m in found.metrics)
    assert "no flight differs" in write(found, {})


def test_the_worst_flight_comes_first(tmp_path: Path) -> None:
    after: dict[int, dict[str, Any]] = {
        3: {"rmse_m": 2.6},
        5: {"nees_position": 4.0},
        7: {"rmse_m": 0.85},
        9: {"error": "no IMU"},
        11: {"rmse_m": 2.105},
    }
    found = compared(tmp_path, after)
    assert [c.log[-8:-5] for c in found.changes][:3] == ["009", "005", "003"]
    assert found.changes[-1].log.endswith("007.mcap")
    assert (found.worse, found.better) == (3, 1)
    assert words(found.changes[2]) == "rmse_m 1.3 -> 2.6 (x 2 worse)"
    page = write(found, {"s3://flights/005.mcap": [("after", "page-reports/2-after.html")]})
    assert page.index("009.mcap") < page.index("005.mcap") < page.index("003.mcap") < page.index("007.mcap")
    assert '<a href="page-reports/2-after.html">after</a>' in page
    assert "Equal on all flights: max_m, nis_per_dof, refusals, resets." in page
    assert "011.mcap" not in page  # 0.2 %: does not count
    assert "<th>report</th>" not in write(found, {})
    assert "--reports 10" in write(found, {})


def test_too_small_a_covariance_and_too_large_a_one_are_worse(tmp_path: Path) -> None:
    found = compared(tmp_path, {1: {"nees_position": 0.25}, 2: {"nees_position": 4.0}})
    assert [c.worse for c in found.changes[:2]] == pytest.approx([1.3862943611] * 2)


def test_the_noise_of_equal_runs_is_the_scale(tmp_path: Path) -> None:
    Results(str(tmp_path), "one").add([row(k, "one") for k in range(FLIGHTS)])
    Results(str(tmp_path), "two").add([row(k, "two", rmse_m=(1.0 + 0.1 * k) * 1.05) for k in range(FLIGHTS)])
    found = compared(tmp_path, {1: {"rmse_m": 1.1 * 1.04}, 2: {"rmse_m": 1.2 * 1.06}}, noise=("one", "two"))
    assert [c.log[-8:-5] for c in found.changes if c.worse] == ["002"]


@pytest.mark.parametrize(("share", "broken"), [("2", True), ("6", False)])
def test_a_budget_breaks_by_the_share_of_flights(tmp_path: Path, share: str, broken: bool) -> None:
    after: dict[int, dict[str, Any]] = {
        1: {"rmse_m": 1.1 * 1.12},
        2: {"error": "no estimate", "rmse_m": None},
        3: {"rmse_m": 1.3 * 1.09},
    }
    found = compared(tmp_path, after, budgets=[f"rmse_m worse 10 % on {share} %"])  # 2 of 40
    assert bool(found.broken) is broken


@pytest.mark.parametrize("budget", ["rmse_m worse a lot", "speed worse 10 % on 1 %", "rmse_m worse 10 % on 1 % of all"])
def test_a_budget_that_cannot_be_read_is_refused(tmp_path: Path, budget: str) -> None:
    with pytest.raises(FleetError, match="write METRIC worse X % on Y %"):
        compared(tmp_path, {}, budgets=[budget])


def test_groups_are_those_of_a_joined_column(tmp_path: Path) -> None:
    (tmp_path / "weather.csv").write_text(
        "log,wind\n" + "".join(f"{k:03}.mcap,{'storm' if k < 4 else 'calm'}\n" for k in range(40))
    )
    compared(tmp_path, {k: {"rmse_m": 9.0} for k in range(3)})
    rows = with_columns(read(str(tmp_path)), tmp_path / "weather.csv")
    found = compare(rows, ("before", "after"), by="wind")
    assert [(g.value, g.pairs, g.worse) for g in found.groups] == [("storm", 4, 3), ("calm", 36, 0)]
    with pytest.raises(FleetError, match="no such column"):
        compare(rows, ("before", "after"), by="rain")


def test_a_question_in_sql(tmp_path: Path) -> None:
    compared(tmp_path, {})
    answer = ask(read(str(tmp_path)), "SELECT vehicle, count(*) AS n FROM rows WHERE label = 'after' GROUP BY vehicle ORDER BY 1")
    assert answer == (("vehicle", "n"), [("rotor", 20), ("wing", 20)])
    for wrong in ("SELECT nothing FROM rows", "SELEC", "SELECT * FROM '/etc/passwd'"):
        with pytest.raises(FleetError, match="--sql: "):
            ask(read(str(tmp_path)), wrong)


def test_many_small_files_become_one_without_a_row_lost_or_doubled(tmp_path: Path) -> None:
    results = Results(str(tmp_path), "run / 1")
    for k in range(FLIGHTS):
        results.add([row(k, "run / 1", refused={"gated": k})])
    results.add([row(3, "run / 1"), row(41, "run / 1")])
    results.compact()
    results.compact()
    assert len(list(tmp_path.rglob("*.parquet"))) == 1
    found = read(str(tmp_path), ["run / 1"]).to_pylist()
    assert [r["log"][-8:-5] for r in found] == [f"{k:03}" for k in (*range(FLIGHTS), 41)]
    assert found[5]["refused"] == [("gated", 5)]
    assert results.keys() == {r["log"]: r["key"] for r in found}


def test_results_that_are_not_there_are_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="no label after; there are none"):
        read(str(tmp_path), ["after"])
    with pytest.raises(FleetError, match="holds no rows"):
        read(str(tmp_path))
    keep_configuration(str(tmp_path), "[imu]\n")
    assert configuration(str(tmp_path), "no such") is None
