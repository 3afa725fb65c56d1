"""Rendered flights over landmarks that the image's border cuts off: with fixes in part, without them, and taken for whole.

python -m benchmarks.flights.visibility --seeds 1 2 3

The same multirotor flies at 40 m over the same kind of village with images of three sizes from the middle of one lens: of the
landmark that is seen best nearly all, about half, or about a fifth of the outline is in view. From 14 s on the camera alone aids
the IMU. Each flight is drawn once and flown in closed loop (predict and verify, from the filter's own prior) in four modes:

    in part     as it is: fixes are reported and fused along the directions that were measured
    whole only  fixes of fewer than six directions are thrown away
    inflated    such fixes are reported as a pose, with large variances where nothing was measured
    none        no fixes, the IMU alone

Table to the screen and to out/visibility/.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track

from estimator.config import parse
from estimator.frontend.requests import prior_at
from estimator.fusion import Fusion
from estimator.replay import flight_images
from logs.wire.images import decode_image
from models.messages import AidStatus, Array, Estimate, LandmarkFix, Reason
from models.prior import Prior
from models.sim.scenario import EPOCH_NS, Simulation, Truth, simulate
from models.sim.scenario_file import loads
from models.state import NavState, local
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose import information
from vision.pose.sensitivity import eyes

OUT = Path(__file__).resolve().parents[2] / "out" / "visibility"
SIZE_PX = {"100 %": (640, 480), "50 %": (256, 192), "20 %": (144, 108)}
MODES = ("in part", "whole only", "inflated", "none")
CAMERA_S, JUDGED_S, END_S = 12.0, 16.0, 34.0
SCENARIO = """
duration_s = 34.0
origin = [47.3977, 8.5456, 488.0]
[vehicle]
kind = "multirotor"
speed_m_s = 4.0
area_m = 100.0
climb_m_s = 5.0
height_m = 40.0
[imu]
grade = "flight_controller"
rate_hz = 100.0
[gnss]
rate_hz = 5.0
outages_s = [[14.0, 34.0]]
[pose_fix]
rate_hz = 2.0
outages_s = [[14.0, 34.0]]
[cameras]
rate_hz = 2.0
width = {width}
height = {height}
exposure_s = 0.001
outages_s = [[0.0, 12.0]]
[cameras.world]
layout = "village"
area_m = 220.0
spacing_m = 16.0
painted = 0.7
unmapped = 0.0
gone = 0.0
sigma_m = 0.2
height_sigma_m = 0.2
seed = {seed}
"""


class Frames(msgspec.Struct, frozen=True):
    """What became of the images after JUDGED_S, and of the estimates then, of one flight in one mode."""

    images: int
    visible: float  # mean share of outline in view of the landmark seen best
    fixes: int
    partial: int  # of these with fewer than six directions
    fused: int
    error2: tuple[float, ...]  # squared distance of the position, ten times a second
    nees: tuple[float, ...]  # of position, over 3
    attitude: tuple[float, ...]  # the same of the attitude


@dataclass
class Shots:
    """Images of one flight, drawn once; visible: share of outline in view of the landmark seen best, of each."""

    flight: flight_images.Flight
    pairs: list[tuple[Image, Image]] = field(default_factory=list)
    visible: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, flight: flight_images.Flight) -> "Shots":
        """Draw them."""
        shots = cls(flight)
        for k, t_ns in enumerate(flight.t_ns.tolist()):
            left, right = (decode_image(message.schema, message.data) for message in flight.draw(k))
            shots.pairs.append((left, right))
            shots.visible.append(_visible(flight, t_ns))
        return shots


def _visible(flight: flight_images.Flight, t_ns: int) -> float:
    """Largest share of a roof's outline that the left image shows."""
    truth, scene = flight.truth, flight.scene
    k = int(np.clip(np.searchsorted(truth.t_ns, t_ns), 0, len(truth.t_ns) - 1))
    eye, best = eyes(scene.rig)[0], 0.0
    p_nk, R_nk = eye.pose(truth.p_n[k], truth.R_nb[k])
    for mark in scene.map.near(float(p_nk[0]), float(p_nk[1]), 60.0):
        ends = np.vstack((mark.outline_n, mark.outline_n[:1]))
        points = np.concatenate([np.linspace(a, b, 25, endpoint=False) for a, b in pairwise(ends)])
        x_c = (np.column_stack((points, np.full(len(points), mark.roof_d))) - p_nk) @ R_nk
        step = np.repeat(np.linalg.norm(np.diff(ends, axis=0), axis=1) / 25.0, 25)
        best = max(best, float(step[eye.camera.contains(eye.camera.project(x_c))].sum() / step.sum()))
    return best


