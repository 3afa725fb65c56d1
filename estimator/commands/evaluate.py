"""landfix evaluate."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, note, print_json, progress

if TYPE_CHECKING:
    from logs.evaluation.records import Evaluation


def command(
    logs: Annotated[list[Path], typer.Argument(metavar="OUT.mcap...", help="What landfix replay wrote, truth included.")],
    truth: Annotated[
        str,
        typer.Option(metavar="TOPIC", help="Topic of the truth: odometry, poses, or a receiver that the estimator does not use."),
    ] = "/truth",
    burn_in_s: Annotated[float, typer.Option("--burn-in", metavar="SECONDS", min=0, help="Leave out the beginning.")] = 0.0,
    outage_s: Annotated[
        float | None, typer.Option("--outage", metavar="SECONDS", min=0, help="A longer silence of a source is an outage.")
    ] = None,
    without_odometry: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="The same flight replayed with --without-odometry: its errors at the ends of outages."),
    ] = None,
    json: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="A row for each log, as Markdown.")] = False,
    comma_separated: Annotated[bool, typer.Option("--csv", help="A row for each log, as CSV with all digits.")] = False,
) -> None:
    """Evaluate an estimate, or compare several.

    Prints errors, consistency of the covariance, drift in each outage, and the decisions on measurements; without a truth in the
    log the parts that need none. Several logs: one row each. A log that cannot be read is skipped; the exit code is then 1.

    \b
    Examples:
      landfix evaluate estimate.mcap
      landfix evaluate estimate.mcap --truth /rtk/fix --json
      landfix evaluate estimate.mcap --without-odometry without.mcap
      landfix evaluate fleet/*.mcap --csv > fleet.csv
    """
    if json + markdown + comma_separated > 1:
        raise typer.BadParameter("of --json, --markdown and --csv only one can be printed")
    if without_odometry and len(logs) > 1:
        raise typer.BadParameter("--without-odometry goes with one log")
    if len(logs) == 1 and not (markdown or comma_separated):
        evaluation = _evaluate(logs[0], truth, burn_in_s, outage_s, without_odometry)
        if json:
            print_json(evaluation)
        else:
            from logs.evaluation.table import print_table

            print_table(evaluation)
        return
    from logs.evaluation.runs import comma_separated as as_csv
    from logs.evaluation.runs import compare_runs, print_runs
    from logs.evaluation.runs import markdown as as_markdown

    evaluations = _readable(logs, truth, burn_in_s, outage_s)
    if json:
        print_json(evaluations)
    elif markdown:
        typer.echo(as_markdown(compare_runs(evaluations)), nl=False)
    elif comma_separated:
        typer.echo(as_csv(compare_runs(evaluations)), nl=False)
    elif evaluations:
        print_runs(compare_runs(evaluations))
    if len(evaluations) < len(logs):
        raise typer.Exit(1)


def _evaluate(
    log: Path, truth: str, burn_in_s: float, outage_s: float | None, without_odometry: Path | None = None
) -> "Evaluation":
    with progress(f"read {log.name}") as report:  # the bar moves while libraries are loaded
        from logs.evaluation.evaluate import evaluate

        return evaluate(log, truth, burn_in_s=burn_in_s, outage_s=outage_s, without_odometry=without_odometry, progress=report)


def _readable(logs: list[Path], truth: str, burn_in_s: float, outage_s: float | None) -> "list[Evaluation]":
    from logs.store.reader import LogError

    evaluations = []
    for log in logs:
        try:
            evaluations.append(_evaluate(log, truth, burn_in_s, outage_s))
        except LogError as error:
            note(f"landfix: {error}")
    return evaluations
