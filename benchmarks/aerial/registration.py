"""Position from maps that hold an image: `python -m benchmarks.aerial.registration [nust] [brighton] [rendered]`.

All as in flight, with learned matching and without, and one by one: SIFT + FLANN, the search's peak without its checks, learned
matching. Judged: the ground in the image's middle, by fix and prior; a fix of one direction along that alone. Wrong maps:
benchmarks.aerial.decoys. Output: out/registration/.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import cv2
import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.aerial.registration_sets import Flight, Shot, flights, learned_models
from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number
from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import Array
from vision.ground.features import FeatureConfig, Recognised, recognise
from vision.ground.image import GroundImage
from vision.ground.learned import Learned, recognise_learned
from vision.ground.peak import PeakConfig, fit_peak
from vision.ground.registration import register
from vision.pose.pose import PoseEstimate
from vision.recognisers import Recognisers
from vision.records.reports import pose_flaw

OUT = Path(__file__).resolve().parents[2] / "out" / "registration"
SETS = ("nust", "brighton", "rendered")
Way = Literal["as in flight", "with learned", "learned", "features", "Sobel + correlation"]
WAYS: tuple[Way, ...] = get_args(Way)
_ANY_PEAK = PeakConfig(ratio=1.0, correlation=0.0, deviations=0.0)
_WITHIN_95 = 3.841, 5.991  # chi-square of 1 and 2
_WRONG_M = 2.0
_NOWHERE = LandmarkMap.from_landmarks((0.0, 0.0, 0.0), [])


class Outcome(msgspec.Struct, frozen=True):
    """What became of an image. squared: squared error of the ground's position over its covariance, per degree of freedom.

    freedom: directions on the ground that were measured.
    """

    group: str
    way: Way
    outcome: str
    detail: str
    prior_m: float
    cpu_s: float
    accepted: bool = False
    error_m: float = math.nan
    squared: float = math.nan
    freedom: int = 2

    @property
    def over_claim(self) -> float:
        """Error over the 95 % region's size in its direction."""
        return math.sqrt(self.freedom * self.squared / _WITHIN_95[self.freedom - 1])


