"""One image, one map, one prior: the pipeline's result against an independent reference."""

import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from models.radius import reach
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig

NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # R_bc: the image's top is the vehicle's front
WRONG_M = 2.0
_NEXT_NS = 2_000_000_000  # a camera in flight takes an image each second or so
_TURNED_DEG = (30.0, 150.0)  # decoys: not by half a turn, which a row of houses survives

Judge = Callable[[Array, Array], float]  # (p_n, R_nb) -> m from what is known


@dataclass(frozen=True)
class Spread:
    """What a filter would know: position uniform within radius_m, height normal, attitude normal about x, y (level) and z
    (yaw).
    """

    radius_m: float
    height_sigma_m: float
    level_sigma_rad: float
    yaw_sigma_rad: float

    @property
    def sigma(self) -> Array:
        """(6,); a disc has half its radius on each axis."""
        plane, level = 0.5 * self.radius_m, self.level_sigma_rad
        return np.array([plane, plane, self.height_sigma_m, level, level, self.yaw_sigma_rad])

    def draw(self, rng: np.random.Generator, p_n: Array, R_nb: Array) -> Prior:
        """A prior drawn about the pose (p_n, R_nb)."""
        bearing, distance = rng.uniform(0.0, 2.0 * math.pi), self.radius_m * math.sqrt(rng.uniform())
        error = rng.normal(size=6) * self.sigma
        error[:2] = distance * math.cos(bearing), distance * math.sin(bearing)
        q = so3.multiply(so3.quat_exp(error[3:]), so3.from_matrix(np.ascontiguousarray(R_nb)))
        return Prior(p_n + error[:3], so3.normalise(q), np.diag(self.sigma**2))


@dataclass(frozen=True)
class Case:
    """An image, a map, and the pose known without the pipeline; shown: landmarks in the image.

    group: what is counted together; judge: how far a pose is off.
    """

    group: str
    name: str
    image: Image
    rig: StereoRig
    landmarks: LandmarkMap
    p_n: Array
    R_nb: Array
    shown: tuple[str, ...]
    judge: Judge


@dataclass(frozen=True)
class Trial:
    """A case and its prior; after: the next image, with the same error of the prior, for a fix that waits for it."""

    case: Case
    number: int
    prior: Prior
    after: tuple[Case, Prior] | None = None


class Outcome(msgspec.Struct, frozen=True):
    """prior_m: horizontal error of the prior; error_m: of fix and prior, alone_m: of the fix; squared: squared error over the
    covariance, per degree of freedom; at_once: from the first image; within_m: 95 % radius of fix and prior.
    """

    group: str
    case: str
    number: int
    shown: int
    prior_m: float
    outcome: str
    detail: str
    cpu_s: float
    landmarks: tuple[str, ...] = ()
    error_m: float = math.nan
    alone_m: float = math.nan
    squared: float = math.nan
    at_once: bool = True
    within_m: float = math.nan

    @property
    def accepted(self) -> bool:
        """Whether there is a fix."""
        return self.outcome == "fixed"

    @property
    def wrong(self) -> bool:
        """Whether there is a fix that is far off."""
        return self.accepted and self.error_m > WRONG_M

    @property
    def sure(self) -> bool:
        """Whether there is a fix with a 95 % radius of at most WRONG_M."""
        return self.accepted and self.within_m <= WRONG_M


def nadir_rig(camera: CameraModel) -> StereoRig:
    """One camera that looks down, the image's top is the body's front; the right camera never gives an image."""
    return StereoRig(camera, camera, np.eye(3), np.array([-1.0, 0.0, 0.0]), NADIR, np.zeros(3))


def generator(seed: int, name: str, number: int) -> np.random.Generator:
    """One for each trial, whatever ran before."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), number])


def distance_from(p_n: Array) -> Judge:
    """Judges by the distance (3D) from a position."""
    return lambda p, _: float(np.linalg.norm(p - p_n))


def outline_share(camera: CameraModel, p_nc: Array, R_nc: Array, mark: Landmark) -> float:
    """Share of a landmark's roof outline that lies in the image."""
    t = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None, None]
    edge = (mark.outline_n + t * (np.roll(mark.outline_n, -1, axis=0) - mark.outline_n)).reshape(-1, 2)
    roof_n = np.column_stack((edge, np.full(len(edge), mark.roof_d)))
    return float(camera.contains(camera.project((roof_n - p_nc) @ R_nc)).mean())


