"""From the outcomes of the outline path to a table."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from benchmarks.fixes.outcome import BAND, Outcome

SHARES = (0.0, 0.3, 0.5, 0.7, 1.01)
GATE = 27.86 / 6.0  # 99.99 % of 6: a fix outside its own ellipse did not converge where it says


def cells(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, list[Outcome]]]:
    """What is compared: each part, and of accuracy and partial views their cells."""
    for part in dict.fromkeys(o.name for o in outcomes):
        some = [o for o in outcomes if o.name == part]
        if part == "accuracy":
            for marks in (1, 2, 3):
                for sharp in (True, False):
                    name = f"{marks} landmark{'s'[: marks - 1]}, {'sharp' if sharp else 'blurred'}"
                    yield name, [o for o in some if o.marks == marks and (o.take != "blurred") == sharp]
            for roof in ("painted", "pale"):
                for sigma in (0.0, 0.5):
                    yield f"{roof}, map {sigma} m", [o for o in some if (o.roof, o.map_sigma_m) == (roof, sigma)]
        if part == "partial":
            for low, high in pairwise(SHARES):
                yield f"{low:.0%} to {min(high, 1.0):.0%} visible", [o for o in some if low <= o.share < high]
        yield part, some


def as_text(outcomes: Sequence[Outcome]) -> str:
    """The table for a person; a star marks what is out of the band."""
    lines = [
        f"{'':36} {'views':>6} {'fixes':>7} {'at once':>7} {'right':>7} {'wrong':>6} {'RMS m':>7} {'/bound':>7}"
        f" {'d2/3':>7} {'d2/6':>7} {'alone':>7}"
    ]
    for name, some in cells(outcomes):
        fixes = [o for o in some if not o.reason]
        once = [o for o in fixes if o.at_once]
        right = [o for o in fixes if o.position * 3.0 < GATE * 6.0]
        parts = " ".join(_part(those, some) for those in (fixes, once, right))
        line = f"{name:36} {len(some):6} {parts} {sum(o.wrong for o in fixes):6}"
        if fixes:
            rms = float(np.sqrt(np.mean([o.error_m**2 for o in fixes])))
            bounded = [(o.error_m / o.bound_m) ** 2 for o in fixes if o.bound_m > 0.0]
            ratio = f"{np.sqrt(np.mean(bounded)):7.2f}" if bounded else f"{'':7}"
            means = [float(np.mean([getattr(o, what) for o in fixes])) for what in ("position", "pose", "alone")]
            line += f" {rms:7.3f} {ratio} " + " ".join(f"{m:6.2f}{' ' if BAND[0] <= m <= BAND[1] else '*'}" for m in means)
        lines.append(line)
    reasons = Counter((o.name, o.reason.split(":")[0]) for o in outcomes if o.reason)
    lines += [f"  no fix, {part}: {reason} {count}" for (part, reason), count in sorted(reasons.items())]
    return "\n".join(lines)


def _part(some: Sequence[Outcome], of: Sequence[Outcome]) -> str:
    return f"{len(some) / len(of):7.1%}" if of else f"{'-':>7}"
