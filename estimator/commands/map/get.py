"""landfix map get."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Json, Out, note, print_json, progress


def command(
    place: Annotated[str, typer.Argument(metavar="LAT,LON", help="Middle of the map, degrees.")],
    source: Annotated[
        Path, typer.Option(metavar="FILE|DIR", help="Extract of a data set, or a folder of extracts: all of them are read.")
    ],
    out: Out,
    km: Annotated[float, typer.Option(min=0.01, max=100, help="Radius.")] = 5.0,
    ground_alt_m: Annotated[
        float, typer.Option(min=-1000, max=10_000, help="The ground above the WGS-84 ellipsoid; it becomes the map's origin.")
    ] = 0.0,
    sigma_m: Annotated[
        float | None, typer.Option(min=0, max=1000, help="Horizontal standard deviation, instead of the data set's.")
    ] = None,
    terrain: Annotated[
        Path | None,
        typer.Option(metavar="FILE|DIR", help="Height model for the ground below each landmark: .hgt tiles, GeoTIFF."),
    ] = None,
    terrain_sigma_m: Annotated[float, typer.Option(min=0, max=100, help="Standard deviation of its heights.")] = 2.0,
    terrain_ellipsoid: Annotated[
        bool, typer.Option("--terrain-ellipsoid", help="Its heights are above the ellipsoid, not above the sea.")
    ] = False,
    json: Json = False,
) -> None:
    """Make a map of the building footprints around a place, from a local extract of a public data set.

    Reads GeoJSON (one document, or a feature a line, also .gz) and Overpass JSON; with landfix[geo] GeoPackage, Shapefile,
    OpenStreetMap (.osm, .osm.pbf), FlatGeobuf and GeoParquet, in any coordinate system. Nothing is downloaded. Heights and
    standard deviations are the data set's where it has them. The attribution is kept in the map.

    \b
    Examples:
      landfix map get 47.3977,8.5456 --km 3 --source zurich.osm.pbf --terrain N47E008.hgt -o map.geojson
      landfix map get 47.3977,8.5456 --source extracts/ --ground-alt-m 488 -o map.geojson
    """
    from estimator.map_files.extract.footprint import Place
    from estimator.map_files.extract.get import Ground, credited, get
    from estimator.map_files.terrain import Terrain
    from estimator.tools.maps.ambiguity import marked
    from models.maps.table import reasons

    lat_deg, lon_deg = _place(place)
    with progress(f"read {source.name}") as report:
        read = lambda fraction: report(0.2 + 0.6 * fraction)  # noqa: E731
        ground = None
        if terrain is not None:
            model = Terrain(terrain, above_ellipsoid=terrain_ellipsoid, progress=lambda fraction: report(0.2 * fraction))
            ground = Ground(model, terrain_sigma_m)
        the_map, got = get(source, Place(lat_deg, lon_deg, 1000.0 * km), ground_alt_m, sigma_m, read, ground)
        alike = marked(the_map)
        out.write_bytes(credited(the_map.to_geojson(alike), got.attribution))
    if json:
        print_json({"out": str(out), **{name: getattr(got, name) for name in got.__struct_fields__}})
        return
    kinds = ", ".join(f"{name} {count}" for name, count in got.sources.items())
    typer.echo(f"{out}: {got.landmarks} landmarks ({kinds}), {got.with_height} with a height of their own")
    if got.attribution:
        typer.echo(f"attribution, kept in the file: {got.attribution}")
    for text in got.notes:
        note(f"note: {text}")
    for text, count in reasons(the_map.report.rejected):
        note(f"rejected: {count} x {text}")
    if alike is not None and (count := int((alike.count > 0).sum())):
        note(f"{count} landmarks look like another one near by; they are marked (landfix map check lists them)")


def _place(text: str) -> tuple[float, float]:
    try:
        lat_deg, lon_deg = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text} is not LAT,LON in degrees, as in 47.3977,8.5456") from None
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
        raise typer.BadParameter(f"{text}: latitude within 90, longitude within 180 degrees, latitude first")
    return lat_deg, lon_deg
