"""landfix evaluate."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.console import Json, print_json, progress


def command(
    log: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="What landfix replay wrote, truth included.")],
    truth: Annotated[
        str, typer.Option(metavar="TOPIC", help="Odometry, poses or a receiver that the estimator did not hear.")
    ] = "/truth",
    burn_in_s: Annotated[float, typer.Option("--burn-in", metavar="SECONDS", min=0, help="Leave out the beginning.")] = 0.0,
    outage_s: Annotated[
        float | None, typer.Option("--outage", metavar="SECONDS", min=0, help="A longer silence of a source is an outage.")
    ] = None,
    json: Json = False,
) -> None:
    """Say how good an estimate was.

    Errors, consistency of the covariance, drift in each outage, what became of the measurements.
    Without a truth in the log it says all that needs none.

    \b
    Examples:
      landfix evaluate estimate.mcap
      landfix evaluate estimate.mcap --truth /rtk/fix --json
    """
    from logs.evaluate import evaluate

    with progress(f"read {log.name}") as report:
        evaluation = evaluate(log, truth, burn_in_s=burn_in_s, outage_s=outage_s, progress=report)
    if json:
        print_json(evaluation)
        return
    from logs.evaluation_table import print_table

    print_table(evaluation)
