import re
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np

from logs.report.integrity import _held
from logs.report.stanford import stanford
from logs.report.write import Written, write
from logs.wire.codec import encode
from models.messages import Alert, Integrity
from tests.logs import flight_log
from tests.logs.flight_log import EPOCH_NS, Flight, rewritten


def _cells(svg: str) -> list[tuple[float, float]]:
    """Centre of each coloured cell, as shares of the plot, from below."""
    found = re.findall(r'<rect x="([\d.]+)" y="([\d.]+)" width="5.0"', svg)
    return [((float(x) + 2.5 - 52.0) / 320.0, 1.0 - (float(y) + 2.5 - 26.0) / 320.0) for x, y in found]


def test_a_point_stands_where_error_and_level_are() -> None:
    svg = stanford(np.array([0.1, 5.0]), np.array([10.0, 1.0]), np.inf, "horizontal")
    ElementTree.fromstring(svg)
    above, below = sorted(_cells(svg))
    assert above[0] < above[1]
    assert below[0] > below[1]
    assert "nominal 1" in svg
    assert "misleading 1" in svg


def test_counts_of_the_four_regions_stand_in_it() -> None:
    error, level = np.array([1.0, 4.0, 12.0, 1.0]), np.array([3.0, 3.0, 3.0, np.inf])
    svg = stanford(error, level, 10.0, "vertical")
    for words in ("nominal 1", "misleading 1", "hazardous 1", "unavailable 1", "vertical"):
        assert words in svg


def test_nothing_to_draw_is_an_empty_plot() -> None:
    ElementTree.fromstring(stanford(np.empty(0), np.empty(0), 10.0, "horizontal"))


def _integrity(t_ns: int, hpl: float) -> Integrity:
    state = Alert.USABLE if hpl < 10.0 else Alert.CAUTION
    reason = "" if hpl < 10.0 else "HPL 12.0 m, limit 10 m: the map <shifted>"
    return Integrity(t_ns, t_ns, state, reason, 1e-5, hpl, 4.0, 10.0, np.inf, (1e-3,), (hpl / 2.0,), (2.0,), 1.0, 1.0)


def test_a_report_has_levels_states_and_both_plots(tmp_path: Path) -> None:
    flight_log.write(tmp_path / "plain.mcap", Flight(duration_s=20.0, outages=()))
    stamps = range(EPOCH_NS, EPOCH_NS + 19_000_000_000, 200_000_000)
    extra = [(*encode(_integrity(t_ns, 12.0 if k > 50 else 3.0))[0], t_ns) for k, t_ns in enumerate(stamps)]
    log = rewritten(tmp_path / "plain.mcap", tmp_path / "log.mcap", extra=tuple(extra))
    done = write(log, tmp_path / "report.html")
    assert isinstance(done, Written)
    found = done.evaluation.integrity
    assert found is not None
    assert found.horizontal is not None
    assert (found.horizontal.nominal, found.horizontal.unavailable, found.horizontal.exceeded) == (51, 44, (0, 0))
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg xmlns") == 2
    assert "Integrity at 1e-05 per hour" in page
    assert "the map <shifted>" not in page
    assert write(tmp_path / "plain.mcap", tmp_path / "plain.html") is not None
    assert 'id="integrity"' not in (tmp_path / "plain.html").read_text()


def test_without_limits_the_report_says_so_and_draws_the_rarer_levels(tmp_path: Path) -> None:
    """A level in two seconds is rarer than the spans of a plot: each holds until the next one, or nothing would be drawn."""
    flight_log.write(tmp_path / "plain.mcap", Flight(duration_s=60.0, outages=()))
    stamps = range(EPOCH_NS, EPOCH_NS + 59_000_000_000, 2_000_000_000)
    levels = [msgspec.structs.replace(_integrity(t_ns, 3.0), state=Alert.NOT_JUDGED, hal_m=np.inf) for t_ns in stamps]
    log = rewritten(tmp_path / "plain.mcap", tmp_path / "log.mcap", extra=tuple((*encode(i)[0], i.t_ns) for i in levels))
    done = write(log, tmp_path / "report.html")
    assert isinstance(done, Written)
    page = (tmp_path / "report.html").read_text()
    assert "no alert limits configured, so nothing is judged" in page
    assert "unavailable" not in page
    stamps_ns, held = _held(np.array([i.t_ns for i in levels], np.int64), np.full((len(levels), 1), 3.0))
    assert np.diff(np.sort(stamps_ns)).max() < 59e9 / 1600
    assert (held == 3.0).all()


def test_a_pause_of_the_levels_stays_one() -> None:
    t_ns = np.array([0, 1, 2, 3, 20, 21], np.int64) * 1_000_000_000
    stamps_ns, _ = _held(t_ns, np.ones((6, 1)))
    assert not ((stamps_ns > 6_100_000_000) & (stamps_ns < 20_000_000_000)).any()
    assert ((stamps_ns > 3_000_000_000) & (stamps_ns < 6_000_000_000)).any()
