"""landfix fleet compare."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, note, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.tools.fleet.compare import Comparison

_MOST_LINES = 10


def command(
    results: Annotated[str, typer.Argument(metavar="RESULTS", help="Folder of the rows, local or in a store.")],
    labels: Annotated[str, typer.Option(metavar="BEFORE,AFTER", help="The two runs.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="PAGE.html", help="Page to write.")] = None,
    noise: Annotated[str, typer.Option(metavar="A,B", help="Two runs that should be equal: the scale of what counts.")] = "",
    by: Annotated[
        str, typer.Option(metavar="COLUMN", help="Group the flights by a column: vehicle, version, one of --join.")
    ] = "",
    join: Annotated[
        Path | None, typer.Option(metavar="TABLE", help="CSV or Parquet with a column log and others: place, weather ...")
    ] = None,
    fail_if: Annotated[
        list[str] | None,
        typer.Option("--fail-if", metavar="BUDGET", help='Exit code 1 where it is broken: "rmse_m worse 10 % on 1 %".'),
    ] = None,
    least: Annotated[float, typer.Option(metavar="PERCENT", min=0, help="A smaller change of a flight is not counted.")] = 1.0,
    reports: Annotated[
        int, typer.Option(metavar="N", min=0, help="Make the reports of the N worst flights, linked from PAGE.")
    ] = 0,
    json: Json = False,
) -> None:
    """Find the flights that became worse or better.

    Flights are paired by their address. The page has the fleet as a whole (with Wilcoxon's signed-rank test), groups, and the
    flights, the worst first; with --reports it links to a report of each, in the folder PAGE-reports.

    \b
    Examples:
      landfix fleet compare results --labels before,after -o page.html --reports 5
      landfix fleet compare results --labels before,after --fail-if "rmse_m worse 10 % on 1 %"
      landfix fleet compare results --labels before,after -o page.html --join weather.csv --by wind
    """
    from estimator.tools.fleet.ask import with_columns
    from estimator.tools.fleet.compare import compare
    from estimator.tools.fleet.page import write
    from estimator.tools.fleet.report import reports_of
    from estimator.tools.fleet.results import read

    if reports and out is None:
        raise typer.BadParameter("--reports needs -o PAGE.html")
    pair, equal = _pair(labels, "--labels"), _pair(noise, "--noise") if noise else None
    rows = with_columns(read(results, dict.fromkeys((*pair, *(equal or ())))), join)
    found = compare(rows, pair, equal, by, fail_if or (), least)
    if out is not None:
        with progress("reports") as report:
            links = reports_of(found.changes[:reports], results, out.with_name(f"{out.stem}-reports"), report) if reports else {}
        out.write_text(write(found, links), encoding="utf-8")
    if json:
        print_json(found)
    else:
        _print(found, out)
    for broken in found.broken:
        note(f"landfix: budget broken: {broken.budget}: {broken.share_percent:.2f} % of the flights")
    if found.broken:
        raise typer.Exit(1)


def _pair(text: str, option: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise typer.BadParameter("two names with a comma between them", param_hint=option)
    return names[0], names[1]


def _print(found: "Comparison", out: Path | None) -> None:
    from estimator.tools.fleet.compare import words

    rows = [
        (m.metric, str(m.pairs), str(m.worse), str(m.better), f"{m.median_percent:+.2f} %", "-" if m.p is None else f"{m.p:.2g}")
        for m in found.metrics
        if m.pairs
    ]
    title = f"{found.labels[1]} against {found.labels[0]}: {found.worse} of {found.pairs} flights worse, {found.better} better"
    print_table(title, rows, ("metric", "flights", "worse", "better", "median change", "p"))
    if groups := [(g.value, str(g.pairs), str(g.worse), str(g.better)) for g in found.groups]:
        print_table(f"By {found.by}", groups, (found.by, "flights", "worse", "better"))
    if worst := [(c.log, words(c)) for c in found.changes if c.worse > found.least][:_MOST_LINES]:
        print_table("The worst", worst, ("flight", "change"))
    if found.differing:
        note(f"landfix: the inputs of {found.differing} flights are not the same under both labels")
    if out is not None:
        typer.echo(f"written: {out}")
