"""From the outcomes of single fixes to a table by cell."""

from collections.abc import Iterator, Sequence

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
