"""As benchmarks.identification.numbers, on rendered images through the whole pipeline: `python -m
benchmarks.identification.images`.

Look-alikes (+-10 % in size, 25 m apart), villages, grids; 30 % not in the map, 10 % of it gone; map errors 0.3 m. Wrong fix: with
the prior more than 3 m off and outside its 99.99 % ellipsoid. Wrong identity: a landmark of the fix that is not there. Seeds are
pooled, with --resume earlier ones too. Writes identification_pictures.md to --out.
"""

import argparse
import itertools
import math
from collections import Counter
from pathlib import Path
from time import process_time

import cv2
import msgspec
import numpy as np
from scipy.stats import chi2

from benchmarks.identification.numbers import INSIDE_9999, OFF_M, share
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table, number
from models import so3
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import rectification
from vision.pipeline import LandmarkPipeline, Result
from vision.records.reports import RegionReport
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import Layout, Scene, WorldSpec, make_world

FRAMES_PER_WORLD = 12
PRIORS_M = (5.0, 10.0, 20.0)
ATTITUDE_SIGMA_DEG = (1.0, 1.0, 2.0)
SLACK_PX = 5.0
LAYOUTS: tuple[Layout, ...] = ("lookalikes", "village", "grid")
Job = tuple[Layout, float, bool, int, int, int]  # prior [m], one camera, seed, cell, world


class Outcome(msgspec.Struct, frozen=True):
    """One pair. regions: measured; of those that the border cuts off those of which the corners in view tell something."""

    height_m: float
    regions: int
    outcome: str
    wrong_fix: bool
    identified: int
    wrong: int
    error_m: float | None  # None: no fix
    nees: float | None  # of the fix, images alone, over 6
    seconds: float


def run_world(job: Job) -> list[Outcome]:
    """Some frames of one world."""
    layout, prior_m, one_camera, *seeds = job
    sigma = np.array([prior_m] * 3 + [math.radians(a) for a in ATTITUDE_SIGMA_DEG])
    spec = WorldSpec(
        layout, area_m=280.0, painted=1.0, unmapped=0.3, gone=0.1, sigma_m=0.3, height_sigma_m=0.2, outline_sigma_m=0.08
    )
    rng, outcomes = np.random.default_rng(seeds), list[Outcome]()
    scene = make_world(int(rng.integers(1 << 31)), spec)
    for k in range(FRAMES_PER_WORLD):
        p_n = np.array([*rng.uniform(-60.0, 60.0, 2), -rng.uniform(50.0, 90.0)])
        roll, pitch = rng.normal(0.0, math.radians(4.0), 2)
        q = so3.from_euler(roll, pitch, rng.uniform(-math.pi, math.pi))
        left, right = render_pair(scene.world, scene.rig, p_n, so3.matrix(q), Conditions(), rng)
        error = rng.normal(0.0, sigma)
        prior = Prior(p_n - error[:3], so3.multiply(so3.quat_exp(-error[3:]), q), np.diag(sigma**2))
        pipeline = LandmarkPipeline(scene.rig_calibrated, scene.map)
        begin = process_time()
        result = pipeline.process(left, None if one_camera else right, k, prior)
        outcomes.append(judge(result, scene, p_n, q, process_time() - begin))
    return outcomes


def judge(result: Result, scene: Scene, p_n: Array, q: Array, seconds: float) -> Outcome:
    named = [r for r in result.regions if r.state == "identified"] if result.fix else []
    wrong = sum(not _is_there(scene, r, p_n, so3.matrix(q)) for r in named)
    error_m, nees, wrong_fix = None, None, False
    if result.fix is not None and result.pose is not None:
        e = p_n - result.pose.joint_p_n
        error_m = float(np.linalg.norm(e))
        wrong_fix = error_m > OFF_M and float(e @ np.linalg.solve(result.pose.joint_covariance[:3, :3], e)) > INSIDE_9999
        turn = so3.quat_log(so3.multiply(q, so3.conjugate(np.array(result.fix.q_nb_wxyz))))
        d = np.concatenate([p_n - np.array(result.fix.p_n), turn])
        nees = float(d @ np.linalg.solve(result.pose.covariance + result.pose.covariance_common, d)) / 6.0
    measured = sum(r.state not in {"cut_off", "not_measured"} for r in result.regions)
    return Outcome(float(-p_n[2]), measured, result.report.outcome, wrong_fix, len(named), wrong, error_m, nees, seconds)


