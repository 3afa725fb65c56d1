"""Accuracy and honesty of single fixes on rendered views, against the Cramer-Rao bound.

python -m benchmarks.single_fix --seed 1 --views 2000

Every view has its own world, map errors, rig errors, pose, light and noise (benchmarks/single_fix_views.py); identities are given,
and the fit starts from noisy centres and sizes of the regions, as the pipeline has them.
"""

import argparse
import json
import multiprocessing
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from rich.progress import track

from benchmarks.single_fix_bound import bound
from benchmarks.single_fix_views import TAKES, View, draw_view
from models import so3
from models.messages import Array
from vision.pose import NoPose, estimate_pose
from vision.sensitivity import eyes
from vision.start import centroid_and_size, start_from_regions
from vision.synthetic.render import render_pair

OUT = Path(__file__).resolve().parents[1] / "out" / "single_fix"
REGION_PX = 1.5  # noise of the regions' centres and sizes
WRONG_M, WRONG_CHI2 = 3.0, 21.11  # a wrong fix is off by more than 3 m and outside its own 99.99 % ellipse (3 degrees of freedom)


class Outcome(msgspec.Struct, frozen=True):
    """One view and its fix: errors of prior and pictures together (posterior), and of the pictures alone (fix)."""

    number: int
    height_m: float
    tilt_deg: float
    marks: int
    roof: str
    map_sigma_m: float
    take: str
    reason: str  # empty: a fix
    error_m: float = 0.0
    bound_m: float = 0.0
    position: float = 0.0  # squared Mahalanobis distance / 3
    pose: float = 0.0  # / 6
    alone: float = 0.0  # / 6, of the pictures alone
    prior_m: float = 0.0
    wrong: bool = False


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.single_fix", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    arguments = parser.parse_args()
    jobs = [(arguments.seed, number) for number in range(arguments.views)]
    with multiprocessing.get_context("spawn").Pool(arguments.processes, _one_thread) as pool:
        work = pool.imap_unordered(run_view, jobs, chunksize=8)
        outcomes = sorted(track(work, total=len(jobs), description="views"), key=lambda o: o.number)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / f"outcomes_{arguments.seed}.json").write_bytes(msgspec.json.encode(outcomes))
    rows = table(outcomes)
    if arguments.json:
        print(json.dumps(rows, indent=1))
    else:
        print(as_text(rows))


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def run_view(job: tuple[int, int]) -> Outcome:
    """Render one view, fit it, and compare with the truth."""
    view = draw_view(*job)
    cell = view.cell
    what = (job[1], cell.height_m, cell.tilt_deg, cell.marks, cell.roof, cell.map_sigma_m, cell.take)
    pictures = render_pair(view.world, view.true_rig, view.p_n, view.R_nb, view.conditions, view.rng)
    centres, sizes = _regions(view)
    p_n, R_nb, shift = start_from_regions(eyes(view.rig)[0], view.landmarks, centres, sizes, view.prior)
    fit = estimate_pose(view.rig, pictures, view.landmarks, (p_n, R_nb), view.prior, shift_m=shift)
    if isinstance(fit, NoPose):
        return Outcome(*what, fit.reason)
    joint, alone = _error(view, fit.joint_p_n, fit.joint_R_nb), _error(view, fit.p_n, fit.R_nb)
    total = fit.covariance + fit.covariance_common
    position = _mahalanobis(joint[:3], fit.joint_covariance[:3, :3])
    error = float(np.linalg.norm(joint[:3]))
    return Outcome(
        *what, "", error, float(np.sqrt(np.trace(bound(view)[:3, :3]))), position / 3.0,
        _mahalanobis(joint, fit.joint_covariance) / 6.0, _mahalanobis(alone, total) / 6.0,
        float(np.linalg.norm(view.prior.p_n - view.p_n)), error > WRONG_M and position > WRONG_CHI2,
    )  # fmt: skip


