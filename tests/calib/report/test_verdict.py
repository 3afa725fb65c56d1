import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure as Plot

from calib.cameras import mono
from calib.errors import CalibrationError
from calib.report import page as report
from calib.report import plots, verdict
from calib.report.verdict import Figure, Grade, Verdict
from models.camera import CameraModel
from tests.calib.conftest import BOARD, CAMERA, simulated_views


def test_the_worst_figure_is_the_verdict_and_its_advice_comes_first() -> None:
    good, usable, redo = (Figure(n, v, "px", 1.0, 2.0, f"do {n}") for n, v in (("a", 0.5), ("b", 1.5), ("c", 9.0)))
    assert Verdict((good,)).text == "good"
    judged = Verdict((good, usable, redo, usable))
    assert judged.grade is Grade.REDO
    assert judged.text == "redo: do c; do b"
    assert Figure("n", math.nan, "", 1.0, 2.0, "").grade is Grade.USABLE
    assert Figure("n", math.inf, "", 1.0, 2.0, "").grade is Grade.REDO
    assert verdict.table((redo,)) == [("c", "9 px", "<= 1 / 2", "redo")]


def test_a_lens_model_that_folds_inside_the_image_is_noticed() -> None:
    assert verdict.uncovered(CAMERA) == 0.0
    folding = CameraModel(640, 480, 533.0, 534.0, 342.0, 234.0, (-0.9, 0.0, 0.0, 0.0))
    assert 5.0 < verdict.uncovered(folding) < 90.0


def test_a_view_beyond_the_fold_has_no_residual_and_is_reported() -> None:
    problem = mono.start(simulated_views(6), BOARD, mono.Lens.TWO)
    folding = CameraModel(640, 480, 533.0, 534.0, 342.0, 234.0, (-9.0, 0.0, 0.0, 0.0))
    assert mono._rms_or_nan(problem.only([0])) < 1.0
    assert math.isnan(mono._rms_or_nan(replace(problem.only([0]), cameras=(folding,))))
    assert math.isnan(mono.predicted_rms(folding, simulated_views(6)[0], BOARD))
    left_out = mono.HeldOut.of([0.3, math.nan, 0.4, math.nan])
    assert left_out.rms == pytest.approx(math.sqrt(0.125))
    assert left_out.beyond == 0.5
    assert math.isnan(mono.HeldOut.of([math.nan]).rms)
    result = replace(mono.calibrate(simulated_views(8), BOARD), held_out=left_out)
    judged = verdict.of_mono(result)
    assert judged.grade is Grade.REDO
    assert "fewer coefficients" in judged.advice[0]
    assert any("0.354 px; 50 % lie beyond the lens model" in row[1] for row in report.mono_tables(result)[0][2])


def test_the_report_stands_alone_and_escapes_names(tmp_path: Path) -> None:
    result = mono.calibrate(simulated_views(8), BOARD)
    tables = [*report.mono_tables(result), report.dropped([mono.Dropped("<b>.png", "blurred & dark")])]
    page, png = report.write(tmp_path / "x.yaml", "Camera <1>", verdict.of_mono(result), tables, plots.mono_figure(result))
    text = page.read_text()
    assert png.suffix == ".png"
    assert "&lt;b&gt;.png" in text
    assert "Camera &lt;1&gt;" in text
    assert "://" not in text
    assert verdict.of_mono(result).grade.word in text
    with pytest.raises(CalibrationError, match="cannot be written"):
        report.write(tmp_path / "no" / "x.yaml", "", verdict.of_mono(result), [], Plot())
    assert np.isfinite(result.held_out.rms)