def _is_there(scene: Scene, said: RegionReport, p_n: Array, R_nb: Array) -> bool:
    """Whether the region's box and what the left image shows of the true landmark's roof hold each other's middle.

    Both in the image that the line's path speaks of. A roof that is not in view is nowhere.
    """
    true = next((m for m in scene.world.landmarks if m.id == said.landmark), None)
    if true is None:
        return False
    rig = scene.rig if said.path == "predict" else rectification(scene.rig).rig
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    roof = np.column_stack((true.outline_n, np.full(len(true.outline_n), true.roof_d)))
    px = np.clip(rig.left.project((roof - p_nc) @ R_nc), 0.0, (rig.left.width - 1.0, rig.left.height - 1.0))
    low, high = px.min(axis=0), px.max(axis=0)
    u, v, width, height = said.bbox
    box = np.array([(u, v), (u + width, v + height)])
    in_view = bool((high > low).all())  # clipped, a roof outside has no width or no height
    return in_view and _inside((low + high) / 2.0, *box) and _inside(box.mean(axis=0), low, high)


def _inside(point: Array, low: Array, high: Array) -> bool:
    return bool((point >= low - SLACK_PX).all() and (point <= high + SLACK_PX).all())


def row(name: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    several = [o for o in outcomes if o.regions >= 3]
    fixed = [o for o in outcomes if o.error_m is not None and o.nees is not None]
    return (
        name, str(len(outcomes)), share(len(fixed), len(outcomes)),
        f"{share(sum(o.outcome == 'fixed' for o in several), len(several))} of {len(several)}",
        str(sum(o.wrong_fix for o in outcomes)), str(sum(o.identified for o in outcomes)), str(sum(o.wrong for o in outcomes)),
        number(float(np.median([o.error_m or 0.0 for o in fixed])) if fixed else None),
        number(float(np.mean([o.nees or 0.0 for o in fixed])) if fixed else None),
        number(1e3 * float(np.median([o.seconds for o in outcomes]))),
    )  # fmt: skip


COLUMNS = (
    "world", "pairs", "fixed", "with 3 regions or more", "wrong fixes", "identified", "wrong", "median error m", "NEES/6", "ms",
)  # fmt: skip
Cells = dict[tuple[Layout, float], list[Outcome]]


def at_most(events: int, trials: int) -> str:
    """Upper end of the 95 % interval of a rate of rare events (Poisson): chi2_0.95(2 k + 2) / 2 n."""
    return f"{50.0 * chi2.ppf(0.95, 2 * events + 2) / max(trials, 1):.2g} %"


def report(cells: Cells, cameras: str) -> str:
    """All tables."""
    everything = [o for outcomes in cells.values() for o in outcomes]
    rows = [row(f"{layout}, prior {prior_m:.0f} m", outcomes) for (layout, prior_m), outcomes in cells.items()]
    table = Table(f"Rendered {cameras} through the pipeline", COLUMNS, [*rows, row("all", everything)])
    fixes, wrong_fixes = sum(o.outcome == "fixed" for o in everything), sum(o.wrong_fix for o in everything)
    named, wrong = sum(o.identified for o in everything), sum(o.wrong for o in everything)
    return "\n".join([
        table.markdown(),
        f"wrong fixes: {wrong_fixes} of {fixes} accepted, with 95 % at most {at_most(wrong_fixes, fixes)}; "
        f"wrong identities: {wrong} of {named}, at most {at_most(wrong, named)}",
        "outcomes: " + ", ".join(f"{name} {n}" for name, n in Counter(o.outcome for o in everything).most_common()) + "\n",
    ])  # fmt: skip


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, nargs="+", default=[0], help="one or more, pooled")
    parser.add_argument(
        "--frames", type=int, default=60, help=f"pairs per layout, prior and seed, {FRAMES_PER_WORLD} of each world"
    )
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--resume", action="store_true", help="keep the worlds that were done before, of any seed")
    parser.add_argument("--one-camera", action="store_true", help="the left images alone")
    parser.add_argument("--out", type=Path, default=Path("out/identification"))
    args = parser.parse_args()
    names, worlds = list(itertools.product(LAYOUTS, PRIORS_M)), math.ceil(args.frames / FRAMES_PER_WORLD)
    cells: Cells = {name: [] for name in names}
    jobs: list[Job] = [
        (*name, args.one_camera, seed, k, world) for seed in args.seed for world in range(worlds) for k, name in enumerate(names)
    ]
    which = "_left" if args.one_camera else ""
    kept = args.out / f"outcomes{which}.jsonl"
    done = run_jobs(jobs, run_world, list[Outcome], kept, processes=args.processes, resume=args.resume)
    for (layout, prior_m, *_), outcomes in zip(jobs, done, strict=True):
        cells[layout, prior_m] += outcomes
    text = report(cells, "left images alone" if args.one_camera else "stereo pairs")
    print(text)
    (args.out / f"identification_pictures{which}.md").write_text(text)


if __name__ == "__main__":
    main()
