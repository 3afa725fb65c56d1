"""landfix forecast."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json, note, print_json, print_table, progress


def command(
    route: Annotated[Path, typer.Argument(metavar="ROUTE", help="GPX, GeoJSON LineString, or lines of latitude, longitude.")],
    map_file: Annotated[Path, typer.Option("--map", metavar="MAP.geojson", help="Map of landmarks.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="PICTURE", help="Draw it: .png, .pdf or .svg.")] = None,
    height_m: Annotated[float, typer.Option(min=2, max=5000, help="Height above the map's origin.")] = 80.0,
    speed_m_s: Annotated[float, typer.Option("--speed", min=0.5, max=100, help="m/s.")] = 8.0,
    view_deg: Annotated[float, typer.Option("--view", min=5, max=150, help="Angle of the image's smaller side, degrees.")] = 60.0,
    found: Annotated[
        float, typer.Option(min=0.01, max=1, help="Share of the images over usable landmarks that give a fix.")
    ] = 0.5,
    limit_m: Annotated[float, typer.Option("--limit", min=0.1, help="Largest 95 % radius that the task allows, m.")] = 20.0,
    config: ConfigFile = None,
    json: Json = False,
) -> None:
    """Predict the 95 % radius along a route that is flown without GPS, and say whether the map is fit for it.

    The estimator itself flies the route, with a perfect IMU, and with a fix where landmarks are in view that look-alikes do not
    make ambiguous. GPS ends where the route begins. Exit code 1 where the radius exceeds the limit.

    \b
    Examples:
      landfix forecast route.geojson --map map.geojson -c vehicle.toml --height-m 120 --speed 15 -o forecast.png
    """
    from estimator.config import load
    from estimator.map_files.store import load as load_map
    from estimator.tools.maps.forecast import Camera, forecast
    from estimator.tools.maps.route import fly, read

    the_map = load_map(map_file)
    if not len(the_map):
        note(f"landfix: {map_file}: no usable landmark (landfix map check says why)")
        raise typer.Exit(1)
    flight = fly(read(route), the_map.frame, height_m, speed_m_s)
    with progress(f"forecast {route.name}") as report:
        result = forecast(the_map, flight, load(config).fusion(), Camera(view_deg=view_deg, found=found), limit_m, report)
    if out is not None:
        from estimator.tools.maps.draw_forecast import draw

        try:
            draw(result, the_map, route.name).savefig(out)
        except ValueError:
            raise typer.BadParameter(f"{out}: pictures end in .png, .pdf or .svg") from None
    if json:
        print_json(result)
    else:
        verdict = "fit" if result.fit else "not fit"
        typer.echo(
            f"{route}: {verdict}: worst 95 % radius {result.worst_radius95_m:.1f} m, allowed {limit_m:g} m; "
            f"{result.length_m:.0f} m, {result.fixes} fixes, at most {result.longest_without_fix_s:.0f} s without one"
        )
        if result.unfit:
            table = [(f"{s.from_m:.0f} to {s.to_m:.0f} m", f"{s.worst_radius95_m:.1f} m", s.reason) for s in result.unfit]
            print_table("beyond the limit", table, ("way", "95 % radius", "why"))
        if out is not None:
            typer.echo(f"picture: {out}")
    if not result.fit:
        raise typer.Exit(1)
