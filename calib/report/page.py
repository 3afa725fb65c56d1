"""Calibration report: one HTML page, verdict first, and its plot as PNG."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calib.cameras.bundle import rotation_vector
from calib.cameras.mono import Dropped, HeldOut, Mono
from calib.cameras.stereo import Stereo
from calib.errors import CalibrationError
from calib.report import verdict
from calib.report.verdict import Grade, Verdict
from models import web_page
from models.camera import CameraModel
from models.web_page import Table

__all__ = ["Table", "camera_table", "dropped", "mono_tables", "stereo_tables", "write"]

_COLOURS = {Grade.GOOD: web_page.GOOD, Grade.USABLE: web_page.USABLE, Grade.REDO: web_page.BAD}
_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def write(path: Path, title: str, judged: Verdict, tables: Sequence[Table], figure: Figure) -> list[Path]:
    """Write PATH.html and PATH.png; returns both. Raises CalibrationError."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    png, page = path.with_suffix(".png"), path.with_suffix(".html")
    try:
        png.write_bytes(buffer.getvalue())
        page.write_text(_page(title, judged, tables, buffer.getvalue()), encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: the report cannot be written: {error.strerror}") from None
    return [page, png]


def camera_table(title: str, camera: CameraModel) -> Table:
    """Parameters with their standard deviations."""
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    assert camera.covariance is not None
    sigma = np.sqrt(np.diagonal(camera.covariance))
    rows = [
        (name, f"{x:.3f}" if k < 4 else f"{x:.6f}", f"{s:.2g}" if s > 0 else "fixed", "px" if k < 4 else "")
        for k, (name, x, s) in enumerate(zip(_NAMES, values, sigma, strict=False))
    ]
    return title, ("parameter", "value", "+- sigma", "unit"), rows


def mono_tables(result: Mono) -> list[Table]:
    """Tables of one camera."""
    views = [(v.name, f"{rms:.3f}") for v, rms in zip(result.views, result.solution.view_rms(), strict=True)]
    change = " ".join(f"{x:.1f}" for x in result.spread)
    facts = [
        ("image", f"{result.camera.width} x {result.camera.height}"), ("lens model", result.lens.value),
        ("residual RMS", f"{result.solution.rms:.3f} px"), ("of views left out", _left_out(result.held_out)),
        ("largest change of fx fy cx cy, a quarter of the views left out", f"{change} x sigma"),
        ("sigma widened, for errors that views have in common, by", f"{np.sqrt(result.solution.widened):.2f}"),
    ]  # fmt: skip
    return [
        ("Result", (), facts),
        camera_table("Camera", result.camera),
        ("Views", ("view", "RMS [px]"), views),
        dropped(result.dropped),
    ]


def stereo_tables(result: Stereo) -> list[Table]:
    """Tables of a rig."""
    rig = result.rig
    assert rig.covariance_rc is not None
    sigma = np.sqrt(np.diagonal(rig.covariance_rc))
    turn = np.rad2deg(rotation_vector(rig.R_rc))
    between = [
        (f"t_rc {n}", f"{1e3 * t:.3f}", f"{1e3 * s:.2g}", "mm") for n, t, s in zip("xyz", rig.t_rc, sigma[:3], strict=True)
    ]
    between += [
        (f"rotation {n}", f"{r:.4f}", f"{np.rad2deg(s):.2g}", "deg") for n, r, s in zip("xyz", turn, sigma[3:], strict=True)
    ]
    facts = [
        (
            "residual RMS",
            f"{result.solution.rms:.3f} px (left {result.solution.camera_rms(0):.3f}, right {result.solution.camera_rms(1):.3f})",
        ),
        ("epipolar distance, images as they are", f"{result.epipolar_before_px:.3f} px"),
        ("row error, rectified", f"{result.epipolar_after_px:.3f} px"),
        ("of pairs left out", _left_out(result.held_out)),
        ("a square of the board, triangulated", f"{1e3 * result.square_m:.3f} mm"),
        ("sigma widened, for errors that pairs have in common, by", f"{np.sqrt(result.solution.widened):.2f}"),
    ]
    views = [
        (f"{p.left.name}, {p.right.name}", f"{rms:.3f}") for p, rms in zip(result.pairs, result.solution.view_rms(), strict=True)
    ]
    matrices = [
        (name, " ".join(f"{x:.6g}" for x in row)) for name, M in (("E", result.E), ("F", result.F)) for row in M
    ]  # fmt: skip
    return [
        ("Result", (), facts), ("Right from left camera", ("", "value", "+- sigma", "unit"), between),
        camera_table("Left camera", rig.left), camera_table("Right camera", rig.right),
        ("Essential and fundamental matrix", (), matrices), ("Pairs", ("pair", "RMS [px]"), views), dropped(result.dropped),
    ]  # fmt: skip


def _left_out(held_out: HeldOut) -> str:
    rms = "not known" if np.isnan(held_out.rms) else f"{held_out.rms:.3f} px"
    return rms + (f"; {100.0 * held_out.beyond:.0f} % lie beyond the lens model of the others" if held_out.beyond > 0.0 else "")


def dropped(images: Sequence[Dropped]) -> Table:
    """Images not used."""
    return "Not used", ("image", "reason"), [(d.name, d.reason) for d in images]


def _page(title: str, judged: Verdict, tables: Sequence[Table], png: bytes) -> str:
    advice = "".join(f"<li>{web_page.text(a)}</li>" for a in judged.advice)
    figures = ("Judged by", ("figure", "value", "good / usable up to", ""), verdict.table(judged.figures))
    return web_page.page(
        title,
        f"<h1>{web_page.text(title)}</h1><p>{web_page.verdict(judged.grade.word, _COLOURS[judged.grade])}</p><ul>{advice}</ul>"
        f"{web_page.table(figures)}{web_page.image('coverage and residuals', png)}{''.join(map(web_page.table, tables))}",
    )
