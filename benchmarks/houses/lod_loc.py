"""A thermal photo over a city model: `python -m benchmarks.houses.lod_loc [--seed 0] [--priors 30]`.

UAVD4L-LoD (China): the one photo of that set that a public repository holds whole, and the city model of its place. In
images/lod_loc of LANDFIX_DATA, with their names:

    VictorZoo/LoD-Loc, dataset/DEMO/demo (MIT)    Query_image/X.JPG, intrinsic/X_intrinsic.txt, GT_pose/X_pose.txt as
                                                  X_GT_pose.txt, GPS_pose/X_pose.txt as X_GPS_pose.txt; X: NAME
    VictorZoo/LoD-Loc-v2 (no licence is given)    UAVD4L-LoD1.obj

The photo looks straight down from 195 m, 640 x 512 px. Five roofs are in view, four cut by the border. A landmark is a level roof
of the model, over the lowest corner of its building. Poses and model share east, north, up; cameras look along z. Decoys: the map
turned by 30 to 150 degrees. One photo is one photo, whatever the number of priors.
"""

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.aerial.trials import Case, Spread, Trial, distance_from, generator, nadir_rig, run, turned
from benchmarks.flights.tasks import data_folder
from benchmarks.houses.trials import naive
from benchmarks.tables import Table, number
from models import so3
from models.camera import CameraModel
from models.maps import outline as polygon
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from models.radius import horizontal_radius
from vision.show.overlay import draw_overlay

FOLDER: Final = "images/lod_loc"
NAME: Final = "DJI_20230513163714_0033_T"
MODEL: Final = "UAVD4L-LoD1.obj"
OUT = Path(__file__).resolve().parents[2] / "out" / "houses"
SPREADS = {
    "up to 15 m off, tilt 1 degree": Spread(15.0, 2.0, math.radians(1.0), math.radians(3.0)),
    "up to 15 m off, tilt 0.3 degrees": Spread(15.0, 2.0, math.radians(0.3), math.radians(1.0)),
}
_SENSOR_SIGMA = np.array([3.0, 3.0, 12.0, *np.radians([1.5, 1.5, 3.5])])  # what `locate` takes of a consumer drone's tags
_ORIGIN = (0.0, 0.0, 0.0)  # the model's, wherever that is
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # of east, north, up
_SIGMA_M, _OUTLINE_M, _REACH_M = 1.0, 0.7, 130.0
_LEAST_M2, _LEAST_M, _LEVEL_M = 15.0, 2.0, 0.2
_NEAR_M, _INSIDE_95 = 3.0, 5.991  # chi-square of 2


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.houses.lod_loc", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--priors", type=int, default=30)
    args = parser.parse_args()
    data = data_folder()
    if not (data / FOLDER / MODEL).is_file():
        raise SystemExit(f"{data / FOLDER} not found: see benchmarks/houses/lod_loc.py for what belongs there")
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    sys.stdout.write(Table("A thermal photo over a city model", _COLUMNS, list(_rows(data, args.seed, args.priors))).markdown())


def case(data: Path) -> Case:
    """The photo, where it was taken, and the roofs around."""
    folder = data / FOLDER
    k = np.loadtxt(folder / f"{NAME}_intrinsic.txt")
    image = cv2.imread(str(folder / f"{NAME}.JPG"))
    assert image is not None
    rig = nadir_rig(CameraModel(image.shape[1], image.shape[0], k[0, 0], k[1, 1], k[0, 2] - 0.5, k[1, 2] - 0.5))
    p_n, R_nb = _pose(folder / f"{NAME}_GT_pose.txt", rig.R_bc)
    marks = LandmarkMap.from_landmarks(_ORIGIN, roofs(folder / MODEL, p_n[:2]))
    return Case("LoD-Loc", NAME, np.asarray(image, np.uint8), rig, marks, p_n, R_nb, (), distance_from(p_n))


def _pose(file: Path, R_bc: Array) -> tuple[Array, Array]:
    """p_n, R_nb of a file that holds a camera's pose, 4 x 4."""
    pose = np.loadtxt(file)
    return _NED @ pose[:3, 3], _NED @ pose[:3, :3] @ R_bc.T


def roofs(model: Path, around: Array) -> list[Landmark]:
    """Level faces near a place (2,), high enough above the lowest corner of what they hang together with."""
    lines = [line.split() for line in model.read_text().splitlines()]
    x_n = np.array([[float(x) for x in line[1:]] for line in lines if line[:1] == ["v"]]) @ _NED.T
    faces = [[int(corner.split("/")[0]) - 1 for corner in line[1:]] for line in lines if line[:1] == ["f"]]
    ground = _lowest(x_n[:, 2], faces)
    found = list[Landmark]()
    for face in faces:
        outline, roof_d = np.ascontiguousarray(x_n[face, :2]), float(x_n[face, 2].mean())
        height, area = float(ground[face[0]] - roof_d), polygon.area(outline)
        if np.ptp(x_n[face, 2]) > _LEVEL_M or abs(area) < _LEAST_M2 or height < _LEAST_M or polygon.crosses_itself(outline):
            continue
        if np.linalg.norm(outline.mean(axis=0) - around) < _REACH_M:
            outline = outline if area > 0.0 else np.ascontiguousarray(outline[::-1])
            found.append(
                Landmark.of(
                    str(len(found)), outline, float(ground[face[0]]), height, None, _SIGMA_M, 1.0, _OUTLINE_M,
                    corner_sigma_m=_OUTLINE_M,
                )
            )  # fmt: skip
    return found


