"""From the outcomes of single fixes to a table by cell and a plot."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
import numpy as np

from benchmarks.fixes.outcome import BAND, Outcome

HEIGHTS_M = ((10.0, 20.0), (20.0, 40.0), (40.0, 80.0), (80.0, 121.0))
TILTS_DEG = ((0.0, 5.0), (5.0, 12.0), (12.0, 18.0), (18.0, 26.0))


class Row(msgspec.Struct, frozen=True):
    """Means over the fixes of one cell."""

    cell: str
    views: int
    accepted: float
    rms_m: float
    rms_over_bound: float
    position: float
    pose: float
    alone: float
    wrong: int


def cells(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, list[Outcome]]]:
    """Two-way cells, and everything."""
    for low, high in HEIGHTS_M:
        for marks in (1, 2, 3):
            some = [o for o in outcomes if low <= o.height_m < high and o.marks == marks]
            yield f"{low:.0f}-{high:.0f} m, {marks} landmark{'s'[: marks - 1]}", some
    for low, high in TILTS_DEG:
        for roof in ("painted", "pale"):
            yield f"tilt {low:.0f}-{high:.0f} deg, {roof}", [o for o in outcomes if low <= o.tilt_deg < high and o.roof == roof]
    for sigma in sorted({o.map_sigma_m for o in outcomes}):
        for take in sorted({o.take for o in outcomes}):
            yield f"map {sigma} m, {take}", [o for o in outcomes if (o.map_sigma_m, o.take) == (sigma, take)]
        for marks in (1, 2, 3):
            some = [o for o in outcomes if (o.map_sigma_m, o.marks) == (sigma, marks)]
            yield f"map {sigma} m, {marks} landmark{'s'[: marks - 1]}", some
    yield "all", list(outcomes)


def table(outcomes: Sequence[Outcome]) -> list[Row]:
    """One row per cell that has fixes."""
    rows = []
    for name, some in cells(outcomes):
        fixes = [o for o in some if not o.reason]
        if fixes:
            mean = {what: float(np.mean([getattr(o, what) for o in fixes])) for what in ("position", "pose", "alone")}
            rms = float(np.sqrt(np.mean([o.error_m**2 for o in fixes])))
            ratio = float(np.sqrt(np.mean([(o.error_m / o.bound_m) ** 2 for o in fixes])))
            accepted, wrong = len(fixes) / len(some), sum(o.wrong for o in fixes)
            rows.append(Row(name, len(some), accepted, rms, ratio, mean["position"], mean["pose"], mean["alone"], wrong))
    return rows


def as_text(rows: Sequence[Row]) -> str:
    """The table for a person; a star marks what is out of the band."""
    lines = [
        f"{'cell':24} {'views':>6} {'fixes':>7} {'RMS m':>7} {'/bound':>7} {'d2/3':>7} {'d2/6':>7} {'alone':>7} {'wrong':>6}"
    ]
    for r in rows:
        nees = " ".join(f"{value:6.2f}{' ' if BAND[0] <= value <= BAND[1] else '*'}" for value in (r.position, r.pose, r.alone))
        lines.append(f"{r.cell:24} {r.views:6} {r.accepted:7.1%} {r.rms_m:7.3f} {r.rms_over_bound:7.2f} {nees} {r.wrong:6}")
    return "\n".join(lines)


def plot(rows: Sequence[Row], path: Path) -> None:
    """RMS over bound and squared Mahalanobis distance of every cell, with what they should be."""
    mpl.use("Agg")
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 0.26 * len(rows) + 1.6), sharey=True, layout="constrained")
    y = np.arange(len(rows))[::-1]
    left.set_ylim(-0.8, len(rows) + 1.0)
    left.barh(y, [r.rms_over_bound for r in rows], color="tab:blue")
    left.axvline(1.5, color="tab:red", label="goal: at most 1.5")
    left.set_yticks(y, [f"{r.cell}  ({r.views})" for r in rows])
    left.set_xlabel("RMS position error / Cramér-Rao bound")
    left.legend(loc="upper right")
    right.axvspan(*BAND, color="tab:green", alpha=0.15, label="goal: 0.7 to 1.5")
    right.plot([r.position for r in rows], y, "o", color="tab:blue", label="position with prior, d²/3")
    right.plot([r.alone for r in rows], y, "x", color="tab:orange", label="images alone, d²/6")
    right.axvline(1.0, color="grey", linewidth=0.8)
    right.set_xlim(left=0.0)
    right.set_xlabel("mean squared Mahalanobis distance per degree of freedom")
    right.legend(loc="lower left")
    figure.savefig(path, dpi=110)
    plt.close(figure)
