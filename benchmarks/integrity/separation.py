"""What solution separation by filters that leave one source out adds to the levels: `python -m benchmarks.integrity.separation`.

For each absolute source s a second estimator has every message but those of s, the whole flight long. With its position x_s and
covariance P_s the level is at least that of the one fault "s is wrong for long", by the same equation as the rest
(estimator/integrity/faults.py):

    p = r tau / 3600,   p' = p / (p + exp(-t^2 / 2)),   t^2 = d_h^2 / sigma_h^2 + d_v^2 / sigma_v^2,   d = x_s - x
    PL = max(PL of estimator/integrity, PL of the one mode (p', d, sigma_s))          (risk at most twice: a union of both)

An upper bound of what such filters can show: these never fused anything of s. Columns: errors above PL at 1e-5 per hour, the
worst error / PL, share of the time with HPL <= 10 m; with the filters in addition; processor time of them / of the estimator.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.rows import LIMITS, Row
from benchmarks.integrity.runs import compared, flown
from benchmarks.stress.cell import perturbed
from benchmarks.stress.flights import load_flight
from benchmarks.stress.perturbations import KINDS
from benchmarks.tables import Table
from estimator.integrity.monitor import RISKS
from estimator.integrity.protection import Mode, Tail, allowed, in_plane, one_axis, protection_level
from models.messages import Estimate, GnssFix, GnssVelocity, Input, Integrity, PoseFix
from models.state import E

CELLS: Final = (
    ("nothing, with GNSS", 0.0), ("GNSS pulled, fixes 0.05 Hz", 0.5), ("GNSS pulled, fixes 0.05 Hz", 3.0),
    ("GNSS pulled, fixes 0.2 Hz", 0.5), ("map shift", 5.0), ("height datum, fixes from 20 s", 19.4), ("map north", 10.0),
    ("fix frame drifts", 2.0), ("nothing, GNSS alone", 0.0),
)  # fmt: skip
SOURCES: Final = (((PoseFix,), LIMITS.fix_fault_per_hour), ((GnssFix, GnssVelocity), LIMITS.gnss_fault_per_hour))
_TITLE: Final = "With and without filters that leave a source out"
_OLDEST_S: Final = 10.0  # of the last absolute position in the filter that leaves one out; else it shows nothing
_TAIL: Final = Tail(LIMITS.core_scale, LIMITS.tail_scale, LIMITS.tail_share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flight", default="sim/rotor", help="of the stress table")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "integrity")
    args = parser.parse_args()
    rows = list[tuple[str, ...]]()
    for kind, size in CELLS:
        rows.append(line(args.flight, kind, size, args.out / "tasks"))
        print(*rows[-1], sep=" | ", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "separation.md").write_text(Table(_TITLE, COLUMNS, rows).markdown())


COLUMNS: Final = ("kind", "size", "> PL", "with", "worst e / PL", "with", "HPL <= 10 m %", "with", "cost")


def line(name: str, kind: str, size: float, tasks: Path) -> tuple[str, ...]:
    """One cell of the stress table."""
    flight = load_flight(name, KINDS[kind].aids, 0, tasks)
    messages = perturbed(flight, KINDS[kind], size, 0)
    began = time.process_time()
    estimates, levels = flown(flight, messages)
    alone_s = time.process_time() - began
    before = compared(flight, estimates, levels)
    began = time.process_time()
    for kinds, rate in SOURCES:
        if any(isinstance(m, kinds) for m in messages):
            without, _ = flown(flight, _without(messages, kinds))
            levels = [_with(level, estimates, without, rate) for level in levels]
    beside_s = time.process_time() - began
    after = compared(flight, estimates, levels)
    pairs = [(str(r.events[1]), f"{r.worst:.3g}", f"{_available(r):.1f}") for r in (before, after)]
    return kind, f"{size:g}", *(shown for pair in zip(*pairs, strict=True) for shown in pair), f"{beside_s / alone_s:.2f}"


def _without(messages: list[Input], kinds: tuple[type, ...]) -> list[Input]:
    return [m for m in messages if not isinstance(m, kinds)]


def _with(level: Integrity, estimates: dict[int, Estimate], without: dict[int, Estimate], rate: float) -> Integrity:
    """The level, raised to that of the source wrong; as it is where the other filter has no recent position."""
    ours, other = estimates.get(level.t_ns), without.get(level.t_ns)
    if ours is None or other is None or level.t_ns - other.last_absolute_ns > _OLDEST_S * 1e9:
        return level
    d, P = other.nav[:3] - ours.nav[:3], other.covariance[E.P, E.P]
    d_h, d_v = float(np.hypot(d[0], d[1])), float(abs(d[2]))
    sigma_h, sigma_v = math.sqrt(float(np.linalg.eigvalsh(P[:2, :2])[-1])), math.sqrt(float(P[2, 2]))
    prior, t2 = allowed(rate, LIMITS.correlation_s), (d_h / sigma_h) ** 2 + (d_v / sigma_v) ** 2
    p = prior / (prior + math.exp(-0.5 * t2))
    shares = [allowed(risk, LIMITS.correlation_s) for risk in RISKS]
    h = [protection_level([Mode("", p, d_h, sigma_h)], share, _TAIL, in_plane) for share in shares]
    v = [protection_level([Mode("", p, d_v, sigma_v)], share, _TAIL, one_axis) for share in shares]
    hpls, vpls = tuple(map(max, level.hpls_m, h)), tuple(map(max, level.vpls_m, v))
    return msgspec.structs.replace(level, hpls_m=hpls, vpls_m=vpls, hpl_m=max(level.hpl_m, h[1]), vpl_m=max(level.vpl_m, v[1]))


def _available(row: Row) -> float:
    return 100.0 * row.within_10_m / max(row.horizontal.compared if row.horizontal else 0, 1)


if __name__ == "__main__":
    main()
