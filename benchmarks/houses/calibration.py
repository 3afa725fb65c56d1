"""Claimed radius against error of the fixes that `python -m benchmarks.houses` has made, as a picture."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from benchmarks.houses.trials import Answer

_PATTERN = "outlines together have one position"  # of the detail of a fix by the pattern


def draw(answers: Sequence[Answer], file: Path) -> Path:
    """Left each fix; right the share inside its claimed region over the claimed share, 1 - exp(-d^2 / 2) within d sigma."""
    fixes = [a for a in answers if a.accepted and a.kind == "true" and a.squared is not None]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.4), layout="constrained")
    share = np.linspace(0.0, 1.0, 101)
    for label, pattern, colour in (("edge by edge", False, "tab:blue"), ("all outlines together", True, "tab:orange")):
        some = [a for a in fixes if (_PATTERN in a.detail) == pattern]
        if not some:
            continue
        claims, errors = np.array([a.radius_m for a in some], float), np.array([a.error_m for a in some], float)
        squared = np.array([a.squared for a in some], float)
        left.scatter(claims, errors, s=14, c=colour, alpha=0.6, lw=0, label=f"{label} ({len(some)} fixes)")
        inside = [np.mean(squared <= -2.0 * math.log(max(1.0 - p, 1e-12))) for p in share]
        right.plot(share, inside, c=colour, label=f"{label}: NEES / 2 = {squared.mean() / 2.0:.2f}")
    left.plot((0.3, 40.0), (0.3, 40.0), "k-", lw=1.0)
    left.set(xscale="log", yscale="log", xlim=(1.0, 40.0), ylim=(0.1, 40.0), title="Each fix; the line: error = claim")
    left.set(xlabel="claimed 95 % radius [m]", ylabel="horizontal error [m]")
    right.plot((0.0, 1.0), (0.0, 1.0), "k-", lw=1.0)
    right.set(xlabel="claimed share", ylabel="share of fixes inside", title="Fixes inside their claimed regions")
    right.set(xlim=(0.0, 1.0), ylim=(0.0, 1.01))
    right.text(0.5, 0.25, "below the line: claims too small", fontsize=9)
    for axes in (left, right):
        axes.legend(fontsize=8, loc="lower right" if axes is right else "upper left")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file
