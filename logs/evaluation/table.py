"""An Evaluation as tables for terminal and page."""

from collections.abc import Sequence
from textwrap import wrap

from rich import box
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from logs.evaluation.integrity import IntegritySummary, Regions
from logs.evaluation.metrics import Consistency, Stats
from logs.evaluation.records import Accuracy, ConsistencySummary, Evaluation

_OF_A_LIMIT = ("limit m", "available", "hazardous", "unavailable")  # rows of the integrity table that need one

_OTHERS = 36  # characters of a line of reasons

Rows = tuple[str, tuple[str, ...], Sequence[Sequence[str]]]  # title, header, rows


def print_table(evaluation: Evaluation, console: Console | None = None) -> None:
    """Print it, the most important first."""
    console = console or Console()
    console.print(_summary(evaluation))
    if evaluation.accuracy:
        console.print(_table(*accuracy(evaluation.accuracy)))
    if evaluation.consistency:
        console.print(_table(*consistency(evaluation.consistency)))
    if evaluation.integrity:
        console.print(_table(*integrity(evaluation.integrity)))
    for title, header, rows in (outages(evaluation), odometry(evaluation), _narrow(aids(evaluation)), resets(evaluation)):
        if rows:
            console.print(_table(title, header, rows))
    for note in evaluation.notes:
        console.print(f"note: {note}", style="yellow", markup=False, highlight=False)


def _narrow(table: Rows) -> Rows:
    title, (source, kind, *numbers), rows = table
    fused, _, *others = numbers
    return title, (f"{source}, {kind}", fused, *others), [
        ("\n  ".join([f"{r[0]} {r[1]}", *(wrap(r[3], _OTHERS) if r[3] != "-" else ())]), r[2], *r[4:]) for r in rows
    ]  # fmt: skip


def _table(title: str, columns: tuple[str, ...], rows: Sequence[Sequence[str]]) -> Group:
    """The title is as wide as the screen, not as its table."""
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=not k)
    for row in rows:
        table.add_row(*map(Text, row))
    return Group(Text(title, style="bold"), table)


def number(x: float | None, digits: int = 3) -> str:
    """Three significant digits, "-" for unknown."""
    if x is None or x != x:  # noqa: PLR0124  (nan)
        return "-"
    return f"{x:.{digits}g}" if abs(x) < 1000 else f"{x:.0f}"


def _summary(e: Evaluation) -> Text:
    modes = ", ".join(f"{mode} {share:.1%}" for mode, share in sorted(e.modes.items(), key=lambda m: -m[1]))
    latency = ", ".join(f"{topic} {1e3 * p.p50:.1f} / {1e3 * p.p99:.1f} ms" for topic, p in e.latency_s.items())
    lines = [
        e.log,
        f"{e.duration_s:.1f} s, {e.distance_m:.1f} m, {e.estimates} estimates",
        f"compared with {e.compared_with} at {e.compared} of {e.truth_samples} stamps ({e.without_estimate} without an estimate)",
        f"modes: {modes or 'not reported'}",
        f"outages: {e.without_absolute_s:.1f} s without absolute information (gaps longer than {_thresholds(e)})",
        f"latency, median / 99 %: {latency}",
    ]
    return Text("\n".join(lines))


def accuracy(a: Accuracy) -> Rows:
    """Errors against the truth."""
    errors: list[tuple[str, Stats, str]] = [
        ("position", a.position_m, "m"),
        ("  outside outages", a.aided_position_m, "m"),
        ("  horizontal", a.horizontal_m, "m"),
        ("  vertical", a.vertical_m, "m"),
        ("  aligned in yaw and position", a.yaw_aligned_m, "m"),
        ("  aligned, SE(3)", a.se3_aligned_m, "m"),
        (f"  aligned, Sim(3), scale {a.sim3_scale:.4f}", a.sim3_aligned_m, "m"),
        ("velocity", a.velocity_m_s, "m/s"),
        ("attitude", a.attitude_deg, "deg"),
        ("  outside outages", a.aided_attitude_deg, "deg"),
        ("  tilt", a.tilt_deg, "deg"),
        ("  heading", a.heading_deg, "deg"),
    ]
    for r in a.relative:
        errors += [(f"relative, over {r.over}", r.translation_m, "m"), ("", r.rotation_deg, "deg")]
    rows = [(name, number(s.rmse), number(s.mean), number(s.median), number(s.max), unit) for name, s, unit in errors if s.n]
    return "Accuracy", ("error", "RMSE", "mean", "median", "max", "unit"), rows


