"""landfix measure."""

import colorsys
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from estimator.commands.common.console import Json, note, print_json, print_table

if TYPE_CHECKING:
    from models.camera import StereoRig
    from vision.describe.measure import Measured
    from vision.describe.survey import Survey
    from vision.image.rectify import Rectification


class MeasureError(ValueError):
    """A pair without a reliable measurement, in one line."""


_HUES = ("red", "orange", "yellow", "lime", "green", "teal", "cyan", "azure", "blue", "violet", "magenta", "pink")


def command(
    left: Annotated[Path, typer.Argument(metavar="LEFT", help="Left image: PNG, JPEG, TIFF; 8 or 16 bit, colour or grey.")],
    right: Annotated[Path, typer.Argument(metavar="RIGHT", help="Right image, taken at the same time.")],
    rig_file: Annotated[Path, typer.Option("--rig", metavar="RIG", help="Calibration of the two cameras (YAML or XML).")],
    colours: Annotated[
        list[str] | None, typer.Option("--colour", metavar="R,G,B", help="A colour to search for, 0..255; repeat for more.")
    ] = None,
    space: Annotated[Literal["hsv", "hsi", "lab", "yuv", "grey"], typer.Option(help="Colour space of the segmentation.")] = "hsv",
    tolerance: Annotated[
        float,
        typer.Option(min=0.1, max=3.0, help="Tolerance of a --colour; below 1 excludes paler reflections."),
    ] = 1.0,
    nearest_m: Annotated[float, typer.Option("--nearest", metavar="M", min=0.1, help="Smallest distance of a region.")] = 4.0,
    most: Annotated[int, typer.Option(min=1, max=200, help="Largest number of regions, the largest regions first.")] = 20,
    least_px: Annotated[int, typer.Option(min=9, help="Smallest region, in pixels.")] = 60,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="PNG of the left image, regions marked.")] = None,
    json: Json = False,
) -> None:
    """Measure the regions of a stereo pair, in metres.

    Prints distance, width, length, size and fill ratio of each region of one colour, with standard deviations. Without --colour
    the regions are found by the image's own colours. Needs no map and no position.

    \b
    Examples:
      landfix measure left.png right.png --rig rig.yaml
      landfix measure left.png right.png --rig rig.xml --colour 190,50,40 --colour 40,80,170 -o regions.png
      landfix measure left.png right.png --rig rig.yaml --colour 190,50,40 --tolerance 0.5     without its reflection on the floor
    """
    from calib.files.formats import load_rig
    from estimator.commands.common.image_source import read_image
    from vision.describe.correspond import Search
    from vision.describe.measure import RECORDED
    from vision.describe.regions import Limits
    from vision.describe.segment import Tolerance
    from vision.describe.survey import Settings, survey

    rig = load_rig(rig_file)
    settings = Settings(
        colours_bgr=tuple(_colour(c) for c in colours or ()),
        space=space,
        tolerance=Tolerance().scaled(tolerance),
        limits=Limits(most=most, least_px=least_px),
        search=Search(nearest_m=nearest_m),
        accuracy=RECORDED,
    )
    images = [read_image(path) for path in (left, right)]
    found = survey(images[0], images[1], _rectified(rig_file, rig), settings)
    if isinstance(found, str):
        raise MeasureError(found)
    if out is not None:
        _write(out, found)
    if json:
        print_json(_as_json(found))
    else:
        _print(found)
    if found.problem:
        raise MeasureError(f"the distances are not reliable: {found.problem}")


def _colour(text: str) -> tuple[float, float, float]:
    try:
        r, g, b = (float(x) for x in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no colour: three numbers 0..255, red, green, blue, as in 190,50,40") from None
    if not all(0.0 <= x <= 255.0 for x in (r, g, b)):
        raise typer.BadParameter(f"'{text}' is no colour: numbers must be 0..255")
    return b, g, r


def _rectified(path: Path, rig: "StereoRig") -> "Rectification":
    from vision.image.rectify import rectification

    try:
        return rectification(rig)
    except ValueError as error:
        raise MeasureError(f"{path}: {error}") from None


def _name(bgr: tuple[float, float, float]) -> str:
    b, g, r = (x / 255.0 for x in bgr)
    hue, saturation, value = colorsys.rgb_to_hsv(r, g, b)
    if saturation < 0.2 or value < 0.12:
        return "black" if value < 0.2 else "dark grey" if value < 0.4 else "grey" if value < 0.7 else "white"
    word = _HUES[round(12.0 * hue) % 12]
    return f"dark {word}" if value < 0.45 else f"pale {word}" if saturation < 0.4 else word


def _print(found: "Survey") -> None:
    if found.measured:
        header = ("", "colour", "distance m", "width m", "length m", "size m2", "fill ratio")
        rows = [[_number(k, m), _name(m.region.colour_bgr), *_quantities(m)] for k, m in enumerate(found.measured, 1)]
        print_table("Regions, each ± one standard deviation", rows, header)
    else:
        note("no region could be measured")
    if any(m.region.touches_border for m in found.measured):
        note("> cut off by the image: at least so large")
    for reason, count in Counter(u.reason.partition(":")[0] for u in found.unmeasured).most_common():
        note(f"{count} not measured: {reason}")


def _number(k: int, measured: "Measured") -> str:
    return f"{k}>" if measured.region.touches_border else str(k)


def _quantities(measured: "Measured") -> list[str]:
    from vision.describe.measure import QUANTITIES

    texts = []
    for quantity in QUANTITIES:
        sigma = measured.sigma(quantity)
        digits = max(0, min(4, -math.floor(math.log10(max(sigma, 1e-6)))))
        texts.append(f"{getattr(measured, quantity):.{digits}f}±{sigma:.{digits}f}")
    return texts


def _as_json(found: "Survey") -> dict[str, Any]:
    residual = found.residual
    return {
        "problem": found.problem,
        "vertical_residual_px": None if residual is None else residual.vertical_px,
        "vertical_residual_sigma_px": None if residual is None else residual.sigma_px,
        "regions": [_region(m) for m in found.measured],
        "not_measured": [{"bbox": u.region.bbox, "reason": u.reason} for u in found.unmeasured],
    }


def _region(measured: "Measured") -> dict[str, Any]:
    from vision.describe.measure import QUANTITIES

    region = measured.region
    values = {q: {"value": getattr(measured, q), "sigma": measured.sigma(q)} for q in QUANTITIES}
    return {
        "colour": _name(region.colour_bgr),
        "colour_rgb": region.colour_bgr[::-1],
        **values,
        "centre_c_m": measured.centre_c.tolist(),
        "normal_c": measured.normal_c.tolist(),
        "orientation_rad": {"value": measured.orientation_rad, "sigma": measured.orientation_sigma_rad},
        "disparity_px": {"value": measured.disparity_px, "sigma": measured.disparity_sigma_px},
        "outline_px": region.outline.tolist(),
        "outline_c_m": measured.outline_c.tolist(),
        "polygon": region.corners is not None,
        "touches_border": region.touches_border,
    }


def _write(path: Path, found: "Survey") -> None:
    import cv2

    from vision.show.annotate import annotate

    done, png = cv2.imencode(".png", annotate(found.left, found.measured, found.unmeasured))
    if not done:
        raise MeasureError(f"{path}: the image could not be encoded")
    path.write_bytes(png.tobytes())
