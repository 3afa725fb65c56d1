"""Accuracy and consistency of single fixes on rendered views, against the Cramer-Rao bound.

python -m benchmarks.fixes.single_fix --seed 1 --views 2000
python -m benchmarks.fixes.single_fix --seed 1 --views 2000 --resume      (goes on where it was ended)

Every view has its own world, map errors, rig errors, pose, light and noise (benchmarks/fixes/single_fix_views.py); identities are
given, and the fit starts a few pixels off, from noisy centres and sizes of the roofs' regions. The table goes to out/single_fix/.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.fixes.outcome import Outcome, outcome_of
from benchmarks.fixes.single_fix_bound import bound
from benchmarks.fixes.single_fix_report import as_text, table
from benchmarks.fixes.single_fix_start import centroid_and_size, start_from_regions
from benchmarks.fixes.single_fix_views import View, draw_view
from benchmarks.jobs import run_jobs
from models.messages import Array
from vision.pose.pose import NoPose, estimate_pose
from vision.pose.sensitivity import eyes
from vision.synthetic.render import render_pair

OUT = Path(__file__).resolve().parents[2] / "out" / "single_fix"
REGION_PX = 1.5  # noise of the regions' centres and sizes


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fixes.single_fix", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--resume", action="store_true", help="keep the views that were done before this run was ended")
    arguments = parser.parse_args()
    if arguments.views < 1 or arguments.processes < 1:
        parser.error("--views and --processes must be at least 1")
    jobs = [(arguments.seed, number) for number in range(arguments.views)]
    kept = OUT / f"outcomes_{arguments.seed}.jsonl"
    rows = table(run_jobs(jobs, run_view, Outcome, kept, processes=arguments.processes, resume=arguments.resume))
    (OUT / f"table_{arguments.seed}.txt").write_text(as_text(rows) + "\n")
    print(as_text(rows))


def run_view(job: tuple[int, int]) -> Outcome:
    """Render one view, fit it, and compare with the truth."""
    view = draw_view(*job)
    images = render_pair(view.world, view.true_rig, view.p_n, view.R_nb, view.conditions, view.rng)
    p_n, R_nb, shift = start_from_regions(eyes(view.rig)[0], view.landmarks, *_regions(view), view.prior)
    fit = estimate_pose(view.rig, images, view.landmarks, (p_n, R_nb), view.prior, shift_m=shift)
    if isinstance(fit, NoPose):
        return msgspec.structs.replace(outcome_of(view, None, fit.reason), number=job[1])
    limit = float(np.sqrt(np.trace(bound(view)[:3, :3])))
    return msgspec.structs.replace(outcome_of(view, fit, ""), number=job[1], bound_m=limit)


def _regions(view: View) -> tuple[Array, Array]:
    """Centres (L, 2) and sizes (L,) px of the roofs in the left image, as segmentation would give them."""
    eye = eyes(view.true_rig)[0]
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    centres, sizes = [], []
    for mark in view.world.landmarks:
        roof = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        centre, size = centroid_and_size(eye.camera.project((roof - p_nk) @ R_nk))
        centres.append(centre + view.rng.normal(0.0, REGION_PX, 2))
        sizes.append(size + view.rng.normal(0.0, REGION_PX))
    return np.array(centres), np.array(sizes)


if __name__ == "__main__":
    main()
