"""The report of a log whose errors are known: what it says, what it draws, and that nothing in a log can take it over."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from logs.evaluation.collected import read
from logs.evaluation.evaluate import assess, evaluate
from logs.importers.recording import AUTOPILOT
from logs.report.charts import Points, StripChart, TimeChart
from logs.report.gather import Frame, Gathered, attitude_deg, sigmas
from logs.report.map import flight
from logs.report.plots import MOST_POINTS, thinned, vision
from logs.report.words import Level, findings
from logs.report.write import Written, write
from logs.store.reader import LogError, LogReader
from logs.store.recorder import REFERENCE_ATTACHMENT, Recorder
from logs.wire import schemas
from logs.wire.codec import encode, encode_input, encode_truth
from logs.wire.encoding import header_of, packed
from models import so3
from models.messages import AidStatus, Health, LandmarkFix, Mode, Reason, Reset, VisionReport
from tests.logs import flight_log
from tests.logs.flight_log import EPOCH_NS, STEP_NS, Flight, rewritten, truth_at

S = 1_000_000_000
EVIL = "<!--<script </script><script>pwned=1</script><img src=x onerror=pwned=2>\"'&"


class Page(HTMLParser):
    """Elements with their attributes, the text outside of scripts, and what is to be drawn."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.drawing: Any = None
        self._inside = ""
        self.feed(self.source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = "drawing" if ("id", "drawing") in attrs else tag

    def handle_endtag(self, _: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "drawing":
            self.drawing = json.loads(data)
        elif self._inside not in {"script", "style"}:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def chart(self, name: str) -> Any:
        return self.drawing["charts"][name]

    def part(self, chart: str, name: str) -> Any:
        (part,) = (p for p in self.chart(chart)["parts"] if p["name"] == name)
        return part


def known(numbers: list[float | None]) -> list[float]:
    return [x for x in numbers if x is not None]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "consistent.mcap"
    flight_log.write(path, Flight())
    return path


@pytest.fixture(scope="module")
def page(log: Path) -> Page:
    write(log, log.with_suffix(".html"))
    return Page(log.with_suffix(".html"))


# --- what it says -----------------------------------------------------------------------------------------------------------


def test_the_summary_reports_what_the_evaluation_reports(page: Page, log: Path) -> None:
    e = evaluate(log)
    assert e.accuracy is not None
    assert e.consistency is not None
    assert f"{e.accuracy.position_m.rmse:.2f} m (RMS)" in page.text
    assert f"{e.distance_m:.0f} m flown" in page.text
    assert "without an absolute fix 2 times, 42.0 s in all, 32.0 s at the longest" in page.text
    assert f"{e.consistency.radius95_covered:.0%} of the time" in page.text
    assert "/pose_fix" in page.text


def verdict_of(tmp_path: Path, flight: Flight) -> tuple[str, list[str]]:
    """Of a flight without jumps."""
    flight_log.write(tmp_path / "jumps.mcap", flight)
    written = write(rewritten(tmp_path / "jumps.mcap", tmp_path / "x.mcap", without=("/landfix/reset",)), tmp_path / "x.html")
    return written.verdict, written.findings


def test_a_jump_beyond_the_95_percent_radius_is_a_reason_to_look_closer_and_one_within_is_not(log: Path, tmp_path: Path) -> None:
    (said,) = (f for f in write(log, tmp_path / "x.html").findings if "jumped" in f)
    assert said.startswith("the position jumped by more than 1 m once: 5.0 m at 1.0 s, where the reported 95 % radius was ")
    radius = float(said.split()[-2])
    assert 0.3 < radius < 2.0
    late = Reset(
        EPOCH_NS + 90 * S, EPOCH_NS + 90 * S, 1, (1.2, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    )  # after the long outage
    for name, delta, level in (("within", 1.2, "no problems found"), ("beyond", 12.0, "warnings")):
        extra = ((*encode(msgspec.structs.replace(late, delta_p_n=(delta, 0.0, 0.0)))[0], late.t_ns),)
        calm = rewritten(log, tmp_path / f"{name}.mcap", without=("/landfix/reset",), extra=extra)
        assert write(calm, tmp_path / "x.html").verdict == level


def test_an_estimate_that_is_overconfident_is_not_to_be_relied_on(tmp_path: Path) -> None:
    verdict, findings = verdict_of(tmp_path, Flight(error_scale=4.0))
    assert verdict == "do not rely on this estimate"
    assert any("position errors are" in f and "times the reported 1-sigma" in f for f in findings)
    assert any("inside the reported 95 % radius" in f for f in findings[:3])


def test_errors_far_beyond_the_covariance_are_wrong_and_somewhat_beyond_it_worth_a_look(tmp_path: Path) -> None:
    for scale, level in ((4.0, Level.WRONG), (1.6, Level.WARNING), (1.0, None)):
        flight_log.write(tmp_path / "x.mcap", Flight(error_scale=scale))
        collected = read(tmp_path / "x.mcap")
        levels = {
            f.level for f in findings(assess(collected, "x"), collected, Gathered()) if f.text.startswith("position errors")
        }
        assert levels == ({level} if level is not None else set())


def test_a_consistent_estimate_has_nothing_said_against_it_and_without_truth_nothing_about_errors(tmp_path: Path) -> None:
    assert verdict_of(tmp_path, Flight(false_every=1000))[0] == "no problems found"
    verdict, findings = verdict_of(tmp_path, Flight(truth=False, false_every=1000))
    assert verdict == "no problems found"
    assert not any("error" in f for f in findings)
    verdict_of(tmp_path, Flight(duration_s=30.0, outages=(), false_every=1000))
    assert "Outages and resets None." in Page(tmp_path / "x.html").text
    verdict_of(tmp_path, Flight(truth=False, false_every=1000))
    page = Page(tmp_path / "x.html")
    assert "There is no ground truth in the log" in page.text
    assert not any(name.startswith("error") for name in page.drawing["charts"])


def test_a_source_that_is_mostly_refused_is_named(tmp_path: Path) -> None:
    _, findings = verdict_of(tmp_path, Flight(false_every=2))
    assert any(re.search(r"/pose_fix: of \d+ pose measurements \d+ gated", f) for f in findings)


def test_refused_measurements_stand_in_a_table_with_their_reason(page: Page, log: Path) -> None:
    gated = [a for a in read(log).aids if a.reason is Reason.GATED]
    first, last = (f"{(a.t_ns - EPOCH_NS) * 1e-9:.1f}" for a in (gated[0], gated[-1]))
    assert f"/pose_fix pose gated {len(gated)} {first} {last} 30" in page.text


# --- what it draws ----------------------------------------------------------------------------------------------------------


def test_the_estimate_is_drawn_with_its_band_and_the_truth(page: Page, log: Path) -> None:
    estimate = read(log).estimate
    for k in range(3):
        line = page.part(f"state{k}", "estimate")
        assert max(known(line["high"])) == pytest.approx(estimate.p[:, k].max(), rel=1e-4)
        assert min(known(line["low"])) == pytest.approx(estimate.p[:, k].min(), rel=1e-4)
        band = page.part(f"state{k}", "95 % band")
        reach = 1.959964 * np.sqrt(estimate.covariance[:, k, k])
        assert max(known(band["high"])) == pytest.approx((estimate.p[:, k] + reach).max(), rel=1e-3)
        assert min(known(band["low"])) == pytest.approx((estimate.p[:, k] - reach).min(), rel=1e-3)
    heading = page.part("state8", "estimate")
    assert heading["turn"] == 360.0
    steps = np.abs(np.diff(known(heading["high"])))
    assert steps.max() < 30.0  # two turns, drawn without a leap
    assert max(known(heading["high"])) - min(known(heading["low"])) > 600.0


def test_errors_are_drawn_with_reported_ones(page: Page, log: Path) -> None:
    e = evaluate(log)
    assert e.accuracy is not None
    assert e.consistency is not None
    horizontal, radius = (known(page.part("radius", name)["high"]) for name in ("horizontal error", "95 % radius"))
    assert max(horizontal) == pytest.approx(e.accuracy.horizontal_m.max, rel=1e-4)
    assert max(radius) == pytest.approx(e.consistency.radius95_max_m, rel=1e-4)
    assert max(known(page.part("nees", "position")["high"])) > 1.0
    heading = page.part("error_theta2", "error")
    assert max(abs(x) for x in known(heading["low"] + heading["high"])) == pytest.approx(e.accuracy.heading_deg.max, rel=1e-3)


def test_outages_are_shades_and_time_begins_with_the_first_estimate(page: Page) -> None:
    assert [(s["start"], s["end"]) for s in page.drawing["spans"]] == [pytest.approx((20.0, 30.0)), pytest.approx((58.0, 90.0))]
    assert (page.drawing["begin"], page.drawing["end"]) == (0.0, pytest.approx(120.0))


def test_innovations_are_in_standard_deviations_and_refused_ones_apart(page: Page, log: Path) -> None:
    aids = [a for a in read(log).aids if a.reason is Reason.FUSED]
    north = page.part("innovation0", "north")
    assert north["y"] == pytest.approx([a.innovation[0] / a.innovation_sigma[0] for a in aids], rel=1e-3)
    assert len(page.part("ratio0", "not fused")["t"]) == 8
    assert page.part("ratio0", "fused")["y"] == pytest.approx([0.4] * len(aids))
    assert "gated" in page.part("ratio0", "not fused")["text"][0]
    (high, low) = (level["y"] for level in page.chart("nis0")["levels"])
    assert (low, high) == pytest.approx((1.2373 / 6, 14.449 / 6), rel=1e-3)  # chi-square, 6 degrees of freedom


def test_the_map_shows_the_way_by_mode_ellipses_and_fixes(page: Page, log: Path) -> None:
    chart, estimate = page.chart("map"), read(log).estimate
    modes = {p["name"]: p for p in chart["paths"]}
    assert set(modes) == {"truth", "aided", "dead reckoning"}
    assert chart["paths"][0]["name"] == "truth"  # below the others
    times = [t for p in chart["paths"] if p["name"] != "truth" for t in p["t"]]
    assert (min(times), max(times)) == (0.0, 120.0)
    west, south, east, north = chart["box"]
    assert (west, east) == pytest.approx((estimate.p[:, 0].min(), estimate.p[:, 0].max()), abs=6.0)
    assert (south, north) == pytest.approx((estimate.p[:, 1].min(), estimate.p[:, 1].max()), abs=6.0)
    assert len(chart["ellipses"]) > 20
    row = int(np.argmin(np.abs(estimate.t_ns - EPOCH_NS - 120 * S)))
    last = chart["ellipses"][-1]
    variances = np.linalg.eigvalsh(estimate.covariance[row, :2, :2])
    assert (last["b"], last["a"]) == pytest.approx(tuple(2.447747 * np.sqrt(variances)), abs=1e-3)
    assert {(m["name"], m["shape"]) for m in chart["marks"]} == {
        ("/pose_fix used", "diamond"), ("/pose_fix not used", "plus"), ("start", "triangle"), ("end", "square"),
    }  # fmt: skip


def test_gnss_and_landmark_fixes_have_marks_of_their_own(log: Path) -> None:
    collected = read(log)
    aids = tuple(msgspec.structs.replace(a, kind="gnss_position", topic="/gnss") for a in collected.aids)
    both = replace(collected, aids=(*collected.aids, *aids), fixes={**collected.fixes, "/gnss": collected.fixes["/pose_fix"]})
    shapes = [m.shape for m in flight(both, Gathered(), [], []).marks]
    assert sorted(shapes) == ["cross", "diamond", "dot", "plus", "square", "triangle"]


def test_an_attitude_is_no_position_on_the_map(log: Path) -> None:
    collected = read(log)
    attitudes = tuple(msgspec.structs.replace(a, kind="attitude") for a in collected.aids)
    assert [m.name for m in flight(replace(collected, aids=attitudes), Gathered(), [], []).marks] == ["start", "end"]


def test_the_strip_of_modes_has_names_for_its_colours(page: Page) -> None:
    stays = page.chart("states")["rows"]["mode"]
    assert {(stay["name"], stay["colour"]) for stay in stays} == {("aided", "blue"), ("dead reckoning", "orange")}


def test_a_reference_is_called_so(log: Path, tmp_path: Path) -> None:
    """GIVEN a log whose /truth is the autopilot's own estimate, THEN the page compares with a reference and says what it is."""
    with Recorder(tmp_path / "x.mcap") as recorder, LogReader(log) as reader:
        recorder.attach(REFERENCE_ATTACHMENT, "text/plain", AUTOPILOT.encode())
        for record in reader:
            recorder.write(record.topic, record.schema, record.data, record.log_time_ns)
    written = write(tmp_path / "x.mcap", tmp_path / "x.html")
    assert isinstance(written, Written)
    assert written.evaluation.compared_with == f"reference ({AUTOPILOT})"
    assert any(AUTOPILOT in note and "no errors" in note for note in written.findings)
    chart = Page(tmp_path / "x.html").chart("map")
    assert [p["name"] for p in chart["paths"] if p["dashed"]] == ["reference"]


def test_no_line_leads_over_a_hole(log: Path) -> None:
    collected, hole = read(log), (40.02, 49.98)
    known = np.array([not hole[0] < t < hole[1] for t in (collected.estimate.t_ns - EPOCH_NS) * 1e-9])
    broken = replace(collected, estimate=collected.estimate[known], truth=collected.truth[known])
    chart = flight(broken, Gathered(), [], [])
    assert [p.name for p in chart.paths] == ["truth", "truth", "estimate", "estimate"]
    assert [t for p in chart.paths for t in (p.t[0], p.t[-1])] == pytest.approx([0.0, 40.0, 50.0, 120.0] * 2, abs=0.09)


def test_an_ellipse_lies_as_its_covariance(log: Path) -> None:
    """GIVEN sigmas of 2 m along 30 degrees from east to north and 1 m across, THEN so lies the ellipse."""
    collected, c, s = read(log), np.cos(np.pi / 6), np.sin(np.pi / 6)
    collected.estimate.covariance[:, :2, :2] = [[4 * c * c + s * s, 3 * c * s], [3 * c * s, 4 * s * s + c * c]]
    ellipse = flight(collected, Gathered(), [], []).ellipses[5]
    assert (ellipse.a, ellipse.b) == pytest.approx((2 * 2.447747, 2.447747), abs=1e-3)
    assert ellipse.turn_deg % 180.0 == pytest.approx(30.0)


def test_sigmas_of_roll_and_pitch_are_about_the_nose_and_across_it(log: Path) -> None:
    """GIVEN a nose to the north, THEN roll is the rotation about map's y, pitch that about x; velocity turns too."""
    estimate = read(log).estimate[:1]
    north = np.sqrt(0.5)  # FLU -> ENU, a quarter turn to the left
    estimate.q_wxyz[0] = [north, 0.0, 0.0, north]
    estimate.covariance[0] = np.diag(np.square([1.0, 2.0, 3.0, *np.deg2rad([0.1, 0.2, 0.3])]))
    estimate.v_covariance[0] = np.diag([1.0, 4.0, 9.0])
    np.testing.assert_allclose(sigmas(estimate)[0], [1.0, 2.0, 3.0, 2.0, 1.0, 3.0, 0.2, 0.1, 0.3])


def test_modes_and_sources_are_reported_over_time(page: Page) -> None:
    rows = page.chart("states")["rows"]
    assert set(rows) == {"mode", "/pose_fix"}
    assert [(s["text"], s["start"]) for s in rows["mode"]] == [
        ("aided", 0.0), ("dead_reckoning", 22.0), ("aided", 30.0), ("dead_reckoning", 60.0), ("aided", 90.0),
    ]  # fmt: skip


def test_ages_at_arrival_are_counted(page: Page) -> None:
    latency = page.chart("latency")
    assert sum(latency["counts"]) == 3001
    filled = [k for k, n in enumerate(latency["counts"]) if n]
    assert latency["edges"][filled[0]] <= 4.0 <= latency["edges"][filled[-1] + 1]  # ms
    assert len(filled) <= 2


@pytest.mark.parametrize(("roll", "pitch", "heading"), [(0.3, -0.2, 1.0), (-1.0, 0.9, -2.5), (3.0, 0.0, 0.0)])
def test_attitude_is_reported_as_a_pilot_reports_it(roll: float, pitch: float, heading: float) -> None:
    """GIVEN a body FRD in NED at roll, pitch and heading, THEN its odometry in ENU and FLU has the same numbers."""
    q = so3.from_euler(roll, pitch, heading)
    data = encode_truth(EPOCH_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), q).data
    x, y, z, w = np.frombuffer(data[-85 * 8 :], "<f8")[3:7]
    shown = np.deg2rad(attitude_deg(np.array([[w, x, y, z]])))[0]
    np.testing.assert_allclose(np.angle(np.exp(1j * (shown - [roll, pitch, heading]))), 0.0, atol=1e-9)


# --- what may come ----------------------------------------------------------------------------------------------------------


def evil_messages() -> Iterator[tuple[str, str, bytes, int]]:
    """Every text that a log may hold, as an attacker would write it."""
    t = EPOCH_NS + 50 * S
    yield *encode(AidStatus(t, t, "/pose_fix", EVIL, Reason.GATED, 0, (9.0,), (1.0,), 9.0, 0.0, 0, EVIL))[0], t
    yield *encode(AidStatus(t + 1, t, f"/{EVIL}", "pose", Reason.FUSED, 0, (1.0,), (1.0,), 0.1, 0.0, 0, EVIL))[0], t
    yield *encode(Health(t, t, Mode.AIDED, 0.1, 1.0, 1.0, 0, {EVIL: EVIL}, {EVIL: 3}, 1, None, EVIL))[0], t
    yield *encode(VisionReport(t, t, EVIL, EVIL, 1, 1, (EVIL,), (0.5,), 1.0, 0.1))[0], t
    fix = LandmarkFix(t, t, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.eye(6), None, (EVIL,), 0.9, 1.0)
    yield *encode_input(fix), t
    new = schemas.STORE.types
    pair = new["diagnostic_msgs/msg/KeyValue"](key=EVIL, value=EVIL)
    kind = new["diagnostic_msgs/msg/DiagnosticStatus"]
    status = kind(level=0, name=EVIL, message=EVIL, hardware_id=EVIL, values=[pair])
    yield *packed("/landfix/daemon", schemas.DIAGNOSTICS, header=header_of(t, EVIL), status=[status]), t
    yield f"/{EVIL}/x", schemas.HEADER, packed("", schemas.HEADER, stamp=header_of(t, "").stamp, frame_id=EVIL).data, t


@pytest.fixture(scope="module")
def attacked(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log full of markup, in messages, names, attachments and metadata."""
    path = tmp_path_factory.mktemp("evil") / "<script>pwned=0<&script>.mcap"
    with LogReader(log) as reader, Recorder(path, metadata={EVIL: EVIL, "version": EVIL}) as recorder:
        for r in reader:
            recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
        for topic, schema, data, t_ns in evil_messages():
            recorder.write(topic, schema, data, t_ns)
        recorder.attach(EVIL, EVIL, EVIL.encode())
        recorder.attach("config.toml", "application/toml", f"# {EVIL}".encode())
    return path


def test_nothing_in_a_log_becomes_markup(attacked: Path, tmp_path: Path) -> None:
    write(attacked, tmp_path / "x.html")
    page = Page(tmp_path / "x.html")
    assert [a.get("id") for tag, a in page.elements if tag == "script"] == ["drawing", None]
    attributes = [(name, value or "") for _, a in page.elements for name, value in a.items()]
    assert not [name for name, _ in attributes if name.startswith("on")]
    assert not [value for name, value in attributes if name in {"src", "href"} and not value.startswith(("#", "data:"))]
    assert "<script>pwned" not in page.source.replace("&lt;", "")
    assert page.text.count("onerror") >= 8  # it is shown, as text
    assert EVIL in page.chart("outcomes")["rows"]
    drawn = page.source.partition('id="drawing">')[2].partition("</script>")[0]
    assert not set("<>&") & set(drawn)
    assert drawn.endswith("}")


def test_the_page_asks_for_nothing_and_allows_its_own_script_only(page: Page) -> None:
    (policy,) = (a["content"] for tag, a in page.elements if tag == "meta" and a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.partition("style-src")[0]
    assert set(re.findall(r"\w+://[\w./]*", page.source)) == {"http://www.w3.org/2000/svg"}  # a name, not a place


def test_a_torn_log_is_reported_as_far_as_it_goes(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) // 2])
    written = write(tmp_path / "torn.mcap", tmp_path / "x.html")
    assert "the log is truncated: read to its last whole record" in written.findings
    assert written.verdict != "no problems found"
    assert 10.0 < Page(tmp_path / "x.html").drawing["end"] < 119.0


def test_a_log_of_estimates_alone_is_enough(log: Path, tmp_path: Path) -> None:
    others = ("/truth", "/landfix/health", "/landfix/aid_status", "/landfix/reset", "/landfix/global", "/pose_fix")
    write(rewritten(log, tmp_path / "x.mcap", without=others), tmp_path / "x.html")
    page = Page(tmp_path / "x.html")
    assert {p["name"] for p in page.chart("map")["paths"]} == {"estimate"}
    assert "radius" in page.drawing["charts"]


def test_one_estimate_is_enough(log: Path, tmp_path: Path) -> None:
    with LogReader(log) as reader, Recorder(tmp_path / "x.mcap") as recorder:
        first = next(r for r in reader if r.topic == "/landfix/odometry")
        recorder.write(first.topic, first.schema, first.data, first.log_time_ns)
    write(tmp_path / "x.mcap", tmp_path / "x.html")
    assert Page(tmp_path / "x.html").drawing["end"] > 0.0


def test_estimates_that_are_not_finite_do_not_stop_it(log: Path, tmp_path: Path) -> None:
    nan = encode_truth(EPOCH_NS + 10_000_000, (np.nan, 0.0, 0.0), (np.nan, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0))
    extra = (("/landfix/odometry", nan.schema, nan.data, EPOCH_NS + 121 * S),)
    written = write(rewritten(log, tmp_path / "x.mcap", extra=extra), tmp_path / "x.html")
    assert "1 estimates are not finite" in written.findings
    assert "NaN" not in Page(tmp_path / "x.html").source


def test_numbers_that_are_none_of_ours_do_not_stop_it(log: Path, tmp_path: Path) -> None:
    """GIVEN bytes read as 1e300, a quaternion of length 1e200 and a covariance of zeros, THEN there is a page, and it says so."""
    far = encode_truth(EPOCH_NS + 10_000_000, (1e300, 0.0, 0.0), (0.0, 0.0, 0.0), (1e200, 0.0, 0.0, 0.0))
    extra = (("/landfix/odometry", far.schema, far.data, EPOCH_NS + 121 * S),)
    assert "1 estimates are not finite" in write(rewritten(log, tmp_path / "far.mcap", extra=extra), tmp_path / "x.html").findings
    flat = encode_truth(
        EPOCH_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    )  # which is a truth's, and none of an estimate
    with LogReader(log) as reader, Recorder(tmp_path / "flat.mcap") as recorder:
        for r in reader:
            is_first = r.topic == "/landfix/odometry" and r.log_time_ns < EPOCH_NS + STEP_NS
            recorder.write(r.topic, r.schema, flat.data if is_first else r.data, r.log_time_ns)
    written = write(tmp_path / "flat.mcap", tmp_path / "x.html")
    assert written.verdict == "do not rely on this estimate"
    assert "position covariances are at times not positive definite: they report no bound there" in written.findings


def test_junk_is_counted_and_reported(log: Path, tmp_path: Path) -> None:
    topics = {"health": schemas.DIAGNOSTICS, "vision": schemas.VISION_REPORT, "vision_request": schemas.VISION_REQUEST}
    junk = tuple((f"/landfix/{name}", schema, b"\0\1\0\0junk", EPOCH_NS + 121 * S) for name, schema in topics.items())
    written = write(rewritten(log, tmp_path / "x.mcap", extra=junk), tmp_path / "x.html")
    (finding,) = (f for f in written.findings if f.startswith("unreadable messages"))
    assert all(f"1 on /landfix/{name}" in finding for name in topics)


def test_a_log_without_estimates_and_a_path_that_cannot_be_written_give_one_line(log: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="landfix replay"):
        write(
            rewritten(log, tmp_path / "x.mcap", without=("/landfix/odometry", "/landfix/health", "/landfix/aid_status")),
            tmp_path / "x.html",
        )
    with pytest.raises(LogError, match="cannot be written"):
        write(log, tmp_path / "no" / "x.html")
    nan = encode_truth(EPOCH_NS, (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    lost = rewritten(
        log,
        tmp_path / "lost.mcap",
        without=("/landfix/odometry", "/landfix/health", "/landfix/aid_status"),
        extra=(("/landfix/odometry", *nan[1:], EPOCH_NS),),
    )
    with pytest.raises(LogError, match="none of its 1 estimates is a number"):
        write(lost, tmp_path / "x.html")
    (tmp_path / "torn.mcap").write_bytes(log.read_bytes()[:100])
    with pytest.raises(LogError, match="holds no /landfix/odometry before it is cut off"):
        write(tmp_path / "torn.mcap", tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()


def test_the_log_is_never_written_over(log: Path, tmp_path: Path) -> None:
    (tmp_path / "link.html").symlink_to(log)
    with pytest.raises(LogError, match="would overwrite the input"):
        write(log, tmp_path / "link.html")


def test_of_a_long_flight_estimates_are_thinned_evenly_and_extremes_stay(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    thinned, whole = read(log, most=1000), read(log)
    assert (thinned.every, len(thinned.estimate)) == (4, 751)
    np.testing.assert_array_equal(thinned.estimate.t_ns, whole.estimate.t_ns[::4])
    np.testing.assert_array_equal(thinned.truth.p, whole.truth.p[::4])
    assert thinned.aids == whole.aids or [msgspec.structs.asdict(a) for a in thinned.aids] == [
        msgspec.structs.asdict(a) for a in whole.aids
    ]
    monkeypatch.setattr("logs.report.write._MOST", 1000)
    out = log.with_name("thinned.html")
    write(log, out)
    page = Page(out)
    assert "Errors are computed from one of 4 estimates" in page.text
    assert "3001 estimates" in page.text
    assert max(known(page.part("state0", "estimate")["high"])) == pytest.approx(whole.estimate.p[:, 0].max(), rel=1e-4)
    assert truth_at(0.0)[0][0] == 40.0


def test_of_many_measurements_the_worst_are_shown(log: Path) -> None:
    (some, *_) = (a for a in read(log).aids if a.reason is Reason.FUSED)
    ratios = np.random.default_rng(2).random(25_000)
    aids = [msgspec.structs.replace(some, t_ns=some.t_ns + k, test_ratio=float(r)) for k, r in enumerate(ratios)]
    shown = thinned(aids)
    assert MOST_POINTS // 2 < len(shown) <= MOST_POINTS
    assert max(a.test_ratio for a in shown) == ratios.max()
    assert [a.t_ns for a in shown] == sorted(a.t_ns for a in shown)
    assert thinned(aids[:MOST_POINTS]) == aids[:MOST_POINTS]


def test_of_many_looks_the_strips_and_the_fits_are_bounded_and_the_worst_fit_stays(log: Path) -> None:
    collected, gathered = read(log), Gathered()
    for k in range(10_000):
        outcome, residual = ("fixed", 0.5 + (k == 4321)) if k % 3 else ("too few", np.nan)
        report = VisionReport(EPOCH_NS + k * S // 10, 0, outcome, f"{k}", 1, 1, (), (), residual, 0.1)
        gathered.frames[report.t_ns] = Frame(report=report)
    charts = vision(collected, gathered)
    strips, fit = charts["outcomes"], charts["fit"]
    assert isinstance(strips, StripChart)
    assert {name: len(stays) <= MOST_POINTS for name, stays in strips.rows.items()} == {"fixed": True, "too few": True}
    assert strips.rows["too few"][-1].end == pytest.approx(1000.0)
    assert isinstance(fit, TimeChart)
    (points,) = fit.parts
    assert isinstance(points, Points)
    assert len(points.t) <= MOST_POINTS
    assert 1.5 in points.y


def test_parts_of_fixes_are_not_taken_for_directions_of_the_map(log: Path, tmp_path: Path) -> None:
    t = EPOCH_NS + 5 * S
    part = AidStatus(t, t, "/pose_fix", "pose", Reason.FUSED, 0, (0.2, 0.1), (0.1, 0.1), 0.5)
    write(rewritten(log, tmp_path / "x.mcap", extra=((*encode(part)[0], t),)), tmp_path / "x.html")
    page = Page(tmp_path / "x.html")
    names = [p["name"] for p in page.chart("innovation0")["parts"]]
    assert names == ["1.", "2.", "3.", "4.", "5.", "6.", "not fused"]
    assert len(page.part("innovation0", "2.")["t"]) == len(page.part("innovation0", "3.")["t"]) + 1
