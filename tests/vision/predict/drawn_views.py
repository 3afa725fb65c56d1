"""Views for the accuracy of single fixes: a world, its map with errors, a rig with errors, a pose, and what a filter would know.

Everything is drawn from (seed, cell, number): true = nominal (+) error within the covariances that the estimator gets.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.pose.pose import PoseEstimate
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.world import Appearance, Sun, World

MARKS = (1, 2, 3)
ROOFS = ("painted", "pale")
MAP_SIGMAS_M = (0.0, 0.5)
TAKES = ("clean", "noisy", "blurred", "dark", "bright")
NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # R_bc: the image's top is the vehicle's front
PAINTS = ((40, 40, 190), (190, 70, 40), (40, 160, 200), (60, 140, 50), (160, 60, 150))
PALES = ((150, 165, 172), (170, 176, 180), (128, 140, 150), (110, 128, 150), (185, 190, 192))
ATTITUDE_SIGMA_DEG = (0.5, 0.5, 2.0)
POSITION_SIGMA_M = (5.0, 5.0, 3.0)
WRONG_M, CHI2_9999_OF_3 = 3.0, 21.11


@dataclass(frozen=True)
class Cell:
    """What is varied."""

    height_m: float
    tilt_deg: float
    marks: int
    roof: str
    map_sigma_m: float
    take: str


@dataclass(frozen=True)
class View:
    """One view: the truth (world, true_rig, p_n, R_nb) and the estimator's model of it (rig, landmarks, prior)."""

    cell: Cell
    world: World
    true_rig: StereoRig
    p_n: Array
    R_nb: Array
    conditions: Conditions
    rig: StereoRig
    landmarks: tuple[Landmark, ...]
    prior: Prior
    rng: np.random.Generator


def draw_view(seed: int, number: int) -> View:
    """View `number` of a run: its cell and all that is drawn in it."""
    rng = np.random.default_rng([seed, number])
    cell = Cell(
        float(np.exp(rng.uniform(math.log(10.0), math.log(120.0)))),
        float(rng.uniform(0.0, 25.0)),
        int(rng.choice(MARKS)),
        str(rng.choice(ROOFS)),
        float(rng.choice(MAP_SIGMAS_M)),
        str(rng.choice(TAKES)),
    )
    rig, true_rig = _rigs(rng)
    p_n, R_nb = _pose(cell, rng)
    mapped, true, appearances = _landmarks(cell, true_rig, p_n, R_nb, rng)
    ground = Ground.procedural(rng)
    sun = Sun(rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(30.0, 70.0)), rng.uniform(0.3, 0.6))
    world = World(true, appearances, (), ground, sun)
    return View(cell, world, true_rig, p_n, R_nb, _conditions(cell.take, rng), rig, mapped, _prior(p_n, R_nb, rng), rng)


def _rigs(rng: np.random.Generator) -> tuple[StereoRig, StereoRig]:
    """The calibrated rig and the true one: the covariance a good calibration ends with."""
    intrinsic = np.diag([0.4, 0.4, 0.4, 0.4, 1e-3, 2e-3, 1e-4, 1e-4]) ** 2
    rc = np.diag([3e-4] * 3 + [3e-4] * 3) ** 2
    bc = np.diag([5e-3] * 3 + [1e-3] * 3) ** 2
    distortion = (-0.11, 0.03, 3e-4, -2e-4)
    camera = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5, distortion, intrinsic)
    rig = StereoRig(camera, camera, np.eye(3), np.array([-0.3, 0.0, 0.0]), NADIR, np.zeros(3), rc, bc)
    exact = [camera_with(camera, rng.multivariate_normal(np.zeros(8), intrinsic)) for _ in range(2)]
    e_rc, e_bc = rng.multivariate_normal(np.zeros(6), rc), rng.multivariate_normal(np.zeros(6), bc)
    true = StereoRig(
        exact[0], exact[1], so3.matrix(so3.quat_exp(e_rc[3:])) @ rig.R_rc, rig.t_rc + e_rc[:3],
        so3.matrix(so3.quat_exp(e_bc[3:])) @ rig.R_bc, rig.p_bc + e_bc[:3],
    )  # fmt: skip
    return rig, true


def camera_with(camera: CameraModel, error: Array) -> CameraModel:
    """The camera with errors (8,) of fx fy cx cy and distortion."""
    values = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]) + error
    fx, fy, cx, cy, *distortion = values.tolist()
    return CameraModel(camera.width, camera.height, fx, fy, cx, cy, tuple(distortion))


def _pose(cell: Cell, rng: np.random.Generator) -> tuple[Array, Array]:
    yaw, direction = rng.uniform(-math.pi, math.pi, 2)
    axis = np.array([math.cos(direction), math.sin(direction), 0.0]) * math.radians(cell.tilt_deg)
    R_nb = so3.matrix(so3.quat_exp(axis)) @ so3.matrix(so3.from_euler(0.0, 0.0, yaw))
    return np.array([*rng.uniform(-20.0, 20.0, 2), -cell.height_m]), R_nb


