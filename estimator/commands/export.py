"""landfix export."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Json, Out, print_json, progress


def command(
    log: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A log with an estimate: of replay or run.")],
    out: Out,
    kind: Annotated[
        str, typer.Option("--format", metavar="FORMAT", help="csv, parquet, tum, kml or gpx [default: by the file's name].")
    ] = "",
    topic: Annotated[
        str, typer.Option(metavar="TOPIC", help="Whose poses: /truth, /landfix/smoothed, a receiver.")
    ] = "/landfix/odometry",
    rate_hz: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", min=0, help="At most so many rows a second; 0: all [kml, gpx: 2].")
    ] = None,
    geoid_m: Annotated[
        float | None,
        typer.Option("--geoid", metavar="METRES", help="kml, gpx: the geoid above the ellipsoid [default: the log's geoid_m]."),
    ] = None,
    json: Json = False,
) -> None:
    """Write the estimate of a log for other programs.

    csv and parquet hold time, place, velocity, attitude, standard deviations, 95 % radius and mode; the units are in the names.
    tum is for evo: map is ENU, the body FLU. kml and gpx hold heights above the sea. parquet needs landfix[export].

    \b
    Examples:
      landfix export estimate.mcap -o estimate.csv
      landfix export estimate.mcap -o truth.tum --topic /truth
      landfix export estimate.mcap -o estimate.parquet --rate 10
    """
    from logs.exporters.export import Format, export, format_of

    if kind and kind not in set(Format):
        raise typer.BadParameter(f"{kind} is none of {', '.join(Format)}")
    chosen = Format(kind) if kind else format_of(out)
    with progress(f"export {log.name}") as report:
        written = export(log, out, chosen, topic=topic, rate_hz=rate_hz, geoid_m=geoid_m, progress=report)
    if json:
        print_json(written)
    else:
        typer.echo(f"{out}: {written}")
