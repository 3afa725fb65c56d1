"""landfix demo."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, kept_on_interrupt, note, print_json, print_table, progress
from estimator.commands.replay import print_summary

if TYPE_CHECKING:
    from logs.evaluation.records import Evaluation


def command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the flight.")] = 0,
    mono: Annotated[bool, typer.Option("--mono", help="One camera instead of a stereo rig.")] = False,
    json: Json = False,
) -> None:
    """Fly a simulation through the real pipeline.

    A multirotor flies over a mapped village. GPS is cut off, and landmarks in the images replace it. Then the lens is dark
    for twenty seconds. Later it flies over meadows without a landmark, and odometry carries the estimate. Writes input.mcap
    (sensors, images, truth), demo.toml, rig.yaml, map.geojson, estimate.mcap, without_odometry.mcap, demo.png (flight),
    overlay.png (the map drawn into an image), and report.html.

    \b
    Examples:
      landfix demo -o out/another --seed 7 --json
      landfix demo -o out/mono --mono
    """
    note(f"a flight is simulated, drawn, replayed and evaluated, into {out}")
    from estimator.tools.demo import demo
    from estimator.tools.kernels import each_tenth, prepare

    lines = not sys.stderr.isatty()
    with kept_on_interrupt(lambda: sorted(path for path in out.glob("*") if path.is_file())):
        with progress("compiling, once") as bar:
            prepare(each_tenth("compiling, once") if lines else bar)
        with progress("demo") as bar:
            result = demo(out, seed, each_tenth("demo") if lines else bar, one_camera=mono)
    if json:
        print_json(result)
        return
    print_summary(result.replay, Path(result.estimate))
    _print_verdict(result.evaluation)
    typer.echo(f"\npictures: {result.picture}  {result.overlay}\nreport: {result.report}  (open it in a browser)")


def _print_verdict(evaluation: "Evaluation") -> None:
    rows = []
    if evaluation.accuracy:
        rows.append(("error with fixes, RMSE", f"{evaluation.accuracy.aided_position_m.rmse:.2f} m"))
    for outage in evaluation.outages:
        if outage.source == "all" and outage.drift:
            reported = f", reported 95 % radius {outage.radius95_end_m:.2f} m" if outage.radius95_end_m is not None else ""
            why = "with odometry" if outage.increments else "of blackout"
            without = outage.without_odometry_m if outage.increments else None
            compared = f"; without odometry {without:.2f} m" if without is not None else ""
            rows.append((f"after {outage.duration_s:.0f} s {why}", f"{outage.drift.end_m:.2f} m{reported}{compared}"))
    if evaluation.consistency:
        rows.append(("inside the 95 % radius", f"{evaluation.consistency.radius95_covered:.0%} of the time"))
    print_table("Against the truth", rows)
