"""landfix import."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, Out, print_json, print_table, progress

if TYPE_CHECKING:
    from logs.importers.summary import TopicRow


class Kind(StrEnum):
    """Where recordings come from."""

    CSV = "csv"
    EUROC = "euroc"
    ULOG = "ulog"
    DATAFLASH = "dataflash"
    TLOG = "tlog"
    ROSBAG = "rosbag"


def command(
    kind: Annotated[Kind, typer.Argument(help="Layout of the recording.")],
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="csv, euroc: a folder; ulog, dataflash, tlog: a file; rosbag: either.")
    ],
    out: Out,
    axes: Annotated[str, typer.Option(metavar="XYZ", help="csv, euroc: where the IMU's axes point, as in frd or urf.")] = "",
    world: Annotated[str, typer.Option(metavar="XYZ", help="csv: where the positions' axes point, as in ned or enu.")] = "",
    imu: Annotated[str, typer.Option(metavar="NAME", help="Which of several IMUs: imu2, IMU3; rosbag: its topic.")] = "",
    pose_fix_hz: Annotated[
        float, typer.Option(min=0, help="csv: at most so many poses of vision.csv a second as pose fixes.")
    ] = 0.0,
    odometry: Annotated[bool, typer.Option("--odometry", help="csv: poses of vision.csv as those of an odometry.")] = False,
    json: Json = False,
) -> None:
    """Convert a recording of another program to a log.

    OUT.toml, written next to it, is the matching configuration: topics, axes, sensor noise.

    \b
    Examples:
      landfix import csv flight_dir -o flight.mcap       imu.csv, truth.csv, gps.csv (also .csv.gz)
      landfix import csv flight_dir -o flight.mcap --pose-fix-hz 2
      landfix import csv MH_03_medium -o flight.mcap --pose-fix-hz 0.1 --odometry
      landfix import euroc MH_03_medium -o flight.mcap   the data set's own layout (mav0/...)
      landfix import ulog flight.ulg -o flight.mcap      PX4
      landfix import dataflash 171.BIN -o flight.mcap    ArduPilot, on board
      landfix import tlog flight.tlog -o flight.mcap     MAVLink, on the ground
      landfix import rosbag bag_folder -o flight.mcap    ROS 2 (MCAP, sqlite3), ROS 1 (.bag)
    """
    from logs.importers import ImportOptions, convert

    options = ImportOptions(axes=axes, world=world, imu=imu, pose_fix_hz=pose_fix_hz, odometry=odometry)
    with progress(f"import {source.name}") as report:
        summary = convert(kind.value, source, out, report, options)
    if json:
        print_json(summary)
    else:
        if summary.topics:
            _print_topics(source, summary.topics)
        typer.echo(f"{out}: {summary}")


def _print_topics(source: Path, topics: "tuple[TopicRow, ...]") -> None:
    """What becomes of each topic of a bag."""
    rows = [
        (row.topic, row.type.replace("/msg/", "/"), str(row.messages), f"{row.rate_hz:.3g} Hz", row.use or "-", row.remark)
        for row in topics
    ]
    print_table(f"{source}", rows, ("topic", "type", "messages", "rate", "[inputs]", ""))
