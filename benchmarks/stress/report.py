"""The stress table and its picture: one line a cell, medians over flights and seeds, the worst run where it fails."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.stress.cell import Row, Score
from benchmarks.stress.perturbations import KINDS
from benchmarks.tables import Table, number

MOST_RATIO, MOST_NAIVE_M, MOST_OVERCONFIDENT = 1.5, 1.0, 0.01
COLUMNS = (
    "perturbation", "size", "runs", "landfix m", "worst m", "naive m", "ratio", "complete", "overconfident %", "attitude deg",
    "resets", "in 95 %", "end m", "fails",
)  # fmt: skip


def cells(rows: Sequence[Row]) -> dict[tuple[str, float], list[Row]]:
    """The rows of each kind and size, in their order."""
    found: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        found.setdefault((row.kind, row.size), []).append(row)
    return found


def failures(row: Row) -> list[str]:
    """What a run misses: complete; RMSE within 1.5 x the plain filter's where that is below 1 m; overconfident <= 1 %."""
    ours, plain = row.landfix, row.naive
    missed = [] if ours.complete else ["incomplete"]
    below = _compares(row.kind) and plain.complete and plain.rmse_m is not None and plain.rmse_m < MOST_NAIVE_M
    if below and ours.rmse_m is not None and ours.rmse_m > MOST_RATIO * (plain.rmse_m or 0.0):
        missed.append("ratio")
    if ours.overconfident > MOST_OVERCONFIDENT:
        missed.append("overconfident")
    return missed


def _compares(kind: str) -> bool:
    """Whether the plain filter sees what landfix sees: it fuses no GNSS positions."""
    return KINDS[kind].aids != "gnss"


def stress_table(rows: Sequence[Row]) -> Table:
    """One row a cell: medians over its runs; complete of how many; the largest share of overconfident time."""
    return Table(f"Stress ({len(rows)} runs)", COLUMNS, [_line(*cell, those) for cell, those in cells(rows).items()])


def failures_table(rows: Sequence[Row]) -> Table:
    """Runs that miss a criterion, the largest error first."""
    columns = ("perturbation", "size", "flight", "seed", "landfix m", "naive m", "missed", "measurements")
    failed = sorted((r for r in rows if failures(r)), key=lambda r: -_worst(r.landfix))
    lines = [
        (r.kind, size_text(r.kind, r.size), r.flight, str(r.seed), number(r.landfix.rmse_m), number(r.naive.rmse_m),
         ", ".join(failures(r)), ", ".join(f"{n} {reason}" for reason, n in sorted(r.reasons.items())))
        for r in failed
    ]  # fmt: skip
    return Table(f"Runs that fail ({len(failed)} of {len(rows)})", columns, lines)


def changes_table(before: Sequence[Row], after: Sequence[Row]) -> Table:
    """Runs of both versions that fail in one of them only, or whose error differs by a fifth and 5 cm; new failures first."""
    known = {(r.kind, r.size, r.flight, r.seed): r for r in before}
    pairs = [(known[key], r) for r in after if (key := (r.kind, r.size, r.flight, r.seed)) in known]
    found = [(verdict, was, now) for was, now in pairs if (verdict := _verdict(was, now))]
    found.sort(key=lambda v: (v[0], -_worst(v[2].landfix)))
    lines = [
        (verdict, now.kind, size_text(now.kind, now.size), now.flight, str(now.seed), number(was.landfix.rmse_m),
         number(now.landfix.rmse_m), number(now.naive.rmse_m), number(100.0 * was.landfix.overconfident),
         number(100.0 * now.landfix.overconfident), ", ".join(failures(now)) or "-")
        for verdict, was, now in found
    ]  # fmt: skip
    columns = (
        "change",
        "perturbation",
        "size",
        "flight",
        "seed",
        "before m",
        "now m",
        "naive m",
        "overconf. before %",
        "now %",
        "fails",
    )
    failed = sum(bool(failures(was)) for was, _ in pairs), sum(bool(failures(now)) for _, now in pairs)
    return Table(f"Changes in {len(pairs)} runs: {failed[0]} failed, {failed[1]} fail now", columns, lines)


def _verdict(was: Row, now: Row) -> str:
    """How a run changed; "" where it did not."""
    failed, fails = bool(failures(was)), bool(failures(now))
    if failed != fails:
        return "1 fails" if fails else "2 passes"
    a, b = _worst(was.landfix), _worst(now.landfix)
    return "3 worse" if b > max(1.2 * a, a + 0.05) else "4 better" if a > max(1.2 * b, b + 0.05) else ""


def _worst(score: Score) -> float:
    return np.inf if score.rmse_m is None else score.rmse_m


def _line(kind: str, size: float, rows: list[Row]) -> tuple[str, ...]:
    ours, naive = median([r.landfix.rmse_m for r in rows]), median([r.naive.rmse_m for r in rows])
    missed = sorted({what for row in rows for what in failures(row)})
    largest = max((r.landfix.rmse_m for r in rows if r.landfix.rmse_m is not None), default=None)
    inside = median([r.landfix.inside95 for r in rows])
    return (
        kind, size_text(kind, size), str(len(rows)), number(ours), number(largest), number(naive),
        number(ours / naive if ours is not None and naive and _compares(kind) else None),
        f"{sum(r.landfix.complete for r in rows)}/{len(rows)}",
        number(100.0 * max(r.landfix.overconfident for r in rows)),
        number(median([r.landfix.attitude_deg for r in rows])),
        number(max(r.resets for r in rows)),
        number(None if inside is None else 100.0 * inside),
        number(median([r.landfix.end_m for r in rows])),
        ", ".join(missed) or "-",
    )  # fmt: skip


def median(values: Sequence[float | None]) -> float | None:
    """Of those that there are."""
    there = [v for v in values if v is not None]
    return float(np.median(there)) if there else None


def size_text(kind: str, size: float) -> str:
    return f"{size:g} {KINDS[kind].unit}".strip()


def draw(rows: Sequence[Row], path: Path) -> None:
    """RMSE of both filters at each cell, logarithmic; crosses: not complete; red: overconfident for more than 1 % of the time."""
    mpl.use("Agg")
    found = cells(rows)
    fig, ax = plt.subplots(figsize=(9, 1.2 + 0.17 * len(found)), layout="constrained")
    y = np.arange(len(found))
    ours = [median([r.landfix.rmse_m for r in those]) for those in found.values()]
    naive = [median([r.naive.rmse_m for r in those]) for those in found.values()]
    whole = np.array([all(r.landfix.complete for r in those) for those in found.values()])
    sure = np.array([max(r.landfix.overconfident for r in those) > MOST_OVERCONFIDENT for those in found.values()])
    x = np.array([np.nan if v is None else v for v in ours])
    ax.plot([np.nan if v is None else v for v in naive], y, "o", fillstyle="none", color="tab:orange", label="plain filter")
    ax.plot(x[~sure], y[~sure], "o", color="tab:blue", label="landfix")
    ax.plot(x[sure], y[sure], "o", color="tab:red", label="landfix, overconfident")
    ax.plot(np.where(np.isnan(x), 1e4, x)[~whole], y[~whole], "kx", markersize=9, label="landfix, not complete")
    ax.set_yticks(y, [f"{kind}: {size_text(kind, size)}" for kind, size in found], fontsize=7)
    ax.set(xscale="log", xlabel="position RMSE outside outages [m], median of runs", ylim=(len(found) - 0.5, -0.5))
    ax.grid(visible=True, axis="x", alpha=0.3)
    ax.legend(loc="upper right", fontsize=7)
    fig.savefig(path, dpi=110)
    plt.close(fig)
