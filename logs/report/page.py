"""Sections of a report and its page."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from logs.evaluation import table as evaluation_table
from logs.evaluation.collected import Collected
from logs.evaluation.evaluate import Comparison, compare
from logs.evaluation.records import Evaluation
from logs.evaluation.table import number
from logs.report import integrity as report_integrity
from logs.report import map as report_map
from logs.report import plots as report_plots
from logs.report.charts import Chart, Drawing, Span
from logs.report.gather import Gathered
from logs.report.no_estimate import topics
from logs.report.words import Finding, Level, duration, refusals, summary
from models import web_page
from models.maps.landmarks import Landmark
from models.messages import Reason
from models.radius import horizontal_radius
from models.web_page import text

_SHOWN_BYTES: Final = 40_000  # of an attached text
_MOST_WORDS: Final = 50
_SCRIPTS: Final = ("tools.js", "time.js", "map.js", "page.js")


class Shot(msgspec.Struct, frozen=True):
    """A gallery image (JPEG) and its caption."""

    t_ns: int
    outcome: str
    words: str
    jpeg: bytes
    good: bool


@dataclass(frozen=True, slots=True)
class Illustrations:
    """Additions of vision."""

    landmarks: Sequence[Landmark] = ()
    shots: Sequence[Shot] = ()
    note: str = ""


@dataclass(frozen=True, slots=True)
class Material:
    """Contents of a report."""

    collected: Collected
    gathered: Gathered
    evaluation: Evaluation
    outages: list[tuple[int, int]]
    findings: list[Finding]
    illustrations: Illustrations

    @property
    def start_ns(self) -> int:
        """Zero of the time axis."""
        return int(self.collected.estimate.t_ns[0])

    @property
    def name(self) -> str:
        """Of the log."""
        return Path(self.evaluation.log).name

    @property
    def level(self) -> Level:
        """The worst of the findings."""
        return max((f.level for f in self.findings), default=Level.FINE)


class _Sheet:
    def __init__(self) -> None:
        self.charts: dict[str, Chart] = {}

    def add(self, charts: dict[str, Chart], columns: str = "") -> str:
        self.charts |= charts
        figures = "".join(f'<figure data-chart="{text(name)}"></figure>' for name in charts)
        return f'<div class="charts {columns}">{figures}</div>' if figures else ""


def page(m: Material) -> str:
    """The whole page."""
    sheet = _Sheet()
    c = compare(m.collected.estimate, m.collected.truth)
    parts = {
        "Map": sheet.add({"map": report_map.flight(m.collected, m.gathered, m.outages, m.illustrations.landmarks)}, "one"),
        "Error and 95 % radius": _errors(m, sheet, c),
        "Integrity": _integrity(m, sheet, c),
        "Outages and resets": _beside(
            evaluation_table.outages(m.evaluation), evaluation_table.odometry(m.evaluation), evaluation_table.resets(m.evaluation)
        )
        or _faint("None."),
        "Measurements": _measurements(m, sheet),
        "Vision": _vision(m, sheet),
        "State": sheet.add(report_plots.states(m.collected, m.gathered), "three"),
        "Biases": sheet.add(report_plots.biases(m.collected, m.gathered))
        or _faint("The health messages in this log hold no biases."),
        "Health": _health(m, sheet),
        "Times and drops": sheet.add(report_plots.times(m.collected, m.gathered), "three")
        + web_page.table(topics(m.gathered, m.start_ns))
        + _daemon(m),
        "Configuration and calibration": _attachments(m),
    }
    parts = {name: body for name, body in parts.items() if body}
    links = " ".join(f'<a href="#{_anchor(name)}">{text(name)}</a>' for name in parts)
    sections = "".join(f'<section id="{_anchor(name)}"><h2>{text(name)}</h2>{body}</section>' for name, body in parts.items())
    end = (int(m.collected.estimate.t_ns[-1]) - m.start_ns) * 1e-9
    spans = [Span((a - m.start_ns) * 1e-9, (b - m.start_ns) * 1e-9, "no absolute fix") for a, b in m.outages]
    drawing = msgspec.json.encode(Drawing(sheet.charts, spans, 0.0, max(end, 1e-3))).decode()
    body = (
        f"{_head(m)}<nav>{links}<button type='button' data-whole>whole flight</button>"
        ' <span class="faint">drag in a plot to zoom in time, double-click to see all</span></nav>'
        f'{sections}<script type="application/json" id="drawing">{_inert(drawing)}</script>'
    )
    return web_page.page(f"landfix: {m.name}", body, _file("page.css"), "".join(map(_file, _SCRIPTS)))


def _inert(json: str) -> str:
    """JSON that cannot end its HTML element."""
    return json.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _file(name: str) -> str:
    return resources.files("logs.report").joinpath(name).read_text(encoding="utf-8")


def _anchor(name: str) -> str:
    return name.lower().replace(" ", "-")


def _faint(words: str) -> str:
    return f'<p class="faint">{text(words)}</p>'


def _beside(*tables: web_page.Table) -> str:
    filled = "".join(f"<div>{web_page.table(t)}</div>" for t in tables if t[2])
    return f'<div class="beside">{filled}</div>' if filled else ""


def _at(m: Material, t_ns: int) -> str:
    return f"{round((t_ns - m.start_ns) * 1e-9, 1) + 0.0:.1f}"


def _head(m: Material) -> str:
    e, began = m.evaluation, np.datetime64(m.start_ns, "ns").astype("datetime64[s]")
    reasons = "".join(f'<li class="is-{f.level.colour}">{text(f.text)}</li>' for f in m.findings)
    landfix = m.collected.metadata.get("landfix", {}).get("version", "")
    made = f" by landfix {landfix}" if landfix else ""
    tiles = "".join(f'<div class="tile"><b>{text(value)}</b><span>{text(name)}</span></div>' for name, value in _tiles(m))
    thinned = f" Errors are computed from one of {m.collected.every} estimates." if m.collected.every > 1 else ""
    return (
        f'<h1>{text(m.name)}</h1><p class="faint">First estimate {text(began)} UTC{text(made)}.{thinned}</p>'
        f"<p>{web_page.verdict(m.level.word, m.level.colour)}</p><ul class='reasons'>{reasons}</ul>"
        f"<p>{text(summary(e, m.gathered))}</p><div class='tiles'>{tiles}</div>"
    )


def _tiles(m: Material) -> list[tuple[str, str]]:
    e, estimate = m.evaluation, m.collected.estimate
    radius = horizontal_radius(estimate.covariance[:, :2, :2])
    if m.gathered.signals is not None:
        radius = m.gathered.signals.high[:, 18]
    tiles = [
        ("flown", f"{e.distance_m:.0f} m"),
        ("in", duration(e.duration_s)),
        ("without absolute fix", duration(e.without_absolute_s)),
    ]
    if np.isfinite(radius).any():
        tiles.append(("worst 95 % radius", f"{number(float(np.nanmax(radius)))} m"))
    if e.accuracy:
        tiles += [
            ("RMS position error", f"{number(e.accuracy.position_m.rmse)} m"),
            ("largest", f"{number(e.accuracy.position_m.max)} m"),
        ]
    if e.consistency:
        tiles.append(("of the time inside the 95 % radius", f"{e.consistency.radius95_covered:.0%}"))
    fused = sum(a.reasons.get("fused", 0) for a in e.aids)
    refused = sum(n for a in e.aids for n in refusals(a).values())
    if fused + refused:
        tiles.append(("measurements refused", f"{refused} of {fused + refused}"))
    return tiles


def _errors(m: Material, sheet: _Sheet, c: Comparison) -> str:
    body = sheet.add(report_plots.reported_and_true(m.collected, m.gathered, c), "one")
    body += sheet.add(report_plots.errors(m.collected, c), "three") + sheet.add(report_plots.consistency(m.collected, c), "one")
    tables = [evaluation_table.accuracy(m.evaluation.accuracy)] if m.evaluation.accuracy else []
    tables += [evaluation_table.consistency(m.evaluation.consistency)] if m.evaluation.consistency else []
    return body + _beside(*tables)


def _integrity(m: Material, sheet: _Sheet, c: Comparison) -> str:
    levels, found = m.collected.integrity, m.evaluation.integrity
    if found is None:
        return ""
    body = web_page.table(evaluation_table.integrity(found)) + sheet.add(report_integrity.charts(levels, c, m.start_ns), "one")
    plots = report_integrity.plots(levels, c)
    words = "Each protection level with the largest error until the next one, logarithmic; darker: ten times as many."
    return body + plots + (_faint(words) if plots else "")


def _measurements(m: Material, sheet: _Sheet) -> str:
    _, header, rows = evaluation_table.aids(m.evaluation)
    counts = [max(sum(a.reasons.values()) - a.reasons.get("thinned", 0), 0) for a in m.evaluation.aids]
    note = f"Of more than {report_plots.MOST_POINTS} measurements plots show some, those that fit worst among them."
    return (
        _beside(("By source", header, rows), _refused(m))
        + (_faint(note) if max(counts, default=0) > report_plots.MOST_POINTS else "")
        + sheet.add(report_plots.innovations(m.collected), "three")
    )


def _refused(m: Material) -> web_page.Table:
    groups: dict[tuple[str, str, str], list[int]] = {}
    for row, aid in enumerate(m.collected.aids):
        if aid.reason is not Reason.FUSED:
            groups.setdefault((aid.topic, aid.kind, aid.reason), []).append(row)
    rows = []
    for (topic, kind, reason), members in sorted(groups.items(), key=lambda g: -len(g[1])):
        aids = [m.collected.aids[k] for k in members]
        at = [_at(m, a.t_ns) for a in (aids[0], aids[-1])]
        worst = max(aids, key=lambda a: a.test_ratio)
        ratio = number(worst.test_ratio) if worst.test_ratio else "-"
        rows.append((topic, kind, reason, str(len(aids)), *at, ratio, worst.detail))
    return "Not fused", ("source", "kind", "reason", "how many", "first s", "last s", "worst ratio", "for example"), rows


def _vision(m: Material, sheet: _Sheet) -> str:
    charts = sheet.add(report_plots.vision(m.collected, m.gathered))
    shots = "".join(_figure(m, s) for s in m.illustrations.shots)
    note = _faint(m.illustrations.note) if m.illustrations.note and (charts or shots) else ""
    return charts + (f"<h3>Images</h3><div class='gallery'>{shots}</div>" if shots else "") + note


def _figure(m: Material, s: Shot) -> str:
    kind = "good" if s.good else "usable"
    said = f'<b class="is-{kind}">{text(s.outcome)}</b>{_at(m, s.t_ns)} s, {text(s.words)}'
    return f"<figure>{web_page.image(s.outcome, s.jpeg, 'jpeg')}<figcaption>{said}</figcaption></figure>"


def _health(m: Material, sheet: _Sheet) -> str:
    strip, numbers = report_plots.mode_and_sources(m.collected, m.gathered), report_plots.health(m.collected, m.gathered)
    return sheet.add(strip, "one") + sheet.add(numbers, "three") + web_page.table(_remarks(m))


def _remarks(m: Material) -> web_page.Table:
    remarks: dict[str, list[int]] = {}
    for s in m.gathered.details:
        if s.state:
            remarks.setdefault(s.state, []).append(s.t_ns)
    rows = [(_at(m, at[0]), str(len(at)), remark) for remark, at in remarks.items()]
    return "Remarks of the estimator", ("first at s", "times", ""), rows[:_MOST_WORDS]


def _daemon(m: Material) -> str:
    rows = [(key, value) for key, value in m.gathered.daemon.items()]
    table = web_page.table(("", (), rows))
    return f"<details><summary>Last status of the daemon</summary>{table}</details>" if rows else ""


def _attachments(m: Material) -> str:
    files = [(a.name, a.media_type, f"{len(a.data)} bytes", sha256(a.data).hexdigest()[:16]) for a in m.collected.attachments]
    facts = [(f"{record} {key}", value) for record, values in m.collected.metadata.items() for key, value in values.items()]
    body = web_page.table(("Files in the log", ("name", "type", "size", "sha256, its beginning"), files))
    body += web_page.table(("", (), facts))
    for a in m.collected.attachments:
        words = _readable(a.data)
        if words:
            body += f"<details><summary>{text(a.name)}</summary><pre>{text(words)}</pre></details>"
    return body or _faint("No configuration is attached to this log.")


def _readable(data: bytes) -> str:
    try:
        words = data.decode()
    except UnicodeDecodeError:
        return ""
    return words if len(words) <= _SHOWN_BYTES else f"{words[:_SHOWN_BYTES]}\n... and {len(words) - _SHOWN_BYTES} characters more"
