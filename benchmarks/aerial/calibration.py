"""How large the claims are beside the errors: `python -m benchmarks.aerial.calibration [SET ...] [--seed N ...]`.

Fixes as in flight, and by the peak alone, of `benchmarks.aerial.registration`'s sets without decoys: errors along the axes of the
claimed covariance over their sigmas, of the ground in the image's middle. Errors of map and mounting are drawn
(registration_sets.py).
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.aerial.registration import OUT, SETS, Outcome, Way, fly
from benchmarks.aerial.registration_sets import flights
from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number

WAYS: tuple[Way, ...] = ("as in flight", "peak")
_WITHIN_95 = 5.991  # chi-square of 2


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.aerial.calibration", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", choices=[[], *SETS], help="all by default")
    parser.add_argument("--seed", type=int, nargs="*", default=[0])
    args = parser.parse_args()
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    for seed in args.seed:
        for name in args.sets or SETS:
            kept = OUT / f"calibration_{name}_{seed}.msgpack"
            if not kept.is_file():
                those = [f for f in flights(name, data_folder(), seed, OUT / "maps") if not f.decoy]
                done = [o for f in track(those, f"{name} {seed}", console=Console(stderr=True)) for o in fly(f, WAYS)]
                kept.write_bytes(msgspec.msgpack.encode(done))
            outcomes += msgspec.msgpack.decode(kept.read_bytes(), type=list[Outcome])
    sys.stdout.write(table(outcomes).markdown() + f"\n{draw(outcomes, OUT / 'calibration.png')}\n")


def table(outcomes: Sequence[Outcome]) -> Table:
    """Rows of sets and ways, then all."""
    rows = []
    for way in WAYS:
        groups = dict.fromkeys(o.group for o in outcomes)
        real = [g for g in groups if not g.startswith("rendered")]
        for name, members in [*((g, [g]) for g in groups), ("real sets", real), ("all", list(groups))]:
            every = [o for o in outcomes if o.way == way and o.group in members]
            fixes = [o for o in every if o.accepted]
            if not fixes:
                continue
            errors, claims = np.array([o.error_m for o in fixes]), np.array([o.claim_m for o in fixes])
            nees = float(np.mean([o.squared for o in fixes]))
            inside = np.mean([2.0 * o.squared < _WITHIN_95 for o in fixes])
            rows.append((
                name, way, f"{len(fixes)} of {len(every)}", number(float(np.median(errors))), number(float(errors.max())),
                number(float(np.median(claims))), number(nees), f"{inside:.1%}",
            ))  # fmt: skip
    columns = ("set", "by", "accepted", "median m", "worst m", "claimed 95 % radius m", "NEES / 2", "within the claimed 95 %")
    return Table("Claims", columns, rows)


def draw(outcomes: Sequence[Outcome], file: Path) -> Path:
    """Left: each fix, error over claim. Right: the share of fixes inside each claimed region, a diagonal where it is right."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.8), layout="constrained")
    fixes = [o for o in outcomes if o.accepted]
    sources = {"NUST video": "NUST", "Brighton photos": "Brighton", "rendered villages": "rendered"}
    for (label, start), colour in zip(sources.items(), ("tab:blue", "tab:green", "tab:orange"), strict=True):
        for way, marker in zip(WAYS, ("o", "^"), strict=True):
            of = [o for o in fixes if o.group.startswith(start) and o.way == way]
            if of:
                claims, errors = [o.claim_m for o in of], [o.error_m for o in of]
                left.scatter(claims, errors, s=12, c=colour, marker=marker, alpha=0.5, lw=0, label=f"{label}, {way} ({len(of)})")
    low, high = 0.1, 12.0
    left.plot((low, high), (low, high), "k-", lw=1.0)
    left.text(2.0, 2.3, "error = claim", rotation=34, rotation_mode="anchor", fontsize=9, ha="center", va="bottom")
    left.set(xscale="log", yscale="log", xlim=(low, high), ylim=(0.01, high))
    left.set(xlabel="claimed 95 % radius on the ground [m]", ylabel="error on the ground [m]", title="Each fix")
    left.legend(fontsize=8, loc="lower right")
    share = np.linspace(0.0, 1.0, 101)
    for way, style in zip(WAYS, ("-", "--"), strict=True):
        for label, starts in (("real", ("NUST", "Brighton")), ("rendered", ("rendered",))):
            squared = np.array([2.0 * o.squared for o in fixes if o.way == way and o.group.startswith(starts)])
            if len(squared):
                inside = [np.mean(squared <= -2.0 * math.log(max(1.0 - p, 1e-12))) for p in share]
                right.plot(share, inside, style, label=f"{label}, {way}: NEES / 2 = {squared.mean() / 2.0:.2f}")
    right.plot((0.0, 1.0), (0.0, 1.0), "k-", lw=1.0)
    right.text(0.62, 0.52, "claims too small", fontsize=9)
    right.text(0.05, 0.75, "claims too large", fontsize=9)
    right.set(
        xlabel="claimed share",
        ylabel="share of fixes inside",
        title="Fixes inside their claimed regions",
        xlim=(0, 1),
        ylim=(0, 1.01),
    )
    right.legend(fontsize=8, loc="lower right")
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file


if __name__ == "__main__":
    main()
