"""The campaign for a person: tables, a page of Markdown."""

from collections.abc import Iterable, Sequence

from benchmarks.campaign.runs import BLOCKS, PARTS
from benchmarks.campaign.statistics import Consistency, Efficiency, Result, pooled_nees, pooled_ratio
from benchmarks.tables import Table

AIM_INSIDE, AIM_GATED = 0.93, 0.002
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


def markdown(tables: Sequence[Table]) -> str:
    """The whole page."""
    head = "# Campaign: consistency and efficiency over many simulated flights\n\n" + HOW + "\n"
    return head + "\n".join(table.markdown() for table in tables)
