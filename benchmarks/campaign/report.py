"""The campaign for a person: tables, a page of Markdown, a figure."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.campaign.runs import BLOCKS, PARTS
from benchmarks.campaign.statistics import Consistency, Efficiency, Result, pooled_nees, pooled_ratio
from benchmarks.tables import Table

AIM_INSIDE, AIM_GATED, AIM_RATIO = 0.93, 0.002, (0.95, 1.10)
WORST = 15  # cells listed
PHASES = ("before", "during", "end", "after")

HOW = """NEES/dof is the mean over seeds at one instant of a flight: 1 is consistent, more is overconfident. A cell is one instant
and one of pose (6 degrees of freedom), velocity (3) and full state (15). RMSE/bound: root mean square error over the posterior
Cramer-Rao bound along each true trajectory, pooled over instants (in brackets: the extremes of single cells, which scatter by
about 0.5/sqrt(seeds)). In the tables: in 95 %, out: cells within their 95 % band, outside their 99.99 % band; N: NEES/dof; e/B:
RMSE/bound of position, velocity, attitude; gated, lost: of the valid measurements (lost: for any other reason); missing: instants
without an estimate.

Cells of one flight go together, because a run's biases last: with few seeds many of them are outside at once, in one flight and
not in the next. Runs are independent. So N of a flight is given with its standard error over runs; "off 1" is by more than three
of them.

