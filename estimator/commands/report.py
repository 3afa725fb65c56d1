"""landfix report."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json, Out, print_json, progress


def command(
    log: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A log with an estimate: of replay or run.")],
    out: Out,
    truth: Annotated[
        str,
        typer.Option(metavar="TOPIC", help="Topic of the truth: odometry, poses, or a receiver that the estimator does not use."),
    ] = "/truth",
    outage_s: Annotated[
        float | None, typer.Option("--outage", metavar="SECONDS", min=0, help="A longer silence of a source is an outage.")
    ] = None,
    without_odometry: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="The same flight replayed with --without-odometry: its errors at the ends of outages."),
    ] = None,
    config: ConfigFile = None,
    rig: Annotated[Path | None, typer.Option(metavar="RIG", help="Calibration of the cameras [default: the log's].")] = None,
    map_file: Annotated[Path | None, typer.Option("--map", metavar="MAP", help="Landmark map [default: the log's].")] = None,
    images: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Show what the cameras saw.")] = True,
    json: Json = False,
) -> None:
    """Write a report of a flight as one HTML page: trajectory, uncertainty, rejected measurements, problems.

    The page needs no network. It holds a verdict with its reasons, the map, errors or the reported 95 % radius, the decision on
    each measurement, images with their fixes or the reason for none, biases, health, latencies and the configuration.

    \b
    Examples:
      landfix report estimate.mcap -o report.html
      landfix report estimate.mcap -o report.html --rig rig.yaml --map town.geojson --truth /rtk/fix
    """
    with progress(f"read {log.name}") as report:  # the bar moves while libraries are loaded
        from estimator.tools.overlay.gallery import illustrations
        from logs.report.write import no_illustrations, write

        illustrate = illustrations(log, config, rig, map_file) if images else no_illustrations
        written = write(
            log,
            out,
            truth_topic=truth,
            outage_s=outage_s,
            without_odometry=without_odometry,
            illustrate=illustrate,
            progress=report,
        )
    if json:
        print_json(written)
        return
    typer.echo(f"{log}: {written.verdict}")
    for finding in written.findings:
        typer.echo(f"  {finding}")
    typer.echo(f"report: {written.report} ({written.size / 1e6:.1f} MB)")
