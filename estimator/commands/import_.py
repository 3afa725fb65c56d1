"""landfix import."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, print_json, print_table, progress

if TYPE_CHECKING:
    from logs.importers.summary import TopicRow


_SHAPE = "[KIND] RECORDING"


def command(
    recording: Annotated[
        list[str],
        typer.Argument(
            metavar=_SHAPE, help="A file or folder; KIND where it does not show: csv, euroc, ulog, dataflash, tlog, rosbag."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="OUT.mcap", help="File to write [default: RECORDING's name, here].")
    ] = None,
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

    OUT.toml, written next to it, is the matching configuration: topics, axes, sensor noise. The exit code is 1 where the log
    cannot be navigated by; the line that says why begins with "at fault".

    \b
    Examples:
      landfix import flight.ulg                          PX4 -> flight.mcap, flight.toml
      landfix import 171.BIN -o flight.mcap              ArduPilot, on board
      landfix import flight.tlog                         MAVLink, on the ground
      landfix import bag_folder -o flight.mcap           ROS 2 (MCAP, sqlite3), ROS 1 (.bag)
      landfix import flight_dir -o flight.mcap           imu.csv, truth.csv, gps.csv (also .csv.gz)
      landfix import csv flight_dir -o flight.mcap --pose-fix-hz 2
      landfix import csv MH_03_medium -o flight.mcap --pose-fix-hz 0.1 --odometry
      landfix import euroc MH_03_medium -o flight.mcap   the data set's own layout (mav0/...)
    """
    from logs.importers import ImportOptions, convert

    kind, source = _kind_and_source(recording)
    out = out or Path(f"{source.absolute().stem}.mcap")
    options = ImportOptions(axes=axes, world=world, imu=imu, pose_fix_hz=pose_fix_hz, odometry=odometry)
    with progress(f"import {source.name}") as report:
        summary = convert(kind, source, out, report, options)
    if json:
        print_json(summary)
    else:
        if summary.topics:
            _print_topics(source, summary.topics)
        typer.echo(f"{out}: {summary}")
    if any(finding.unfit for finding in summary.findings):
        raise typer.Exit(1)


def _kind_and_source(recording: list[str]) -> tuple[str, Path]:
    from logs.importers import KINDS, ROSBAG, kind_of

    if len(recording) == 1:
        return kind_of(Path(recording[0])), Path(recording[0])
    kinds = (*KINDS, ROSBAG)
    if len(recording) > 2 or recording[0] not in kinds:
        raise typer.BadParameter(f"give {_SHAPE}, KIND one of {', '.join(kinds)}; one recording at a time")
    return recording[0], Path(recording[1])


def _print_topics(source: Path, topics: "tuple[TopicRow, ...]") -> None:
    rows = [
        (row.topic, row.type.replace("/msg/", "/"), str(row.messages), f"{row.rate_hz:.3g} Hz", row.use or "-", row.remark)
        for row in topics
    ]
    print_table(f"{source}", rows, ("topic", "type", "messages", "rate", "[inputs]", ""))