def consistency(h: ConsistencySummary) -> Rows:
    """Whether the covariance agrees with the errors."""
    parts: list[tuple[str, Consistency]] = [
        ("position", h.position),
        ("  aided", h.position_aided),
        ("  in outages", h.position_outages),
        ("attitude", h.attitude),
        ("velocity", h.velocity),
        ("pose", h.pose),
    ]
    rows = []
    for name, c in parts:
        if c.n:
            low, high = c.band
            verdict = "consistent" if c.consistent else "overconfident" if c.mean > high else "cautious"
            rows.append((
                name, number(c.mean), f"{low:.2f}-{high:.2f}", f"{c.inside:.1%}", f"{c.covered:.1%}",
                str(c.n), f"{c.n_effective:.0f}", verdict,
            ))  # fmt: skip
    covered = f"{h.radius95_covered:.1%} inside the 95 % horizontal radius (median {h.radius95_median_m:.3g} m)"
    header = ("NEES / dof", "mean", "95 % band", "in band", "in 95 %", "n", "n eff", "verdict")
    return f"Consistency: {covered}", header, rows


def integrity(i: IntegritySummary) -> Rows:
    """Protection levels against errors, horizontal and vertical; states."""
    is_judged = any(limit is not None for limit in i.limits_m)
    sides = zip(("horizontal", "vertical"), (i.horizontal, i.vertical), i.limits_m, strict=True)
    columns = {side: _against(r, limit, i.risks_per_hour) for side, r, limit in sides if r is not None}
    names = [name for name in next(iter(columns.values()), {}) if is_judged or name not in _OF_A_LIMIT]
    rows = [(name, *(column[name] for column in columns.values())) for name in names]
    states = ", ".join(f"{state} {share:.1%}" for state, share in sorted(i.states.items(), key=lambda s: -s[1]))
    said = states if is_judged else "no alert limits configured, so nothing is judged"
    return f"Integrity at {i.risk_per_hour:g} per hour, {i.hours:.2g} h: {said}", ("", *columns), rows


def _against(r: Regions, limit_m: float | None, risks_per_hour: Sequence[float]) -> dict[str, str]:
    of_limit = ("none", "-", "-", "-")
    if limit_m is not None:
        of_limit = (number(limit_m), f"{r.available:.1%}", str(r.hazardous), str(r.unavailable))
    median = "unbounded" if r.median_level_m is None else number(r.median_level_m)
    counts = {"compared": r.compared, "nominal": r.nominal, "misleading": r.misleading}
    above = {f"above PL({risk:g}/h)": n for risk, n in zip(risks_per_hour, r.exceeded, strict=False)}
    shown = {name: str(n) for name, n in (counts | above).items()}
    return dict(zip(_OF_A_LIMIT, of_limit, strict=True)) | {"median level m": median} | shown


def outages(e: Evaluation) -> Rows:
    """Spans without absolute information."""
    rows = []
    for o in e.outages:
        d = o.drift
        drift = (d.rmse_m, d.max_m, d.end_m, d.end_percent) if d else (None,) * 4
        values = (*drift, o.radius95_end_m, o.nees_position, o.attitude_rmse_deg)
        rows.append((o.source, f"{o.start_s:.1f}", f"{o.duration_s:.1f}", *(number(x) for x in values)))
    header = ("source", "at s", "for s", "RMSE m", "max m", "end m", "end %", "95 % m", "NEES/3", "att deg")
    return f"Outages: waits for absolute information longer than {_thresholds(e)}", header, rows


def odometry(e: Evaluation) -> Rows:
    """Drift in outages with odometry, and without it."""
    rows = [
        (o.source, f"{o.start_s:.1f}", f"{o.duration_s:.1f}", str(o.increments), number(o.drift.distance_m),
         number(o.drift.end_m), number(o.radius95_end_m), number(o.without_odometry_m))
        for o in e.outages
        if o.increments and o.drift
    ]  # fmt: skip
    header = ("source", "at s", "for s", "increments", "way m", "end m", "95 % m", "without m")
    return "Odometry in outages: error at the end, with it and without", header, rows


def _thresholds(e: Evaluation) -> str:
    return ", ".join(f"{s:.1f} s ({source})" for source, s in e.outage_thresholds_s.items())


def aids(e: Evaluation) -> Rows:
    """Decisions on each source's measurements."""
    rows = []
    for a in e.aids:
        others = ", ".join(f"{reason} {n}" for reason, n in a.reasons.items() if reason != "fused")
        ratio, delay = a.test_ratio, a.delay_s
        rows.append((
            a.topic, a.kind, str(a.reasons.get("fused", 0)), others or "-", number(a.nis), number(ratio.p95 if ratio else None),
            number(delay.p50 if delay else None), number(delay.max if delay else None),
        ))  # fmt: skip
    return "Measurements", ("source", "kind", "fused", "others", "NIS/dof", "ratio 95 %", "delay s", "max"), rows


def resets(e: Evaluation) -> Rows:
    """Jumps of the estimate."""
    rows = [
        (str(r.counter), f"{r.t_s:.2f}", number(r.position_m), number(r.velocity_m_s), number(r.attitude_deg)) for r in e.resets
    ]
    return "Resets", ("number", "at s", "position m", "velocity m/s", "attitude deg"), rows