def _regions(view: View) -> tuple[Array, Array]:
    """Centres and sizes of the roofs in the left picture, as segmentation would give them."""
    eye = eyes(view.true_rig)[0]
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    centres, sizes = [], []
    for mark in view.world.landmarks:
        roof = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        centre, size = centroid_and_size(eye.camera.project((roof - p_nk) @ R_nk))
        centres.append(centre + view.rng.normal(0.0, REGION_PX, 2))
        sizes.append(size + view.rng.normal(0.0, REGION_PX))
    return np.array(centres), np.array(sizes)


def _error(view: View, p_n: Array, R_nb: Array) -> Array:
    return np.concatenate((view.p_n - p_n, so3.quat_log(so3.from_matrix(view.R_nb @ R_nb.T))))


def _mahalanobis(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def table(outcomes: list[Outcome]) -> list[dict[str, object]]:
    """One row per cell: two-way cells first, then everything."""
    heights = [(10, 20), (20, 40), (40, 80), (80, 121)]
    tilts = [(0, 5), (5, 12), (12, 18), (18, 25.1)]
    splits: list[tuple[str, Callable[[Outcome], bool]]] = []
    for low, high in heights:
        for marks in (1, 2, 3):
            splits.append(
                (f"{low:3}-{high:3} m, {marks} landmarks", lambda o, a=low, b=high, m=marks: a <= o.height_m < b and o.marks == m)
            )
    for low, high in tilts:
        for roof in ("painted", "pale"):
            splits.append(
                (f"{low:2}-{high:2.0f} deg, {roof}", lambda o, a=low, b=high, r=roof: a <= o.tilt_deg < b and o.roof == r)
            )
    for sigma in (0.0, 0.5):
        for take in TAKES:
            splits.append((f"map {sigma} m, {take}", lambda o, s=sigma, t=take: o.map_sigma_m == s and o.take == t))
    for sigma in (0.0, 0.5):
        for marks in (1, 2, 3):
            splits.append((f"map {sigma} m, {marks} landmarks", lambda o, s=sigma, m=marks: o.map_sigma_m == s and o.marks == m))
    splits.append(("all", lambda o: True))
    return [_row(name, [o for o in outcomes if test(o)]) for name, test in splits]


def _row(name: str, some: list[Outcome]) -> dict[str, object]:
    fixes = [o for o in some if not o.reason]
    if not fixes:
        return {"cell": name, "views": len(some), "accepted": 0.0}
    ratio = np.array([o.error_m / o.bound_m for o in fixes])
    return {
        "cell": name,
        "views": len(some),
        "accepted": len(fixes) / len(some),
        "rms_m": float(np.sqrt(np.mean([o.error_m**2 for o in fixes]))),
        "rms_over_bound": float(np.sqrt(np.mean(ratio**2))),
        "position_d2_over_3": float(np.mean([o.position for o in fixes])),
        "pose_d2_over_6": float(np.mean([o.pose for o in fixes])),
        "alone_d2_over_6": float(np.mean([o.alone for o in fixes])),
        "wrong": sum(o.wrong for o in fixes),
    }


def as_text(rows: list[dict[str, object]]) -> str:
    """The table for a person."""
    lines = [
        f"{'cell':26} {'views':>6} {'fixes':>6} {'RMS m':>7} {'/bound':>7} {'d2/3':>6} {'d2/6':>6} {'alone':>6} {'wrong':>5}"
    ]
    for row in rows:
        if "rms_m" not in row:
            lines.append(f"{row['cell']:26} {row['views']:6}   none")
            continue
        lines.append(
            f"{row['cell']:26} {row['views']:6} {row['accepted']:6.1%} {row['rms_m']:7.3f} {row['rms_over_bound']:7.2f} "
            f"{row['position_d2_over_3']:6.2f} {row['pose_d2_over_6']:6.2f} {row['alone_d2_over_6']:6.2f} {row['wrong']:5}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