def main() -> None:
    """Command line."""
    args = arguments()
    data = data_folder()
    sets = args.sets or SETS
    if {"nust", "brighton"} & set(sets) and not (data / "images").is_dir():
        raise SystemExit(f"{data}/images not found: set LANDFIX_DATA to the folder of recorded images")
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    every = [f for name in sets for f in flights(name, data, args.seed, OUT / "maps") if args.only in f.group]
    ways = [way for way in WAYS if way in (args.by or WAYS)]
    outcomes = [outcome for flight in track(every, console=Console(stderr=True)) for outcome in fly(flight, ways)]
    report = table(outcomes).markdown()
    name = "_".join((*sets, *args.only.split()))
    (OUT / f"outcomes_{name}_{args.seed}.json").write_bytes(msgspec.json.encode(outcomes))
    (OUT / f"report_{name}.md").write_text(report)
    sys.stdout.write(report + f"\n{OUT}/report_{name}.md\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", choices=[[], *SETS], help="all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="flights whose name contains this")
    parser.add_argument("--by", action="append", choices=WAYS, help="repeat for more; all by default")
    return parser.parse_args()


def fly(flight: Flight, ways: Sequence[Way] = WAYS) -> Iterator[Outcome]:
    """Every image of a flight, in order, as registration may wait for the next one."""
    models = learned_models(data_folder()) if {"with learned", "learned"} & set(ways) else None
    for way in ways:
        if models is None and way in {"with learned", "learned"}:
            continue
        known = replace(flight.known, learned=models) if way == "with learned" else flight.known
        recognisers = Recognisers(flight.rig, _NOWHERE, known)
        for shot in flight.shots():
            begin = time.process_time()
            if way in {"as in flight", "with learned"}:
                result = recognisers.process(shot.image, None, shot.t_ns, shot.prior)
                pose, outcome, detail = result.pose, result.report.outcome, result.report.detail
            else:
                pose, outcome, detail = _alone(way, models, flight, shot)
            cpu_s = time.process_time() - begin
            off = float(np.linalg.norm((shot.prior.p_n - shot.p_n)[:2]))
            what = flight.group, way, outcome, detail, off, cpu_s
            yield Outcome(*what) if pose is None else Outcome(*what, True, *judge(flight.rig, flight.known.image, shot, pose))


def _alone(way: Way, models: Learned | None, flight: Flight, shot: Shot) -> tuple[PoseEstimate | None, str, str]:
    """What one recogniser finds."""
    rig, image, prior, known = flight.rig, shot.image, shot.prior, flight.known
    if way == "Sobel + correlation":
        peak = register(rig, image, prior, known.image).peak
        fit = "no search" if peak is None else fit_peak(rig, prior, known.image, peak, _ANY_PEAK)
        return (None, "not_found", fit) if isinstance(fit, str) else (fit, "fixed", "")
    if way == "learned":
        assert models is not None
        found = recognise_learned(models, rig, image, prior, known.image)
    else:
        found = recognise(rig, image, prior, known.features, FeatureConfig())
    if not isinstance(found, Recognised):
        return None, found.reason, found.detail
    if flaw := pose_flaw(found.pose, prior):
        return None, "no_pose", flaw
    return found.pose, "fixed", f"{found.inliers} of {found.matched}"


def judge(rig: StereoRig, map_image: GroundImage, shot: Shot, pose: PoseEstimate) -> tuple[float, float, int]:
    """Distance on the ground between what the image's middle shows, that squared over its covariance, and in how many directions;
    of a fix of one direction along the axis known best.
    """

    def middle(p_n: Array, R_nb: Array) -> Array:
        camera, (p_nc, R_nc) = rig.left, rig.camera_pose(p_n, R_nb)
        ray = R_nc @ camera.ray(np.array([[0.5 * camera.width, 0.5 * camera.height]]))[0]
        ground = float(map_image.heights.at(shot.p_n[None, :2])[0])
        place: Array = p_nc[:2] + ray[:2] * (ground - p_nc[2]) / ray[2]
        return place

    p, R = pose.joint_p_n, pose.joint_R_nb
    e, step = middle(shot.p_n, shot.R_nb) - middle(p, R), 1e-5
    J = np.column_stack([(middle(*_moved(p, R, step * d)) - middle(*_moved(p, R, -step * d))) / (2.0 * step) for d in np.eye(6)])
    C = J @ pose.joint_covariance @ J.T + shot.reference_m**2 * np.eye(2)
    if pose.directions is not None and len(pose.directions) == 1:
        variance, axes = np.linalg.eigh(C)
        off_m = abs(float(e @ axes[:, 0]))
        return off_m, off_m**2 / float(variance[0]), 1
    return float(np.linalg.norm(e)), float(e @ np.linalg.solve(C, e)) / 2.0, 2


def _moved(p_n: Array, R_nb: Array, step: Array) -> tuple[Array, Array]:
    turn = np.asarray(cv2.Rodrigues(step[3:])[0], dtype=np.float64)
    return p_n + step[:3], turn @ R_nb


def table(outcomes: Sequence[Outcome]) -> Table:
    """A row for each set and way."""
    columns = (
        "set", "by", "images", "prior off m", "accepted", "one direction", "beyond 2 m", "median m", "worst m", "NEES",
        "within 95 %", "largest error over it", "cpu ms",
    )  # fmt: skip
    rows = []
    for group, way in dict.fromkeys((o.group, o.way) for o in outcomes):
        every = [o for o in outcomes if (o.group, o.way) == (group, way)]
        fixes = [o for o in every if o.accepted]
        errors = np.array([o.error_m for o in fixes] or [np.nan])
        squared = float(np.mean([o.squared for o in fixes])) if fixes else math.nan
        rows.append((
            group, way, str(len(every)), number(float(np.mean([o.prior_m for o in every]))), str(len(fixes)),
            str(sum(o.freedom == 1 for o in fixes)), str(int(np.sum(errors > _WRONG_M))), number(float(np.median(errors))),
            number(float(errors.max())), number(squared), str(sum(o.over_claim < 1.0 for o in fixes)),
            number(max([o.over_claim for o in fixes], default=math.nan)),
            number(1e3 * float(np.median([o.cpu_s for o in every]))),
        ))  # fmt: skip
    return Table("Fixes", columns, rows)


if __name__ == "__main__":
    main()