def _landmarks(
    cell: Cell, rig: StereoRig, p_n: Array, R_nb: Array, rng: np.random.Generator
) -> tuple[tuple[Landmark, ...], tuple[Landmark, ...], tuple[Appearance, ...]]:
    """Landmarks as mapped and as they are: in view, apart, 50 to 150 px long whatever the height."""
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    mapped: list[Landmark] = []
    true: list[Landmark] = []
    appearances: list[Appearance] = []
    taken: list[tuple[Array, float]] = []
    metre_px = 600.0 / cell.height_m
    tries = 0
    while len(mapped) < cell.marks:
        tries += 1
        length, aspect = rng.uniform(55.0, 150.0) / metre_px * 0.98 ** (tries // 5), rng.uniform(0.5, 0.95)
        px = np.array([[rng.uniform(80, 560), rng.uniform(80, 400)]])
        ray = R_nc @ rig.left.ray(px)[0]
        centre = (p_nc + ray * (-p_nc[2] / ray[2]))[:2]
        radius = 0.62 * length
        if any(np.hypot(*(centre - c)) < 1.2 * (radius + r) for c, r in taken):
            continue
        taken.append((centre, radius))
        outline = _outline(length, aspect * length, rng) @ _turn(rng.uniform(0.0, 2.0 * math.pi)).T + centre
        height = 0.0 if rng.random() < 0.2 else length * rng.uniform(0.1, 0.4)
        sigma = cell.map_sigma_m
        height_sigma, growth = min(0.3 * sigma, 0.3 * height), min(0.2 * sigma, 0.03 * length)
        palette = PAINTS if cell.roof == "painted" else PALES
        colour = palette[rng.integers(len(palette))]
        mark = Landmark.of(f"m{len(mapped)}", outline, 0.0, height, colour, sigma, height_sigma, growth)
        mapped.append(mark)
        true.append(_true_landmark(mark, rng))
        texture = "paint" if cell.roof == "painted" else str(rng.choice(["shingles", "gravel", "metal"]))
        blue, green, red = (np.array([150.0, 160.0, 165.0]) * rng.uniform(0.6, 1.15)).tolist()
        appearances.append(Appearance(colour, (blue, green, red), texture, 0.03 if cell.roof == "painted" else 0.08))
    return tuple(mapped), tuple(true), tuple(appearances)


def _outline(length: float, width: float, rng: np.random.Generator) -> Array:
    """A rectangle, or one time in four an L."""
    a, b = 0.5 * length, 0.5 * width
    if rng.random() < 0.25:
        return np.array([(-a, -b), (-a, b), (0.1 * a, b), (0.1 * a, 0.1 * b), (a, 0.1 * b), (a, -b)])
    return np.array([(-a, -b), (-a, b), (a, b), (a, -b)])


def _turn(angle: float) -> Array:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _true_landmark(mark: Landmark, rng: np.random.Generator) -> Landmark:
    """The landmark as it is: shifted, higher or lower, its outline larger or smaller by the same distance all round."""
    shift = rng.normal(0.0, 1.0, 2) * mark.sigma_m
    height = max(mark.height_m + rng.normal() * mark.height_sigma_m, 0.0)
    outline = grown(mark.outline_n, rng.normal() * mark.outline_sigma_m) + shift
    return Landmark.of(mark.id, outline, mark.base_d, height, mark.colour_bgr)


def grown(outline: Array, distance: float) -> Array:
    """The outline with every side moved outwards by distance [m] (anticlockwise seen from above)."""
    along = np.roll(outline, -1, axis=0) - outline
    outward = np.column_stack((-along[:, 1], along[:, 0])) / np.linalg.norm(along, axis=1)[:, None]
    before = np.roll(outward, 1, axis=0)
    mitre = (before + outward) / (1.0 + np.sum(before * outward, axis=1))[:, None]
    result: Array = outline + distance * mitre
    return result


def _conditions(take: str, rng: np.random.Generator) -> Conditions:
    cast = tuple(rng.uniform(0.92, 1.08, 3).tolist())
    if take == "noisy":
        return Conditions(cast_bgr=cast, read_sigma=rng.uniform(3.0, 8.0), shot=0.1)
    if take == "blurred":
        angle, length = rng.uniform(0.0, math.pi), rng.uniform(1.0, 5.0)
        return Conditions(
            cast_bgr=cast, psf_sigma_px=rng.uniform(0.5, 1.2), blur_px=(length * math.cos(angle), length * math.sin(angle))
        )
    if take == "dark":
        return Conditions(cast_bgr=cast, exposure=rng.uniform(0.3, 0.6))
    if take == "bright":
        return Conditions(cast_bgr=cast, exposure=rng.uniform(1.25, 1.6), haze_per_m=rng.uniform(0.0, 0.003))
    return Conditions(cast_bgr=cast)


def _prior(p_n: Array, R_nb: Array, rng: np.random.Generator) -> Prior:
    """The filter's prior, drawn about the truth. It is level to 0.5 degrees and turned by 2."""
    sigma = np.array([*POSITION_SIGMA_M, *np.radians(ATTITUDE_SIGMA_DEG)])
    sigma[2] = min(sigma[2], 0.1 * -p_n[2])
    error = rng.normal(size=6) * sigma
    q = so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(R_nb))
    return Prior(p_n - error[:3], so3.normalise(q), np.diag(sigma**2))


class Found(NamedTuple):
    """error_m: of the position, prior and images together; squared: its squared Mahalanobis distance."""

    error_m: float = 0.0
    squared: float = 0.0

    @property
    def wrong(self) -> bool:
        """Off by more than 3 m and outside its own 99.99 % ellipsoid."""
        return self.error_m > WRONG_M and self.squared > CHI2_9999_OF_3


def found_of(view: View, fit: PoseEstimate | None) -> Found:
    """Compared with the truth."""
    if fit is None:
        return Found()
    e = view.p_n - fit.joint_p_n
    return Found(float(np.linalg.norm(e)), float(e @ np.linalg.solve(fit.joint_covariance[:3, :3], e)))
