"""The campaign as tables.

in 95 %, out: cells within their 95 % band, outside their 99.99 % band; N: NEES/dof of a flight with its standard error over runs
("off 1": by more than three of them); e/B: RMSE/bound; gated, lost: of the valid measurements; missing:
instants without an estimate.
"""

from collections.abc import Iterable, Sequence

from benchmarks.campaign.runs import BLOCKS, PARTS
from benchmarks.campaign.statistics import Efficiency, Result, pooled_ratio
from benchmarks.tables import Table

AIM_INSIDE, AIM_GATED = 0.93, 0.002


def verdict(results: Sequence[Result]) -> Table:
    """What the campaign is for, against its aims."""
    cells = [cell for r in results for cell in r.consistency]
    wholes = [whole for r in results for whole in r.wholes]
    fixes = sum(sum(r.fixes.values()) for r in results)
    gated = sum(r.gated * sum(r.fixes.values()) for r in results) / fixes
    efficiency = [cell for r in results for cell in r.efficiency]
    rows = [
        ("NEES cells within 95 %", f"{share(c.inside for c in cells)} of {len(cells)}", f">= {AIM_INSIDE:.0%}"),
        ("NEES cells outside 99.99 %", str(sum(c.outside for c in cells)), "0"),
        ("NEES of whole flights off 1", f"{sum(not w.consistent for w in wholes)} of {len(wholes)}", "0"),
        *((f"RMSE/bound, {block}", ratios([e for e in efficiency if e.block == block]), "0.95-1.10") for block in BLOCKS),
        ("valid measurements gated", f"{gated:.3%} of {fixes}", f"<= {AIM_GATED:.1%}"),
        ("lost for another reason", str(sum(r.lost for r in results)), "0"),
        ("instants without an estimate", str(sum(r.missing for r in results)), "0"),
        ("internal errors", str(sum(r.internal for r in results)), "0"),
    ]
    return Table("Verdict", ("what", "measured", "aim"), rows)


def flight_table(results: Sequence[Result]) -> Table:
    """One row a flight."""
    columns = ("flight", "runs", "in 95 %", "out", *(f"N {part}" for part in PARTS), *(f"e/B {b[:3]}" for b in BLOCKS))
    columns += ("gated", "lost", "missing")
    rows = []
    for r in results:
        nees = [str(whole) for whole in r.wholes]
        ratio = [f"{pooled_ratio(e for e in r.efficiency if e.block == block):.2f}" for block in BLOCKS]
        inside, outside = share(c.inside for c in r.consistency), str(sum(c.outside for c in r.consistency))
        rows.append((r.name, str(r.runs), inside, outside, *nees, *ratio, f"{r.gated:.2%}", str(r.lost), str(r.missing)))
    return Table("Flights", columns, rows)


def ratios(cells: Sequence[Efficiency]) -> str:
    """Such as "1.02 (0.91-1.13)"."""
    each = [cell.ratio for cell in cells]
    return f"{pooled_ratio(cells):.2f} ({min(each):.2f}-{max(each):.2f})"


def share(flags: Iterable[bool]) -> str:
    """Such as "95.1 %"."""
    values = list(flags)
    return f"{100.0 * sum(values) / len(values):.1f} %"
