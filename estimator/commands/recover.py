"""landfix recover."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Json, Out, print_json, progress


def command(
    source: Annotated[Path, typer.Argument(metavar="BROKEN.mcap", help="Truncated or damaged log.")],
    out: Out,
    json: Json = False,
) -> None:
    """Repair a truncated or damaged log.

    All whole records are kept; every MCAP tool can read the result.

    \b
    Examples:
      landfix recover broken.mcap -o whole.mcap
    """
    from logs.store.recover import recover

    with progress(f"recover {source.name}") as report:
        result = recover(source, out, report)
    if json:
        print_json(result)
    else:
        typer.echo(f"{out}: {result}")
