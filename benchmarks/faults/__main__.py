"""Faults of the optional sensors, simulated: what each costs, whether the estimate is overconfident, and what is reported.

python -m benchmarks.faults [--only drag rest] [--seeds 1 2 3] [--jobs 2] [-o FOLDER]
"""

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from benchmarks.faults import runs
from benchmarks.faults.cases import CASES
from benchmarks.faults.runs import Score
from benchmarks.tables import Table, number

_COLUMNS: Final = (
    "sensor", "fault", "error with GNSS", "after the dark", "NEES/3", "overconfident", "published", "refused, and why", "health",
)  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    known = [v for v in values if not math.isnan(v)]
    return sum(known) / len(known) if known else math.nan


def row(scores: Sequence[Score]) -> tuple[str, ...]:
    """Of the seeds of one fault: means, and the largest share overconfident."""
    over = max(max(s.overconfident.values()) for s in scores)
    refused, said = Counter[str](), Counter[str]()
    for s in scores:
        refused.update(s.refused)
        said.update({text: share for text, share in s.said.items() if not text.startswith("/")})
    share = sum(refused.values()) / len(scores)
    why = ", ".join(reason for reason, n in refused.most_common(3) if n / len(scores) > 0.01)
    health = "; ".join(text for text, n in said.most_common(2))
    return (
        scores[0].sensor,
        scores[0].fault,
        f"{number(_mean([s.lit_m for s in scores]))} m",
        f"{number(_mean([s.end_m for s in scores]))} m",
        number(_mean([s.nees for s in scores])),
        f"{100.0 * over:.1f} %",
        f"{100.0 * np.mean([s.published for s in scores]):.0f} %",
        f"{100.0 * share:.0f} % {why}".strip(),
        health,
    )


def main() -> None:
    """The table, on the terminal and in a file; a line as each run ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="sensors; default: all")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3], help="runs of each fault")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/faults"), help="folder of the results")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    jobs = [(sensor, fault, seed) for sensor in given.only for fault in CASES[sensor] for seed in given.seeds]
    scores = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for score in pool.map(runs.run, jobs):
            scores.append(score)
            worst = max(score.overconfident, key=score.overconfident.__getitem__)
            print(
                f"{score.sensor}, {score.fault}, {score.seed}: {number(score.lit_m)} m, {number(score.end_m)} m, overconfident "
                f"{100.0 * score.overconfident[worst]:.1f} % ({worst}), {score.refused}",
                flush=True,
            )
    (given.out / "faults.jsonl").write_bytes(b"".join(msgspec.json.encode(s) + b"\n" for s in scores))
    rows = [row(list(group)) for _, group in groupby(scores, key=lambda s: (s.sensor, s.fault))]
    text = Table("Faults of the optional sensors", _COLUMNS, rows).markdown()
    (given.out / "faults.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
