"""landfix overlay."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.frontend.residuals import OverlayResult, Spread

_MOST_ROWS = 20


def command(
    log: Annotated[Path, typer.Argument(metavar="LOG.mcap", help="Log with images and an estimate.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="VIDEO", help=".mp4, .webm or .avi; none: no video.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="PNG", help="Residual over time [default: next to the video].")] = None,
    config: ConfigFile = None,
    rig: Annotated[Path | None, typer.Option(metavar="RIG", help="Calibration of the cameras [default: the log's].")] = None,
    map_file: Annotated[Path | None, typer.Option("--map", metavar="MAP", help="Landmark map [default: the log's].")] = None,
    right: Annotated[bool, typer.Option("--right/--left", help="Which camera's images.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Measure all landmarks in view, not just those of fixes.")] = False,
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Only every N-th image.")] = 1,
    start_s: Annotated[float, typer.Option("--start", metavar="SECONDS", min=0, help="Start time in the log.")] = 0.0,
    seconds: Annotated[float, typer.Option(metavar="SECONDS", min=0, help="Duration.")] = float("inf"),
    json: Json = False,
) -> None:
    """Draw the map into the recorded images, from the estimate, and measure the residuals.

    Outlines are drawn from /landfix/odometry at the exposure, not from the fix: green where the fix of that image identified
    the landmark, else amber. The residual is the distance in px of edges in the image from the drawn outlines, beside the value
    that the estimate's covariance predicts.

    \b
    Examples:
      landfix overlay estimate.mcap -o video.webm --start 60 --seconds 20
      landfix overlay flight.mcap --rig rig.yaml --map town.geojson --json     numbers only
    """
    from estimator.tools.overlay.files import configuration, scenery
    from estimator.tools.overlay.log import read
    from estimator.tools.overlay.video import Choice, make

    with progress(f"read {log.name}") as report:
        flight = read(log, report)
    inputs = configuration(log, flight.attachments, config).inputs
    topic = flight.topic_of(inputs.right_image if right else inputs.left_image)
    around = scenery(log, flight.attachments, config, rig, map_file)
    choice = Choice(every, start_s, seconds, right, everything)
    with progress(f"draw {log.name}") as report:
        result = make(flight, topic, around, choice, out, plot or (out and out.with_suffix(".png")), report)
    if json:
        print_json(result)
    else:
        _print(result)


def _print(result: "OverlayResult") -> None:
    left_out = f"; {result.without_estimate} have no estimate" if result.without_estimate else ""
    left_out += f"; {result.unreadable} cannot be read" if result.unreadable else ""
    rows = [
        ("all images", *_cells(result.residual_px)),
        ("of which vision made a fix", *_cells(result.with_fix_px)),
        ("without a fix", *_cells(result.without_fix_px)),
    ]
    title = f"{result.log}: {result.images} images{left_out}\nreprojection residual in px, {result.measured}"
    print_table(title, rows, ("", "seen in", "median", "95 %", "largest"))
    if result.ratio is not None:
        typer.echo(f"residual / expected from the covariance, median: {result.ratio:.2f}\n")
    marks = [(row.name or row.id, str(row.in_view), *_cells(row.residual_px)) for row in result.landmarks]
    more = f" (first {_MOST_ROWS} of {len(marks)})" if len(marks) > _MOST_ROWS else ""
    print_table(f"Landmarks{more}", marks[:_MOST_ROWS], ("landmark", "in view", "seen in", "median", "95 %", "largest"))
    if result.video or result.plot:
        typer.echo("\nwritten: " + "  ".join(filter(None, (result.video, result.plot))))


def _cells(spread: "Spread | None") -> tuple[str, str, str, str]:
    if spread is None:
        return "0", "-", "-", "-"
    return str(spread.n), f"{spread.median:.2f}", f"{spread.p95:.2f}", f"{spread.max:.2f}"
