from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from logs.evaluation import plots
from logs.evaluation.collected import Collected, read
from logs.evaluation.evaluate import compare, find_outages
from tests.logs import flight_log
from tests.logs.flight_log import Flight


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Collected:
    path = tmp_path_factory.mktemp("plots") / "flight.mcap"
    flight_log.write(path, Flight())
    return read(path)


@pytest.fixture(scope="module")
def outages(collected: Collected) -> plots.Spans:
    return find_outages(collected.aids, collected.health, collected.estimate)["all"].spans


def lines(axes: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {str(line.get_label()): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axes.get_lines()}


def drawn(figure: Figure) -> np.ndarray:
    """The picture, (height, width, 4); warnings of the layout are errors."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def overlaps_axes(figure: Figure) -> bool:
    """Whether the figure's legend lies over any axes, or out of the picture."""
    drawn(figure)
    box = figure.legends[0].get_window_extent()
    outside = box.x0 < 0 or box.y0 < 0 or box.x1 > figure.bbox.x1
    return bool(outside or any(box.overlaps(axes.get_window_extent()) for axes in figure.axes))


def test_every_axis_has_its_unit_and_the_legend_hides_nothing(collected: Collected, outages: plots.Spans) -> None:
    figure = plots.overview(collected, outages)
    picture = drawn(figure)
    assert picture.std() > 5  # something is on it
    assert (picture[0, 0] == 255).all()  # on white
    assert not overlaps_axes(figure)
    for axes in figure.axes:
        assert axes.get_ylabel().endswith("]")
    assert figure.axes[-1].get_xlabel().endswith("]")


def test_from_above_shows_truth_estimate_fixes_and_outages(collected: Collected, outages: plots.Spans) -> None:
    axes, _ = plots.overview(collected, outages).axes
    shown = lines(axes)
    np.testing.assert_allclose(np.hypot(*shown["truth"]), 40.0, atol=1e-6)
    aided, blind = shown["estimate, aided"][0], shown["estimate in an outage"][0]
    np.testing.assert_array_equal(np.isnan(aided), ~np.isnan(blind))
    assert np.count_nonzero(~np.isnan(blind)) == pytest.approx(42 * 25, abs=3)
    assert len(shown["fix not used"][0]) == 8
    assert len(shown["fix used"][0]) == 74
    ellipses = [p for p in axes.patches if isinstance(p, Ellipse)]
    assert len(ellipses) == 26  # 24 and the ends of two outages
    largest = max(e.get_height() for e in ellipses)
    assert largest == pytest.approx(2 * 2.4477 * np.sqrt(0.3**2 * 32), rel=0.03)


def test_a_far_false_fix_does_not_shrink_the_flight(collected: Collected, outages: plots.Spans) -> None:
    fixes = collected.fixes["/pose_fix"]
    far = replace(fixes, p=fixes.p + 1e5 * ~fixes.used[:, None])
    figure = plots.overview(replace(collected, fixes={"/pose_fix": far}), outages)
    drawn(figure)
    assert figure.axes[0].get_xlim()[1] < 60


def test_horizontal_error_marks_what_lies_beyond_the_radius(collected: Collected, outages: plots.Spans) -> None:
    _, axes = plots.overview(collected, outages).axes
    shown = lines(axes)
    error, radius = shown["horizontal error"][1], shown["95 % radius"][1]
    assert len(shown["error beyond the radius"][0]) == np.count_nonzero(error > radius)
    share = 100 * np.mean(error <= radius)
    assert axes.get_title() == f"inside the 95 % radius {share:.1f} % of the time"
    assert axes.get_yscale() == "log"


def test_images_need_neither_truth_nor_fixes(collected: Collected) -> None:
    bare = replace(collected, truth=collected.truth[:0], aids=(), fixes={})
    assert drawn(plots.overview(bare, [])).std() > 3


def test_nothing_is_drawn_over_a_hole() -> None:
    t, y = plots._broken_at_holes(np.array([0.0, 0.1, 0.2, 5.0, 5.1]), np.arange(5.0))
    np.testing.assert_array_equal(t, [0.0, 0.1, 0.2, 0.2, 5.0, 5.1])
    np.testing.assert_array_equal(y, [0.0, 1.0, 2.0, np.nan, 3.0, 4.0])


@pytest.mark.long
def test_a_real_flight_with_visual_poses_as_the_estimate(landfix_data: Path, tmp_path: Path) -> None:
    """GIVEN EuRoC's visual poses, THEN the figure is drawn, and the errors are those its README has (0.06 m)."""
    flight_log.write_vision(tmp_path / "vision.mcap", landfix_data / "flights" / "euroc" / "V1_02_medium")
    real = read(tmp_path / "vision.mcap")
    c = compare(real.estimate, real.truth)
    assert np.sqrt((c.p_error**2).sum(axis=1).mean()) == pytest.approx(0.06, abs=0.006)
    assert np.rad2deg(np.median(np.linalg.norm(c.theta_error, axis=1))) == pytest.approx(1.8, abs=0.1)
    assert not overlaps_axes(plots.overview(real, []))
