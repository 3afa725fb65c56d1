"""Shared by the calibrate commands."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.commands.common.console import print_json, print_table

if TYPE_CHECKING:
    from calib.board.chessboard import Board, View
    from calib.cameras.mono import Dropped
    from calib.report.page import Table
    from calib.report.verdict import Verdict
    from models.camera import CameraModel


class LensChoice(StrEnum):
    """Coefficients of the lens."""

    TWO = "2"
    FOUR = "4"
    FIVE = "5"
    EIGHT = "8"
    FISHEYE = "fisheye"


class FormatChoice(StrEnum):
    """Forms of rig files."""

    LANDFIX = "landfix"
    OPENCV = "opencv"
    ROS = "ros"
    KALIBR = "kalibr"


BoardSize = Annotated[str, typer.Option("--board", metavar="CxR", help="Inner corners, columns x rows.")]
SquareMm = Annotated[float, typer.Option("--square-mm", min=0.1, help="Side of a square. Measure it: printers scale.")]
MarkerMm = Annotated[float, typer.Option("--marker-mm", min=0, help="ChArUco board: side of a marker; 0: plain chessboard.")]
Dictionary = Annotated[str, typer.Option(help="ChArUco board: the dictionary of its markers.")]
LensOption = Annotated[LensChoice, typer.Option("--lens", help="Distortion: 2 (k1 k2), 4, 5 (Brown), 8 (rational) or fisheye.")]
OutFile = Annotated[Path, typer.Option("--out", "-o", help="File to write: .yaml ours, .xml or .yml OpenCV.")]
ReportFile = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Report; its plot is written next to it. Default: OUT.html, OUT.png."),
]


def board_of(size: str, square_mm: float, marker_mm: float, dictionary: str) -> "Board":
    """The board of the options."""
    from calib.board.chessboard import Board

    try:
        columns, rows = (int(n) for n in size.lower().split("x"))
    except ValueError:
        raise typer.BadParameter(
            f"{size!r} is no size of a board; needed: inner corners as in 9x6", param_hint="--board"
        ) from None
    return Board(columns, rows, 1e-3 * square_mm, 1e-3 * marker_mm, dictionary)


def check_outputs(report_file: Path, out: Path | None, *inputs: Path) -> None:
    """Raises CalibrationError, LogError for unwritable files."""
    from calib.errors import CalibrationError
    from logs.store.reader import check_output

    pages = [report_file.with_suffix(".html"), report_file.with_suffix(".png")]
    if out in pages:
        raise CalibrationError(f"{out}: the report is written there; name the result .yaml, .xml or .yml")
    for path in (*pages, *([out] if out else [])):
        check_output(path, *inputs)
        if path.is_dir():
            raise CalibrationError(f"{path}: cannot be written: it is a folder")


def tell(
    judged: "Verdict", tables: "Sequence[Table]", unused: "Sequence[Dropped]", written: list[Path], facts: dict[str, Any] | None
) -> None:
    """The result on stdout, JSON or text."""
    from calib.report.verdict import table

    if facts is not None:
        figures = {f.name: f.value for f in judged.figures}
        print_json({
            "verdict": judged.grade.word, "advice": judged.advice, "figures": figures, **facts,
            "unused": {d.name: d.reason for d in unused}, "written": [str(p) for p in written],
        })  # fmt: skip
        return
    for title, header, rows in tables:
        print_table(title, rows, header)
    print_table("Judged by", table(judged.figures), ("", "value", "good / usable up to", ""))
    if unused:
        print_table("Not used", [(d.name, d.reason) for d in unused])
    typer.echo(f"\nVerdict: {judged.text}\n{', '.join(str(p) for p in written)}")


def write_text(path: Path, text: str) -> None:
    """Write a small file. Raises CalibrationError."""
    from calib.errors import CalibrationError

    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from None


def check_size(camera: "CameraModel", view: "View") -> None:
    """Raises CalibrationError for images of another size."""
    from calib.errors import CalibrationError

    if (view.width, view.height) != (camera.width, camera.height):
        raise CalibrationError(
            f"the images are {view.width} x {view.height}, the rig was calibrated for {camera.width} x {camera.height}"
        )