def _lowest(down: Array, faces: list[list[int]]) -> Array:
    """Down of the lowest corner of each corner's building: of all faces that hang together."""
    building = np.arange(len(down))
    lowest = down.copy()
    while True:
        before = building.copy()
        for face in faces:
            building[face] = building[face].min()
        if np.array_equal(before, building):
            break
    np.maximum.at(lowest, building, down)
    return np.asarray(lowest[building])


_COLUMNS = (
    "prior", "map", "trials", "accepted", "roofs off, median m", "worst m", "position, median m", "worst m", "claimed 95 % m",
    "NEES / 2", "within it", "Sobel + correlation, within 3 m", "CPU ms",
)  # fmt: skip


def _rows(data: Path, seed: int, priors: int) -> Iterator[tuple[str, ...]]:
    known = case(data)
    for name, spread in SPREADS.items():
        draws = [spread.draw(generator(seed, name, k), known.p_n, known.R_nb) for k in range(priors)]
        for kind in ("true", "turned"):
            yield name, kind, *_judged(known, draws, seed, kind)
    p_n, R_nb = _pose(data / FOLDER / f"{NAME}_GPS_pose.txt", known.rig.R_bc)
    sensor = [Prior(p_n, so3.from_matrix(R_nb), np.diag(_SENSOR_SIGMA**2))]
    yield "the drone's own sensors, height 20 m off", "true", *_judged(known, sensor, seed, "true")


def _judged(known: Case, priors: list[Prior], seed: int, kind: str) -> tuple[str, ...]:
    fixes, took, near = list[tuple[float, float, float, float]](), list[float](), 0
    for k, prior in enumerate(priors):
        marks = list(known.landmarks)
        if kind == "turned":
            marks = turned(marks, known.p_n[:2], generator(seed, "turned", k))
        of = Case(
            known.group, kind, known.image, known.rig, LandmarkMap.from_landmarks(_ORIGIN, marks), known.p_n, known.R_nb, (),
            known.judge,
        )  # fmt: skip
        outcome, result = run(Trial(of, k, prior), "predict")
        took.append(outcome.cpu_s)
        near += _off(known, naive(known.image, known.rig, marks, prior), prior.R_nb) < _NEAR_M
        pose = (prior.p_n, prior.R_nb) if result.pose is None else (result.pose.joint_p_n, result.pose.joint_R_nb)
        if k < 2:
            drawn = draw_overlay(known.image, known.rig.left, *known.rig.camera_pose(*pose), marks, (), (), [outcome.outcome])
            cv2.imwrite(str(OUT / f"lod_loc_{kind}_{k}.png"), drawn)
        if result.pose is not None and result.fix is not None:
            e, P = (result.pose.joint_p_n - known.p_n)[:2], result.pose.joint_covariance[:2, :2]
            off = _off(known, result.pose.joint_p_n, result.pose.joint_R_nb)
            fixes.append((off, float(np.linalg.norm(e)), float(e @ np.linalg.solve(P, e)), float(horizontal_radius(P[None])[0])))
    off_m, error, squared, radius = np.array(fixes or [(math.nan,) * 4]).T
    return (
        str(len(priors)), str(len(fixes)), number(float(np.median(off_m))), number(float(off_m.max())),
        number(float(np.median(error))), number(float(error.max())),
        number(float(np.median(radius))), number(float(squared.mean()) / 2.0), str(int(np.sum(squared < _INSIDE_95))),
        str(near), number(1e3 * float(np.median(took))),
    )  # fmt: skip


def _off(known: Case, p_n: Array, R_nb: Array) -> float:
    """Mean distance [m] of the true roofs that are in view, in the image, from where they are."""
    camera, (p_nc, R_nc) = known.rig.left, known.rig.camera_pose(known.p_n, known.R_nb)
    middle = np.array([(*mark.centre_n, mark.roof_d) for mark in known.landmarks])
    x_c = (middle - p_nc) @ R_nc
    seen = camera.contains(camera.project(x_c))
    p, R = known.rig.camera_pose(p_n, R_nb)
    px = camera.project(x_c[seen]) - camera.project((middle[seen] - p) @ R)
    return float(np.mean(np.linalg.norm(px, axis=1) * x_c[seen, 2]) / camera.fx)


if __name__ == "__main__":
    main()
