"""landfix map build, get, learn, show, check."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, Out, note, print_json, print_table, progress
from estimator.commands.common.groups import Group
from estimator.commands.map import get, learn

if TYPE_CHECKING:
    from estimator.tools.maps.check import MapCheck
    from models.maps.landmarks import LandmarkMap
    from models.maps.table import Alike, Finding, MapReport

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}
_IMAGES = frozenset({".tif", ".tiff", ".png", ".jpg", ".jpeg"})
_MOST_LINES = 20  # of one kind on a screen; --json has them all

app = typer.Typer(
    cls=Group, no_args_is_help=True, help="Maps of landmarks: build, get, learn, show, check.", rich_markup_mode=None
)
MapFile = Annotated[Path, typer.Argument(metavar="MAP.geojson", help="A map, or any GeoJSON of polygons.")]


@app.command()
def build(
    source: Annotated[
        Path,
        typer.Argument(metavar="IN.geojson", help="Polygons: building footprints, roofs, pools, pads ...; or an orthophoto."),
    ],
    out: Out,
    height_m: Annotated[
        float, typer.Option(min=0, max=1000, help="Height of features without one; 0 = painted on the ground.")
    ] = 6.0,
    sigma_m: Annotated[
        float | None,
        typer.Option(
            min=0, max=1000, help="Horizontal standard deviation of features without one; default: 0.5, or a pixel of the raster."
        ),
    ] = None,
    common_sigma_m: Annotated[
        str,
        typer.Option(
            metavar="H,V", help="Standard deviation of a common shift of the whole map, in addition: horizontal, vertical."
        ),
    ] = "",
    origin: Annotated[
        str, typer.Option(metavar="LAT,LON,ALT", help="Origin of the local frame, ALT above the ellipsoid; else the middle.")
    ] = "",
    colour_from: Annotated[
        Path | None,
        typer.Option(metavar="IMAGE", help="Orthophoto from which features without a colour take it: GeoTIFF or world file."),
    ] = None,
    picture_epsg: Annotated[
        int, typer.Option(metavar="CODE", help="EPSG code of a raster without one: 4326, 326xx, 327xx, 3857.")
    ] = 0,
    pick: Annotated[
        str, typer.Option(metavar="COLOURS", help="Of an orthophoto only regions of these colours, as in red,#30a050.")
    ] = "",
    least_m2: Annotated[float, typer.Option(min=0, help="Regions of an orthophoto are at least this large.")] = 4.0,
    checked: Annotated[
        bool, typer.Option("--checked", help="You have looked at every landmark: the map is no longer marked automatic.")
    ] = False,
    json: Json = False,
) -> None:
    """Make a map from polygons, or from an orthophoto.

    Reads GeoJSON in WGS 84 or UTM, with OpenStreetMap's properties or our own (docs/map.md), and writes a GeoJSON that any map
    program opens, with size, width, length and fill ratio of every landmark. Of a georeferenced image (GeoTIFF, or PNG, JPEG,
    TIFF with a world file) it takes the regions that segmentation finds.

    \b
    Examples:
      landfix map build buildings.geojson -o map.geojson
      landfix map build buildings.geojson -o map.geojson --colour-from orthophoto.tif
      landfix map build pads.geojson -o map.geojson --height-m 0 --sigma-m 0.05 --origin 47.3977,8.5456,488
      landfix map build orthophoto.tif -o map.geojson --least-m2 40
      landfix map build orthophoto.tif -o map.geojson --pick red,white --height-m 0
      landfix map build learned.geojson -o map.geojson --checked
    """
    from estimator.commands.map.options import colours
    from estimator.map_files import orthophoto
    from estimator.map_files.store import load
    from estimator.tools.maps import from_image
    from estimator.tools.maps.ambiguity import marked
    from models.maps.landmarks import LandmarkMap
    from models.maps.table import Defaults

    is_image = source.suffix.lower() in _IMAGES
    if pick and not is_image:
        raise typer.BadParameter("--pick needs an image as IN")
    wanted = colours(pick)
    defaults = Defaults(
        height_m=height_m,
        sigma_m=0.5 if sigma_m is None else sigma_m,
        origin=_origin(origin),
        common_sigma_m=_common(common_sigma_m),
    )
    with progress(f"build {source.name}") as report:
        if is_image:
            regions = from_image.landmarks(orthophoto.load(source, picture_epsg), wanted, least_m2, sigma_m)
            the_map = LandmarkMap.from_geojson(regions, defaults)
        else:
            the_map = load(source, defaults)
        report(0.5)
        if colour_from is not None:
            image = orthophoto.load(colour_from, picture_epsg)
            the_map = orthophoto.coloured(the_map, image)
            if image.is_grey:
                note(f"{colour_from} is grey, and so are the colours taken from it")
        report(0.8)
        the_map.automatic = the_map.automatic and not checked
        alike = marked(the_map)
        if len(the_map):
            out.write_bytes(the_map.to_geojson(alike))
    if json:
        found = the_map.report
        print_json(
            {"out": str(out) if len(the_map) else None, "landmarks": len(the_map), "origin": the_map.origin, "report": found}
        )
    else:
        _say_built(the_map, alike, out)
    if not len(the_map):
        note(f"landfix: {source}: no usable landmark, nothing written")
        raise typer.Exit(1)


app.command("learn")(learn.command)
app.command("get")(get.command)


@app.command()
def show(
    map_file: MapFile,
    out: Out,
    json: Json = False,
) -> None:
    """Draw a map.

    Outlines in their colours, names where there is room, scale bar, north arrow; landmarks that look like another one near by
    have coloured edges.

    \b
    Examples:
      landfix map show map.geojson -o map.png
      landfix map show map.geojson -o map.pdf
    """
    from estimator.map_files.store import load
    from estimator.tools.maps.ambiguity import marked
    from estimator.tools.maps.draw import draw

    with progress(f"draw {map_file.name}") as report:
        the_map = load(map_file)
        report(0.3)
        if not len(the_map):
            note(f"landfix: {map_file}: no usable landmark to draw (landfix map check says why)")
            raise typer.Exit(1)
        try:
            draw(the_map, map_file.name, marked(the_map)).savefig(out)
        except ValueError:
            raise typer.BadParameter(f"{out}: pictures end in .png, .pdf or .svg") from None
    if json:
        print_json({"out": str(out), "landmarks": len(the_map)})
    else:
        typer.echo(f"{out}: {len(the_map)} landmarks")


@app.command()
def check(
    map_file: MapFile,
    radius_m: Annotated[float, typer.Option(min=0, help="Search for similar landmarks within this distance.")] = 50.0,
    alike: Annotated[float, typer.Option(min=0.5, max=1, help="Similarity from which two landmarks count as ambiguous.")] = 0.9,
    json: Json = False,
) -> None:
    """Check a map: counts, missing properties, unusable features with their reasons, landmarks that look alike.

    Exit code 1 if no landmark is usable.

    \b
    Examples:
      landfix map check buildings.geojson --radius-m 100 --json
    """
    from estimator.map_files.store import load
    from estimator.tools.maps.check import check as check_map

    with progress(f"check {map_file.name}") as report:
        the_map = load(map_file)
        report(0.7)
        result = check_map(the_map, radius_m, alike)
    if json:
        print_json(result)
    else:
        _print_check(map_file, result)
    if not result.usable:
        raise typer.Exit(1)


def _common(text: str) -> tuple[float, float] | None:
    if not text:
        return None
    try:
        horizontal, vertical = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter("--common-sigma-m is two numbers of metres, horizontal and vertical, as in 1.5,2") from None
    if not (0 <= horizontal <= 1000 and 0 <= vertical <= 1000):
        raise typer.BadParameter("--common-sigma-m: both between 0 and 1000 m")
    return horizontal, vertical


def _origin(text: str) -> tuple[float, float, float] | None:
    if not text:
        return None
    try:
        lat, lon, alt = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter("--origin is LAT,LON,ALT in degrees and metres, as in 47.3977,8.5456,488") from None
    if not (abs(lat) <= 90 and abs(lon) <= 180 and abs(alt) <= 50_000):
        raise typer.BadParameter(f"--origin {text}: latitude within 90, longitude within 180 degrees, latitude first")
    return lat, lon, alt


def _say_built(the_map: "LandmarkMap", alike: "Alike | None", out: Path) -> None:
    found = the_map.report
    lat, lon, alt = the_map.origin
    if len(the_map):
        typer.echo(f"{out}: landmarks {len(the_map)}, from {found.features} features; origin {lat:.6f}, {lon:.6f}, {alt:.1f} m")
    assumed = [f"{name} {count}" for name, count in found.missing.items() if count]
    if assumed:
        note("defaults taken: " + ", ".join(assumed) + " (landfix map check says what that means)")
    if alike is None:
        note("too dense to search for ambiguous landmarks; none are marked")
    elif count := int((alike.count > 0).sum()):
        note(f"{count} of {len(the_map)} landmarks look like another one near by; they are marked (landfix map check lists them)")
    if the_map.automatic:
        note("marked automatic: one landmark alone gives no fix until you have checked the map (--checked takes the mark out)")
    if found.doubt:
        note(f"landfix: {found.doubt}")
    _left_out(found)


def _left_out(found: "MapReport | MapCheck") -> None:
    from models.maps.table import reasons

    _findings("rejected", found.rejected)
    for text, count in reasons(found.rejected) if len(found.rejected) > 1 else ():
        note(f"rejected in all: {count} x {text}")
    _findings("remark", found.remarks)


def _findings(kind: str, findings: "tuple[Finding, ...]") -> None:
    for finding in findings[:_MOST_LINES]:
        note(f"{kind}: {finding}")
    _more(len(findings))


def _print_check(map_file: Path, result: "MapCheck") -> None:
    from rich.text import Text

    rows = [
        (Text(c.state, style=_COLOURS[c.state]), c.name, c.found + (f"\n-> {c.advice}" if c.advice else ""))
        for c in result.checks
    ]
    print_table(f"landfix map check {map_file}", rows)
    if result.look_alikes:
        pairs = [(p.a, p.b, f"{p.distance_m:.1f} m", f"{p.similarity:.1%}") for p in result.look_alikes[:_MOST_LINES]]
        print_table("ambiguous landmarks, the most similar first", pairs, ("landmark", "and", "apart", "similarity"))
        _more(len(result.look_alikes))
    if result.repeats:
        shifts = [(r.id, f"{r.shift_m:.1f} m") for r in result.repeats[:_MOST_LINES]]
        print_table("repeated arrangements", shifts, ("around landmark", "shifted by"))
        _more(len(result.repeats))
    for pair in result.nested[:_MOST_LINES]:
        note(f"one in another: {pair.inner} lies in {pair.outer}")
    _left_out(result)


def _more(count: int) -> None:
    if count > _MOST_LINES:
        note(f"and {count - _MOST_LINES} more (--json lists all)")
