"""Rendered pairs of villages, grids and look-alikes through the whole pipeline; 30 % not in the map, 10 % of it gone, map errors
0.3 m. Wrong identity: a landmark of the fix that is not where the image shows its region.
"""

import math
from typing import Final

import msgspec
import numpy as np

from benchmarks.identification.batch import Batch, Case, Job, case_of, counted
from benchmarks.identification.worlds import GONE, HEIGHT_SIGMA_M, MAP_SIGMA_M, OUTLINE_SIGMA_M, UNMAPPED, draw_prior
from models import so3
from models.messages import Array
from vision.image.rectify import rectification
from vision.pipeline import LandmarkPipeline, Result
from vision.records.reports import RegionReport
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import Layout, Scene, WorldSpec, make_world

PAIRS: Final = 24  # of one world
LAYOUTS: Final = ("lookalikes", "village", "grid")
_SLACK_PX: Final = 5.0


def show(job: Job) -> Batch:
    """Some worlds."""
    _, layout, prior_m, count, seed, _ = job
    fixes = list[Case]()
    for first in range(0, count, PAIRS):
        scene = scene_of(layout, prior_m, seed, first)
        for number in range(first, min(first + PAIRS, count)):
            p_n, q_nb, result = pair(scene, prior_m, seed, number)
            if result.fix is not None and result.pose is not None:
                named = [r for r in result.regions if r.state == "identified"]
                wrong = tuple(f"{r.landmark} by {r.path}" for r in named if not _is_there(scene, r, p_n, so3.matrix(q_nb)))
                error, covariance = p_n - result.pose.joint_p_n, result.pose.joint_covariance[:3, :3]
                fixes.append(case_of(number, error, covariance, len(named), wrong))
    return counted(job, fixes)


def scene_of(layout: str, prior_m: float, seed: int, first: int) -> Scene:
    """The world of the pairs from `first` on."""
    spec = WorldSpec(
        msgspec.convert(layout, Layout), area_m=280.0, painted=1.0, unmapped=UNMAPPED, gone=GONE,
        sigma_m=MAP_SIGMA_M, height_sigma_m=HEIGHT_SIGMA_M, outline_sigma_m=OUTLINE_SIGMA_M,
    )  # fmt: skip
    return make_world(int(np.random.default_rng([seed, int(prior_m), first, 2]).integers(1 << 31)), spec)


def pair(scene: Scene, prior_m: float, seed: int, number: int) -> tuple[Array, Array, Result]:
    """Rendered and recognised: true position, attitude, result. Of its own random numbers."""
    rng = np.random.default_rng([seed, int(prior_m), number, 3])
    p_n = np.array([*rng.uniform(-60.0, 60.0, 2), -rng.uniform(50.0, 90.0)])
    roll, pitch = rng.normal(0.0, math.radians(4.0), 2)
    q_nb = so3.from_euler(roll, pitch, rng.uniform(-math.pi, math.pi))
    left, right = render_pair(scene.world, scene.rig, p_n, so3.matrix(q_nb), Conditions(), rng)
    prior, _ = draw_prior(rng, p_n, q_nb, prior_m)
    return p_n, q_nb, LandmarkPipeline(scene.rig_calibrated, scene.map).process(left, right, number, prior)


def _is_there(scene: Scene, said: RegionReport, p_n: Array, R_nb: Array) -> bool:
    """Whether region and true roof, both cut at the border, hold each other's middle, in the image of the line's path."""
    true = next((m for m in scene.world.landmarks if m.id == said.landmark), None)
    if true is None:
        return False
    rig = scene.rig if said.path == "predict" else rectification(scene.rig).rig
    roof = np.column_stack((true.outline_n, np.full(len(true.outline_n), true.roof_d)))
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    px = np.clip(rig.left.project((roof - p_nc) @ R_nc), 0.0, (rig.left.width - 1.0, rig.left.height - 1.0))
    low, high = px.min(axis=0), px.max(axis=0)
    u, v, width, height = said.bbox
    box = np.array([(u, v), (u + width, v + height)])
    return _inside((low + high) / 2.0, *box) and _inside(box.mean(axis=0), low, high)


def _inside(point: Array, low: Array, high: Array) -> bool:
    return bool((point >= low - _SLACK_PX).all() and (point <= high + _SLACK_PX).all())
