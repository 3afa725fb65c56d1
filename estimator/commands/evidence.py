"""landfix evidence."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Jobs, Scheduler, note


def command(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder of the pack.")],
    hours: Annotated[float, typer.Option(metavar="H", min=0.0, help="Hours of flights with drawn faults.")] = 1.0,
    scheduler: Scheduler = "",
    jobs: Jobs = None,
) -> None:
    """Write the evidence for the protection levels: claim, assumptions, fault rates, results, traceability, versions.

    Flights with faults drawn at random are simulated; those that stand in FOLDER are not flown again. The same version makes the
    same numbers on one machine type. It runs in a clone of the repository, to whose benchmarks and tests the pack refers.

    \b
    Examples:
      landfix evidence -o evidence --hours 1
      landfix evidence -o evidence --hours 1000 --scheduler tcp://10.0.0.5:8786
    """
    from importlib import import_module

    try:
        pack = import_module("benchmarks.evidence.pack")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "benchmarks":
            raise
        note("landfix: evidence needs a clone of the repository: its benchmarks and tests are not part of the package")
        raise typer.Exit(1) from None
    typer.echo(f"written: {pack.write(out, hours, jobs, scheduler)}")
