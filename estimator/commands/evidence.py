"""landfix evidence."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Jobs, Scheduler


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
    from estimator.commands.common.clone import of_clone

    typer.echo(f"written: {of_clone('evidence.pack', 'evidence').write(out, hours, jobs, scheduler)}")
