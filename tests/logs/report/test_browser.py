"""The report in a real browser: it draws without an error, names what is under the pointer, zooms; markup in a log stays text."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from logs.report.write import write
from tests.logs import flight_log
from tests.logs.flight_log import Flight
from tests.logs.report.test_page import Page, evil_messages

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")

LISTEN = (
    "<script>window.errors = []; window.onerror = (m) => errors.push(m); Element.prototype.setPointerCapture = () => 0;</script>"
)
PROBE = """<script>
const figure = (name) => document.querySelector(`figure[data-chart="${name}"]`);
const radius = figure("radius"), svg = radius.querySelector(":scope > svg"), readout = radius.querySelector(".readout");
const send = (kind, share) => {
  const box = svg.getBoundingClientRect();
  const clientX = box.left + (58 + share * (svg.viewBox.baseVal.width - 68)) * box.width / svg.viewBox.baseVal.width;
  svg.dispatchEvent(new PointerEvent(kind, { clientX, clientY: box.top + 50, pointerId: 1, bubbles: true }));
};
const seconds = (share) => { send("pointermove", share); return parseFloat(readout.textContent); };
const lines = () => svg.querySelectorAll("path.line").length;
const count = (selector) => document.querySelectorAll(selector).length;
const found = { figures: count("figure[data-chart]"), svgs: count("figure > svg") };
const broken = (e) => [...e.attributes].some((a) => /NaN|undefined|Infinity/.test(a.value));
found.broken = [...document.querySelectorAll("svg *")].filter(broken).length;
found.whole = [seconds(0), seconds(0.25), seconds(1)];
seconds(0.5);
found.readout = readout.textContent;
found.beside = figure("state0").querySelector(".readout").textContent;
found.here = figure("map").querySelectorAll(".here").length;
send("pointerdown", 0.25), send("pointermove", 0.5), send("pointerup", 0.5);
found.zoomed = [seconds(0), seconds(1)];
svg.dispatchEvent(new MouseEvent("dblclick"));
found.again = [seconds(0), seconds(1)];
found.lines = [lines(), (radius.querySelector(".legend button").click(), lines())];
figure("map").querySelector(".tools button").click();
found.errors = window.errors;
found.pwned = typeof window.pwned;
document.body.insertAdjacentHTML("beforeend", "<pre id=probe></pre>");
document.getElementById("probe").textContent = JSON.stringify(found);
</script>"""


def opened(page: Path, folder: Path) -> str:
    """The document as it is once its script has run."""
    assert CHROMIUM is not None
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
    flags += ["--disable-component-update", "--disable-sync", f"--user-data-dir={folder / 'profile'}", "--window-size=1200,2000"]
    command = [CHROMIUM, *flags, "--virtual-time-budget=3000", "--dump-dom", page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout


def probed(page: Path, folder: Path) -> Any:
    """What the probe finds on the page, its policy taken off."""
    source = re.sub(r"<meta http-equiv[^>]*>", LISTEN, page.read_text(encoding="utf-8"))
    copy = folder / "probed.html"
    copy.write_text(source.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    found = re.search(r'<pre id="probe">(.*?)</pre>', opened(copy, folder), re.DOTALL)
    assert found
    return json.loads(html.unescape(found.group(1)))


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    flight_log.write(folder / "x.mcap", Flight())
    write(folder / "x.mcap", folder / "x.html")
    return folder / "x.html"


def test_all_charts_are_drawn_and_tell_what_is_under_the_pointer(report: Path, tmp_path: Path) -> None:
    found = probed(report, tmp_path)
    assert found["errors"] == []
    assert found["broken"] == 0
    assert found["svgs"] == found["figures"] == len(Page(report).drawing["charts"]) > 25
    assert found["whole"] == pytest.approx([0.0, 30.0, 120.0], abs=0.1)
    assert re.fullmatch(r"60 s +· +95 % radius [\d.]+ +· +horizontal error [\d.…  ]+.*no absolute fix", found["readout"])
    assert "estimate" in found["beside"]  # every chart over time shows the same moment
    assert found["here"] == 1  # and so does the map


def test_dragging_zooms_all_and_a_double_click_shows_the_whole_flight(report: Path, tmp_path: Path) -> None:
    found = probed(report, tmp_path)
    assert found["zoomed"] == pytest.approx([30.0, 60.0], abs=0.1)
    assert found["again"] == pytest.approx([0.0, 120.0], abs=0.1)
    assert found["lines"] == [2, 1]  # the legend takes a line away


def test_the_page_as_it_is_written_may_run_its_script(report: Path, tmp_path: Path) -> None:
    assert opened(report, tmp_path).count('role="img"') == len(Page(report).drawing["charts"])


def test_markup_in_a_log_does_not_run_even_without_the_policy(report: Path, tmp_path: Path) -> None:
    source = report.with_name("x.mcap")
    attacked = flight_log.rewritten(source, tmp_path / "evil.mcap", extra=tuple(evil_messages()))
    write(attacked, tmp_path / "evil.html")
    assert "pwned=1" in (tmp_path / "evil.html").read_text()
    found = probed(tmp_path / "evil.html", tmp_path)
    assert found["pwned"] == "undefined"
    assert found["errors"] == []
    assert found["svgs"] == found["figures"]
