"""landfix import."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.console import Json, Out, print_json, progress


class Kind(StrEnum):
    """Where recordings come from."""

    CSV = "csv"
    EUROC = "euroc"
    ULOG = "ulog"
    DATAFLASH = "dataflash"
    TLOG = "tlog"


def command(
    kind: Annotated[Kind, typer.Argument(help="Layout of the recording.")],
    source: Annotated[
        Path, typer.Argument(help="csv, euroc: a directory; ulog (PX4), dataflash (ArduPilot .bin), tlog (MAVLink): a file.")
    ],
    out: Out,
    json: Json = False,
) -> None:
    """Turn another program's recording into a log.

    \b
    Examples:
      landfix import csv flight_dir -o flight.mcap       imu.csv, truth.csv, gps.csv (also .csv.gz)
      landfix import euroc MH_03_medium -o flight.mcap   the EuRoC data set's own layout (mav0/...)
      landfix import ulog flight.ulg -o flight.mcap
      landfix import dataflash 00000171.BIN -o flight.mcap
      landfix import tlog flight.tlog -o flight.mcap
    """
    from logs.importers import convert

    with progress(f"import {source.name}") as report:
        counts = convert(kind.value, source, out, report)
    if json:
        print_json({"out": str(out), "messages": counts})
    else:
        typer.echo(f"{out}: {counts}")