The filter aligns by itself: from pose fixes; GNSS flights have them for the first 20 s, those called "alone" never. Its priors of
the biases are the grade's turn-on values, so they are the truth's distribution; that of the velocity (10 m/s) is not, and scoring
begins 99 s later, when it is forgotten. Levelling at rest is switched off, so that the bound can begin at the first pose fix
with exactly the filter's covariance (for GNSS alone: with a diffuse one). Gates and fault logic are as by default; of what the
sensors do, the filter is configured with the noise of the IMU's grade and, in matched flights, that GNSS has no slow error.
"""


def verdict(results: Sequence[Result]) -> Table:
    """What the campaign is for, against its aims."""
    rows: list[tuple[str, str, str]] = []
    matched = [r for r in results if r.matched]
    if matched:
        cells = [cell for r in matched for cell in r.consistency]
        wholes = [whole for r in matched for whole in r.wholes]
        fixes = sum(sum(r.fixes.values()) for r in matched)
        gated = sum(r.gated * sum(r.fixes.values()) for r in matched) / fixes
        efficiency = [cell for r in matched for cell in r.efficiency]
        rows += [
            ("NEES cells within 95 %", f"{share(c.inside for c in cells)} of {len(cells)}", f">= {AIM_INSIDE:.0%}"),
            ("NEES cells outside 99.99 %", str(sum(c.outside for c in cells)), "0"),
            ("NEES of whole flights off 1", f"{sum(not w.consistent for w in wholes)} of {len(wholes)}", "0"),
            *((f"RMSE/bound, {block}", ratios([e for e in efficiency if e.block == block]), "0.95-1.10") for block in BLOCKS),
            ("valid measurements gated", f"{gated:.3%} of {fixes}", f"<= {AIM_GATED:.1%}"),
            ("lost for another reason", str(sum(r.lost for r in matched)), "0"),
            ("instants without an estimate", str(sum(r.missing for r in matched)), "0"),
            ("internal errors", str(sum(r.internal for r in results)), "0"),
        ]
    return Table("Verdict (matched sensors)", ("what", "measured", "aim"), rows)


def flight_table(title: str, results: Sequence[Result]) -> Table:
    """One row a flight."""
    columns = ("flight", "runs", "in 95 %", "out", *(f"N {part}" for part in PARTS), *(f"e/B {b[:3]}" for b in BLOCKS))
    columns += ("gated", "lost", "missing")
    rows = []
    for r in results:
        nees = [str(whole) for whole in r.wholes]
        ratio = [f"{pooled_ratio(e for e in r.efficiency if e.block == block):.2f}" for block in BLOCKS]
        inside, outside = share(c.inside for c in r.consistency), str(sum(c.outside for c in r.consistency))
        rows.append((r.name, str(r.runs), inside, outside, *nees, *ratio, f"{r.gated:.2%}", str(r.lost), str(r.missing)))
    return Table(title, columns, rows)


def phase_table(results: Sequence[Result]) -> Table:
    """Pooled over flights: before, during, at the end of and after outages of each length."""
    columns = ("outage", "when", "in 95 %", *(f"N {part}" for part in PARTS), *(f"e/B {b[:3]}" for b in BLOCKS))
    cells = [cell for r in results for cell in r.consistency]
    efficiency = [cell for r in results for cell in r.efficiency]
    rows = []
    for length in sorted({c.instant.outage_s for c in cells}):
        for phase in PHASES:
            here = [c for c in cells if (c.instant.outage_s, c.instant.phase) == (length, phase)]
            of = [e for e in efficiency if (e.instant.outage_s, e.instant.phase) == (length, phase)]
            nees = [f"{pooled_nees(c for c in here if c.part == part):.2f}" for part in PARTS]
            ratio = [f"{pooled_ratio(e for e in of if e.block == block):.2f}" for block in BLOCKS]
            rows.append((f"{length:g} s", phase, share(c.inside for c in here), *nees, *ratio))
    return Table("By outage, matched flights", columns, rows)


def worst_table(results: Sequence[Result]) -> Table:
    """The cells farthest outside their band, in widths of it."""
    cells = sorted(((beyond(c), r.name, c) for r in results for c in r.consistency if not c.inside), key=lambda row: -row[0])
    rows = [
        (name, f"{c.instant.t_s:.2f}", c.instant.label, c.part, f"{c.mean:.2f}", f"{c.band95[0]:.2f}-{c.band95[1]:.2f}")
        for _, name, c in cells[:WORST]
    ]
    title = f"Matched cells outside 95 %: the worst of {len(cells)}"
    return Table(title, ("flight", "t s", "when", "part", "NEES/dof", "95 % band"), rows)


def beyond(cell: Consistency) -> float:
    """How far outside its 95 % band, in half widths of it; 0 inside."""
    low, high = cell.band95
    return max(low - cell.mean, cell.mean - high, 0.0) / (0.5 * (high - low))


def ratios(cells: Sequence[Efficiency]) -> str:
    """Such as "1.02 (0.91-1.13)"."""
    each = [cell.ratio for cell in cells]
    return f"{pooled_ratio(cells):.2f} ({min(each):.2f}-{max(each):.2f})"


def share(flags: Iterable[bool]) -> str:
    """Such as "95.1 %"."""
    values = list(flags)
    return f"{100.0 * sum(values) / len(values):.1f} %"


def figure(results: Sequence[Result], path: Path) -> None:
    """NEES/dof of the three parts and RMSE/bound of the three blocks, cell by cell in order of time, matched flights."""
    mpl.use("Agg")
    fig, axes = plt.subplots(2, 3, figsize=(18, 9), sharex=True, layout="constrained")
    colours = plt.get_cmap("tab10")
    for column, (part, block) in enumerate(zip(PARTS, BLOCKS, strict=True)):
        top, bottom = axes[0, column], axes[1, column]
        for k, r in enumerate(results):
            style = {"color": colours(k % 10), "marker": "os^Dv"[k % 5], "markersize": 4, "linewidth": 0.8, "label": r.name}
            cells = [c for c in r.consistency if c.part == part]
            top.plot(range(len(cells)), [c.mean for c in cells], **style)
            bottom.plot(range(len(cells)), [e.ratio for e in r.efficiency if e.block == block], **style)
        widest = [c for c in max(results, key=lambda r: len(r.consistency)).consistency if c.part == part]
        for band, shade in ((widest[0].band9999, 0.15), (widest[0].band95, 0.3)):
            top.axhspan(*band, color="gray", alpha=shade, zorder=0, linewidth=0)
        bottom.axhspan(*AIM_RATIO, color="tab:green", alpha=0.2, zorder=0, linewidth=0)
        top.set_title(f"NEES/dof, {part}")
        bottom.set_title(f"RMSE / bound, {block}")
        for ax in (top, bottom):
            _decorate(ax, widest)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    runs = results[0].runs
    fig.legend(handles, labels, loc="outside lower center", ncols=5)
    fig.suptitle(
        f"{runs} seeds a flight; grey: 95 % and 99.99 % bands of the mean; green: aim; shaded columns: no absolute aid",
        fontsize=11,
    )
    fig.savefig(path, dpi=100)
    plt.close(fig)


def _decorate(ax: Axes, cells: Sequence[Consistency]) -> None:
    """Outages as shaded columns with their length; a scale that shows both sides of 1 alike."""
    lengths = [c.instant.outage_s for c in cells]
    for length in dict.fromkeys(lengths):
        dark = [k for k, c in enumerate(cells) if c.instant.outage_s == length and c.instant.phase in {"during", "end"}]
        ax.axvspan(dark[0] - 0.5, dark[-1] + 0.5, color="tab:red", alpha=0.08, zorder=0, linewidth=0)
    middles = [sum(k for k, s in enumerate(lengths) if s == length) / lengths.count(length) for length in dict.fromkeys(lengths)]
    ax.set_xticks(middles, [f"{length:g} s" for length in dict.fromkeys(lengths)])
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    least, most = min(low, 0.6), max(high, 1.6)
    ax.set_ylim(least, most)
    ticks = [m * 10.0**e for e in range(-2, 6) for m in ((0.6, 0.8, 1.0, 1.25, 1.6) if most < 5 else (1.0, 3.0))]
    ax.set_yticks([t for t in ticks if least <= t <= most], [f"{t:g}" for t in ticks if least <= t <= most])
    ax.minorticks_off()
    ax.axhline(1.0, color="black", linewidth=0.8)
    ax.grid(visible=True, axis="y", alpha=0.25)


def markdown(tables: Sequence[Table], picture: bool) -> str:
    """The whole page."""
    head = "# Campaign: consistency and efficiency over many simulated flights\n\n" + HOW + "\n"
    image = "![NEES and RMSE/bound by cell](campaign.png)\n\n" if picture else ""
    return head + image + "\n".join(table.markdown() for table in tables)