def fly(simulation: Simulation, shots: Shots, mode: str) -> Frames:
    """Messages and images in order of arrival, each look from the filter's own prior."""
    fusion = Fusion(parse(simulation.config_toml).fusion())
    flight = shots.flight
    pipeline = LandmarkPipeline(flight.scene.rig_calibrated, flight.scene.map, PipelineConfig(path="predict"))
    delay_ns = round(flight.cameras.delay_s * 1e9)
    due = list(flight.t_ns + delay_ns)
    estimates: list[Estimate] = []
    fixes: list[LandmarkFix] = []
    last: dict[int, Reason] = {}
    for message in simulation.messages:
        while due and due[0] <= message.arrived_ns:
            k = len(flight.t_ns) - len(due)
            arrived_ns = int(due.pop(0))
            near = min(estimates[-200:], key=lambda e: abs(e.t_ns - int(flight.t_ns[k])), default=None)
            if near is None or mode == "none":
                continue
            fix = _look(pipeline, shots.pairs[k], int(flight.t_ns[k]), near, mode)
            if fix is not None:
                fixes.append(fix)
                outputs = fusion.handle(msgspec.structs.replace(fix, arrived_ns=arrived_ns))
                last |= {o.t_ns: o.reason for o in outputs if isinstance(o, AidStatus) and o.topic == fix.topic}
        outputs = fusion.handle(message)
        estimates += [o for o in outputs if isinstance(o, Estimate)]
        last |= {o.t_ns: o.reason for o in outputs if isinstance(o, AidStatus) and o.topic == "/landfix/fix"}
    begin_ns = EPOCH_NS + round(JUDGED_S * 1e9)
    judged = [t for t in flight.t_ns.tolist() if t > begin_ns]
    fixes = [f for f in fixes if f.t_ns > begin_ns]
    errors = list(_errors([e for e in estimates if e.t_ns > begin_ns][::10], simulation.truth))
    return Frames(
        len(judged), float(np.mean(shots.visible[-len(judged) :])), len(fixes), sum(_in_part(f) for f in fixes),
        sum(last.get(f.t_ns) is Reason.FUSED for f in fixes), *(tuple(column) for column in zip(*errors, strict=True)),
    )  # fmt: skip


def _look(pipeline: LandmarkPipeline, pair: tuple[Image, Image], t_ns: int, near: Estimate, mode: str) -> LandmarkFix | None:
    p_n, q, covariance = prior_at(near, t_ns)
    straight = information._STRAIGHT_SHARE
    information._STRAIGHT_SHARE = -1.0 if mode == "inflated" else straight
    try:
        fix = pipeline.process(*pair, t_ns, Prior(p_n, q, covariance)).fix
    finally:
        information._STRAIGHT_SHARE = straight
    return None if fix is not None and _in_part(fix) and mode == "whole only" else fix


def _in_part(fix: LandmarkFix) -> bool:
    return fix.directions is not None and len(fix.directions) < 6


def _errors(estimates: list[Estimate], truth: Truth) -> Iterator[tuple[float, float, float]]:
    """Squared distance, NEES/3 of position and of attitude."""
    for e in estimates:
        k = int(np.searchsorted(truth.t_ns, e.t_ns))
        if k == len(truth.t_ns) or truth.t_ns[k] != e.t_ns:
            continue
        true = NavState(truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], truth.gyro_bias[k], truth.accel_bias[k]).pack()
        d = local(e.nav, true)
        yield float(d[:3] @ d[:3]), _nees(d[:3], e.covariance[:3, :3]), _nees(d[6:9], e.covariance[6:9, 6:9])


def _nees(d: Array, cov: Array) -> float:
    return float(d @ np.linalg.solve(cov, d)) / len(d)


def table(results: dict[tuple[str, str], list[Frames]]) -> str:
    """One line per visibility and mode, over all seeds."""
    lines = [
        f"{'lens for':9} {'mode':11} {'in view':>8} {'images':>9} {'fixes':>7} {'in part':>8} {'fused':>7} "
        f"{'RMS m':>7} {'p95 m':>7} {'NEES/3':>7} {'att':>6}"
    ]
    for (share, mode), flights in results.items():
        images = sum(f.images for f in flights)
        fixes, partial, fused = (sum(getattr(f, what) for f in flights) for what in ("fixes", "partial", "fused"))
        error2, nees, attitude = (np.concatenate([getattr(f, what) for f in flights]) for what in ("error2", "nees", "attitude"))
        lines.append(
            f"{share:9} {mode:11} {np.mean([f.visible for f in flights]):8.0%} {images:9} {fixes / images:7.0%} "
            f"{partial / images:8.0%} {fused / images:7.0%} {np.sqrt(error2.mean()):7.2f} "
            f"{np.sqrt(np.quantile(error2, 0.95)):7.2f} {nees.mean():7.2f} {attitude.mean():6.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.flights.visibility", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--visible", choices=SIZE_PX, nargs="+", default=list(SIZE_PX))
    parser.add_argument("--modes", choices=MODES, nargs="+", default=list(MODES))
    parser.add_argument("--json", action="store_true", help="print every flight as JSON")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[tuple[str, str], list[Frames]] = {(share, mode): [] for share in arguments.visible for mode in arguments.modes}
    jobs = [(share, seed) for share in arguments.visible for seed in arguments.seeds]
    for share, seed in track(jobs, description="flights", console=Console(stderr=True)):
        width, height = SIZE_PX[share]
        plan = loads(SCENARIO.format(width=width, height=height, seed=seed))
        simulation = simulate(plan, seed)
        assert plan.cameras is not None
        shots = Shots.of(flight_images.plan(plan.cameras, simulation, seed))
        for mode in arguments.modes:
            results[share, mode].append(fly(simulation, shots, mode))
    text = table(results)
    OUT.mkdir(parents=True, exist_ok=True)
    raw = msgspec.json.encode({f"{share} {mode}": flights for (share, mode), flights in results.items()})
    (OUT / "flights.json").write_bytes(raw)
    (OUT / "table.txt").write_text(text + "\n")
    sys.stdout.write((raw.decode() if arguments.json else text) + "\n")


if __name__ == "__main__":
    main()
