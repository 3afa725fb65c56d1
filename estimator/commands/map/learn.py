"""landfix map learn."""

from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json, Out, note, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.tools.maps.learn import LearnSummary


def command(
    source: Annotated[str, typer.Argument(metavar="LOG.mcap", help="Flight with GNSS, IMU and images, local or in a store.")],
    rig_file: Annotated[Path, typer.Option("--rig", metavar="RIG", help="Calibration of the two cameras (YAML or XML).")],
    out: Out,
    config: ConfigFile = None,
    ground_alt_m: Annotated[
        float | None,
        typer.Option(help="Height of the ground above the ellipsoid; default: from the beginning of the log, at rest."),
    ] = None,
    least_frames: Annotated[int, typer.Option(min=2, help="Fewest images in which a landmark is seen.")] = 4,
    least_m2: Annotated[float, typer.Option(min=0, help="Landmarks are at least this large; cars are smaller than 15.")] = 15.0,
    most_sigma_m: Annotated[float, typer.Option(min=0, help="Images with a larger position sigma are left out.")] = 1.5,
    most_hz: Annotated[float, typer.Option(min=0.01, help="Image pairs processed per second.")] = 2.0,
    pick: Annotated[str, typer.Option(metavar="COLOURS", help="Only regions of these colours, as in red,#30a050.")] = "",
    json: Json = False,
) -> None:
    """Learn a map by flying.

    Poses are smoothed from the log's GNSS and IMU. A region that is found at the same position in several images becomes a
    landmark, with its standard deviation. The map is marked automatic: one landmark alone gives no fix, because what stood still
    during the flight may have moved. When you have checked it (landfix map show), landfix map build --checked takes the mark out.

    \b
    Examples:
      landfix map learn flight.mcap --rig rig.yaml -c vehicle.toml -o map.geojson --ground-alt-m 488
      landfix map learn flight.mcap --rig rig.yaml -o map.geojson --pick red,white --least-frames 8
    """
    from calib.files.formats import load_rig
    from estimator import config as configuration
    from estimator.commands.map.options import colours
    from estimator.tools.maps.ambiguity import marked
    from estimator.tools.maps.learn import LearnConfig, learn
    from vision.learn.tracks import KeepConfig

    how = LearnConfig(
        most_hz=most_hz,
        most_sigma_m=most_sigma_m,
        ground_alt_m=ground_alt_m,
        colours_bgr=colours(pick),
        keep=KeepConfig(least_frames=least_frames, least_m2=least_m2),
    )
    loaded = configuration.read(config) if config else configuration.Config()
    with progress(f"learn {PurePosixPath(source).name}") as report:
        the_map, summary = learn(_local(source), load_rig(rig_file), loaded, how, report)
        if len(the_map):
            out.write_bytes(the_map.to_geojson(marked(the_map)))
    if summary.torn:
        note(f"landfix: {source} is truncated; read up to its last whole record")
    if json:
        print_json(summary)
    else:
        _print(summary, out, given=ground_alt_m is not None)
    if not len(the_map):
        note(f"landfix: {source}: no landmark was learned, nothing written")
        raise typer.Exit(1)


def _local(source: str) -> Path:
    if "://" not in source:
        return Path(source)
    from estimator.tools.fleet.store import local_path

    return local_path(source)


def _print(summary: "LearnSummary", out: Path, *, given: bool) -> None:
    horizontal, vertical = summary.common_sigma_m
    rows = [
        ("landmarks", str(summary.landmarks)),
        ("images processed", str(summary.images)),
        ("ground", f"{summary.ground_alt_m:.1f} m above the ellipsoid" + ("" if given else ", where the log begins")),
        ("the whole map", f"may be off by {horizontal:.2f} m horizontally, {vertical:.2f} m in height (1 sigma)"),
        ("automatic", "one landmark alone gives no fix until the map is checked (landfix map build --checked)"),
        *((f"skipped: {reason}", f"{count} images") for reason, count in summary.skipped.items()),
        *((f"left out: {reason}", f"{count} things") for reason, count in summary.left_out.items()),
    ]
    print_table(f"{out}", rows)
