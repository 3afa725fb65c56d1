"""landfix demo."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.console import Json, print_json, progress
from estimator.commands.replay import print_summary


def command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another flight.")] = 0,
    json: Json = False,
) -> None:
    """Fly a simulation through the real pipeline.

    GPS is cut off, rare and late pose fixes take over, then even these stop for half a minute.
    Writes input.mcap (sensors and truth), demo.toml (configuration), estimate.mcap and the picture demo.png.

    \b
    Examples:
      landfix demo
      landfix demo -o /tmp/demo --seed 7 --json
    """
    from estimator.demo import demo

    with progress("demo") as report:
        result = demo(out, seed, report)
    if json:
        print_json(result)
        return
    from logs.evaluation_table import print_table

    print_summary(result.replay, Path(result.estimate))
    print_table(result.evaluation)
    typer.echo(f"\n{result.picture}\n{result.estimate}")