def turned(marks: Sequence[Landmark], centre: Array, rng: np.random.Generator) -> list[Landmark]:
    """A decoy: all landmarks turned together about a centre (2,) by 30 to 150 degrees to either side, so that none fits."""
    angle = math.radians(rng.uniform(*_TURNED_DEG)) * rng.choice([-1.0, 1.0])
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return [
        Landmark.of(
            m.id, (m.outline_n - centre) @ R.T + centre, m.base_d, m.height_m, m.colour_bgr, m.sigma_m, m.height_sigma_m,
            m.outline_sigma_m, corner_sigma_m=m.corner_sigma_m,
        )
        for m in marks
    ]  # fmt: skip


def run(trial: Trial) -> Outcome:
    """One trial with a pipeline of its own: nothing is remembered from another one."""
    case, prior = trial.case, trial.prior
    pipeline = LandmarkPipeline(case.rig, case.landmarks, PipelineConfig(path="predict"))
    begin = time.process_time()
    result = pipeline.process(case.image, None, 0, prior)
    cpu_s = time.process_time() - begin
    off = float(np.linalg.norm(prior.p_n[:2] - case.p_n[:2]))
    at_once = result.report.outcome != "waiting" or trial.after is None
    if trial.after is not None and not at_once:
        case, prior = trial.after
        result = pipeline.process(case.image, None, _NEXT_NS, prior)
    what = (
        trial.case.group, trial.case.name, trial.number, len(trial.case.shown), off, result.report.outcome,
        result.report.detail, cpu_s,
    )  # fmt: skip
    if result.fix is None or result.pose is None:
        return Outcome(*what, at_once=at_once)
    fix, pose = result.fix, result.pose
    e = np.array(fix.p_n) - case.p_n
    total = fix.covariance + (0.0 if fix.covariance_common is None else fix.covariance_common)
    squared = float(e @ np.linalg.solve(total[:3, :3], e)) / 3.0
    alone = case.judge(np.array(fix.p_n), so3.matrix(np.array(fix.q_nb_wxyz)))
    within_m = reach(pose.joint_covariance[:3, :3])
    return Outcome(*what, fix.landmarks, case.judge(pose.joint_p_n, pose.joint_R_nb), alone, squared, at_once, within_m)


class Row(msgspec.Struct, frozen=True):
    """Trials of one kind; wrong: accepted and more than 2 m off; at_once: accepted from the first image; sure: with a 95 % radius
    of at most 2 m, sure_wrong: of these, beyond 2 m; claimed_m: median 95 % radius, inside: within theirs.
    """

    group: str
    images: int
    trials: int
    accepted: float
    at_once: float
    right: float
    wrong: int
    sure: float
    sure_wrong: int
    median_m: float
    p95_m: float
    worst_m: float
    claimed_m: float
    inside: int
    cpu_s: float


def row(outcomes: Sequence[Outcome]) -> Row:
    """Figures of trials of one group."""
    error = np.array([o.error_m for o in outcomes if o.accepted])
    wrong, n = sum(o.wrong for o in outcomes), len(outcomes)
    median, p95, worst = np.percentile(error, (50, 95, 100)).tolist() if len(error) else (math.nan,) * 3
    return Row(
        outcomes[0].group, len({o.case for o in outcomes}), n, len(error) / n,
        sum(o.accepted and o.at_once for o in outcomes) / n, (len(error) - wrong) / n, wrong,
        sum(o.sure for o in outcomes) / n, sum(o.sure and o.wrong for o in outcomes),
        median, p95, worst, float(np.median([o.within_m for o in outcomes if o.accepted] or [math.nan])),
        sum(o.accepted and o.error_m <= o.within_m for o in outcomes), float(np.median([o.cpu_s for o in outcomes])),
    )  # fmt: skip
