"""landfix fleet show."""

from pathlib import Path
from typing import Annotated, Any

import typer

from estimator.commands.common.console import Json, note, print_json, print_table

_ALL = "SELECT label, log, duration_s, rmse_m, max_m, nees_position, nis_per_dof, outage_end_m, resets, error FROM rows"
_BY_LABEL = """
SELECT label, count(*) AS flights, count(*) FILTER (error <> '') AS failed, sum(duration_s) / 3600 AS hours,
  median(rmse_m) AS rmse_m, max(max_m) AS max_m, median(nees_position) AS nees_position, median(nis_per_dof) AS nis_per_dof,
  sum(resets) AS resets, sum(hazardous) AS hazardous, sum(cpu_s) / 3600 AS core_hours, sum(read_bytes) / 1e9 AS read_gb
FROM rows GROUP BY label ORDER BY label"""
_MOST_LINES = 100


def command(
    results: Annotated[str, typer.Argument(metavar="RESULTS", help="Folder of the rows, local or in a store.")],
    label: Annotated[list[str] | None, typer.Option(metavar="NAME", help="This run only; may be repeated.")] = None,
    flights: Annotated[bool, typer.Option("--flights", help="A line for each flight, not for each run.")] = False,
    failed: Annotated[bool, typer.Option("--failed", help="The flights that failed, and why.")] = False,
    sql: Annotated[str, typer.Option(metavar="QUERY", help="Any question in SQL to the table rows.")] = "",
    join: Annotated[Path | None, typer.Option(metavar="TABLE", help="CSV or Parquet with a column log and others.")] = None,
    json: Json = False,
) -> None:
    """Show what a run found, or ask the rows in SQL.

    \b
    Examples:
      landfix fleet show results
      landfix fleet show results --label after --failed
      landfix fleet show results --sql "SELECT log, rmse_m FROM rows WHERE resets > 0 ORDER BY rmse_m DESC"
    """
    from estimator.tools.fleet.ask import ask, with_columns
    from estimator.tools.fleet.results import read

    where = "WHERE error <> ''" if failed else ""
    query = sql or (f"{_ALL} {where} ORDER BY log, label" if flights or failed else _BY_LABEL)
    answer = ask(with_columns(read(results, label or ()), join), query)
    if json:
        print_json([dict(zip(answer.columns, row, strict=True)) for row in answer.rows])
        return
    print_table(results, [[_cell(x) for x in row] for row in answer.rows[:_MOST_LINES]], answer.columns)
    if len(answer.rows) > _MOST_LINES:
        note(f"landfix: and {len(answer.rows) - _MOST_LINES} more lines (--json has all)")


def _cell(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
