"""The outline path on rendered views: range of convergence, accuracy, consistency, rejected decoys.

python -m benchmarks.fixes.outline --seed 1 --views 300
python -m benchmarks.fixes.outline --seed 1 --views 100 --only decoys

Views are those of single_fix (benchmarks/fixes/single_fix_views.py): 10 to 120 m high, tilted up to 25 degrees, one to three
landmarks, painted and pale, exact maps and maps off by 0.5 m, images clean, noisy, blurred, dark, bright. The pipeline gets
a prior and the map, nothing else. Where it waits for the next image to agree it gets one, half a second later; *at once* counts
the first pair alone. A fix is wrong if it is off by more than 3 m and outside its own 99.99 % ellipse. Tables go to out/outline/.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.fixes.outcome import Outcome, outcome_of
from benchmarks.fixes.outline_report import as_text
from benchmarks.fixes.outline_views import DECOYS, PRIOR_PX, decoy, draw, later, prior_of
from benchmarks.fixes.single_fix_bound import bound
from benchmarks.fixes.single_fix_views import View
from benchmarks.jobs import run_jobs
from models.maps.landmarks import LandmarkMap
from models.prior import Prior
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose.observation import ObservationConfig
from vision.pose.pose import PoseConfig, PoseEstimate, estimate_pose

OUT = Path(__file__).resolve().parents[2] / "out" / "outline"
ORIGIN = (47.3977, 8.5456, 488.0)
OFF_PX = (20.0, 40.0, 80.0, 120.0, 160.0)
NEXT_NS = 500_000_000
WIDE = PoseConfig(observation=ObservationConfig(search_px=(28, 14)))  # the default's 16 px do not reach 20
PARTS = ("converge", "accuracy", "partial", "decoys")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fixes.outline", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, default=300, help="of each part")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--resume", action="store_true", help="go on where the last run ended")
    arguments = parser.parse_args()
    if arguments.views < 1 or arguments.processes < 1:
        parser.error("--views and --processes must be at least 1")
    jobs = [(part, arguments.seed, number) for part in arguments.only for number in range(arguments.views)]
    kept = OUT / f"outcomes_{arguments.seed}.jsonl"
    done = run_jobs(jobs, run, list[Outcome], kept, processes=arguments.processes, resume=arguments.resume)
    text = as_text([outcome for outcomes in done for outcome in outcomes])
    (OUT / f"table_{arguments.seed}.txt").write_text(text + "\n")
    print(text)


def run(job: tuple[str, int, int]) -> list[Outcome]:
    """One part of one view."""
    part, seed, number = job
    return [msgspec.structs.replace(outcome, number=number) for outcome in PARTS_RUN[part](seed, number)]


def converge(seed: int, number: int) -> list[Outcome]:
    """From given distances, and the fine stage alone from 20 px."""
    shown = draw(seed, number)
    view, off = shown.view, {d: prior_of(shown.view, PRIOR_PX, d) for d in OFF_PX}
    alone = prior_of(view, PRIOR_PX, 20.0, only_shift=True)
    fit = estimate_pose(view.rig, shown.images, view.landmarks, (alone.p_n, alone.R_nb), alone, WIDE)
    fitted = outcome_of(view, fit, "") if isinstance(fit, PoseEstimate) else outcome_of(view, None, f"{fit.reason}: {fit.detail}")
    fitted = msgspec.structs.replace(fitted, name=f"fine stage alone, 20 px, map {view.cell.map_sigma_m} m")
    return [fitted] + [_fixed(f"coarse search, {d:.0f} px", view, shown.images, prior) for d, prior in off.items()]


def accuracy(seed: int, number: int) -> list[Outcome]:
    """The prior drawn about the truth."""
    shown = draw(seed, number)
    return [_fixed("accuracy", shown.view, shown.images, prior_of(shown.view, 0.5 * PRIOR_PX), with_bound=True)]


def partial(seed: int, number: int) -> list[Outcome]:
    """Outlines cut by the border or hidden by trees."""
    shown = draw(seed, number, partial=True)
    return [_fixed("partial", shown.view, shown.images, prior_of(shown.view, 0.5 * PRIOR_PX), share=shown.share)]


def decoys(seed: int, number: int) -> list[Outcome]:
    """Wrong maps and priors."""
    outcomes = []
    for kind in DECOYS:
        view, images, prior, possible = decoy(seed, number, kind)
        name = f"decoy: {kind}" + ("" if possible else " (no fix is right)")
        outcomes.append(_fixed(name, view, images, prior))
    return outcomes


PARTS_RUN = {"converge": converge, "accuracy": accuracy, "partial": partial, "decoys": decoys}


def _fixed(
    name: str, view: View, images: tuple[Image, Image], prior: Prior, share: float = 1.0, *, with_bound: bool = False
) -> Outcome:
    """The pipeline's answer, to one pair or to two."""
    pipeline = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), PipelineConfig(path="predict"))
    result = pipeline.process(*images, 1, prior)
    at_once = result.report.outcome != "waiting"
    if not at_once:
        view, images, prior = later(view, prior)
        result = pipeline.process(*images, 1 + NEXT_NS, prior)
    limit = float(np.sqrt(np.trace(bound(_with_prior(view, prior))[:3, :3]))) if with_bound else 0.0
    said = f"{result.report.outcome}: {result.report.detail}"
    found = outcome_of(view, result.pose, said)
    return msgspec.structs.replace(found, name=name, share=share, bound_m=limit, at_once=at_once)


def _with_prior(view: View, prior: Prior) -> View:
    """The view with another prior."""
    return View(
        view.cell, view.world, view.true_rig, view.p_n, view.R_nb, view.conditions, view.rig, view.landmarks, prior, view.rng
    )


if __name__ == "__main__":
    main()
