"""Six-degree-of-freedom pose from landmarks: Gauss-Newton on outline edges (docs/vision_pose.md).

    r = H dx + N nu + e,     dx = (dp_n, dtheta_n),   R_true = exp(dtheta) R          (thesis eq. 3.84-3.92, Table 1; Lowe 1985)
    z = x0 (+) (delta + C Lambda_0 delta),   delta = x_joint (-) x0,   C^-1 = H^T (R + N N^T)^-1 H

r: offsets and tilts; nu: errors of map and rig, with priors. Reported is the images' own measurement z which with the prior gives
the joint optimum, or its measured directions (information.py).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.identify.ambiguity import ANY_TURN_RAD, alternatives, round_landmarks
from vision.outline.edge_noise import NoiseConfig, line_covariance
from vision.pose.corner_errors import by_corners, repeating
from vision.pose.information import Measured
from vision.pose.least_squares import POSE, Solution, System, distances, solve, solve_robustly
from vision.pose.observation import Image, Observation, ObservationConfig, Scene

Mask = NDArray[np.bool_]
Pose = tuple[Array, Array]  # p_n (3,), R_nb (3, 3)
_MOST = 0.8  # if so many offsets are within the first fit's reach, no further search is needed
_SETTLED_PX = 0.8  # a step that moves the edges by less, RMS, is followed by no further observation
_APART = 30.0  # squared Mahalanobis distance from which two poses are two
_MOST_ERRORS = 8  # of each landmark, in a fix
_LARGEST_TURN_RAD = 0.2  # in the last step
_STRAIGHT_PX, _MORE_OBSERVATIONS = 0.02, 3  # by so little may the last step bend; or it is done again from where it leads


class PoseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a fit is accepted, and its parts."""

    least_found: Annotated[float, Meta(ge=0, le=1, description="share of the outline in view that must be found")] = 0.4
    least_fitted: Annotated[float, Meta(ge=0, le=1, description="the same at the end")] = 0.6
    least_edges: Annotated[int, Meta(ge=3, description="lines in all images")] = 4
    freedom: Annotated[float, Meta(gt=0, description="weight of the expected residuals in the variance factor, in numbers")] = (
        16.0
    )
    expected: Annotated[float, Meta(gt=0, description="prior variance factor; above 1, since errors have tails")] = 1.25
    worst_factor: Annotated[float, Meta(gt=1, description="variance factor above which the fit is rejected")] = 8.0
    edge_gate: Annotated[float, Meta(gt=0, description="chi-square (4) above which an edge is left out")] = 22.0
    most_left_out: Annotated[float, Meta(ge=0, lt=1, description="share of the edges that may be left out")] = 0.25
    decided: Annotated[float, Meta(gt=0, description="difference of costs, chi-square, that decides between two poses")] = 13.8
    surprise: Annotated[
        float, Meta(gt=0, description="chi-square (6) against the prior from which on the images are doubted")
    ] = 22.5
    observation: ObservationConfig = ObservationConfig()
    noise: NoiseConfig = NoiseConfig()


@dataclass(frozen=True, slots=True)
class NoPose:
    """Reason for no pose."""

    reason: str  # no_image | too_few_edges | not_found | residual | diverged | ambiguous
    detail: str = ""


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose from the images alone, and its posterior with the prior.

    p_n, R_nb: z; covariance (6, 6): new in every image; covariance_common (6, 6): by map and rig; order x y z rx ry rz, NED.
    landmark_errors (L, 6, M): effect of unit errors; covariance_rig: the rest. joint_*: posterior. directions (r, 6), readings
    (r,): measured ones and their readings from p_n, R_nb, the joint optimum (LandmarkFix); None: all. residual_px: RMS offset;
    factor: measured over expected variance; found: share of the outline; edges: lines used; shift_m: (L, M) estimated map errors;
    cost: chi-square of residuals and prior.
    """

    p_n: Array
    R_nb: Array
    covariance: Array
    covariance_common: Array
    directions: Array | None
    readings: Array | None
    landmark_errors: Array
    covariance_rig: Array
    joint_p_n: Array
    joint_R_nb: Array
    joint_covariance: Array
    residual_px: float
    factor: float
    found: float
    edges: int
    shift_m: Array
    cost: float


class _Fit:
    """Variables of an estimation: pose and map errors; its prior."""

    def __init__(self, scene: Scene, start: Pose, prior: Prior, shift_m: Array | None) -> None:
        self.scene, self.prior = scene, prior
        self.p_n, self.R_nb = (np.array(part, dtype=np.float64, order="C") for part in start)
        self.p0, self.q0 = (np.ascontiguousarray(part, dtype=np.float64) for part in (prior.p_n, prior.q_nb_wxyz))
        self.information = prior.information
        sigma = scene.map_sigma
        self.shift_m = np.zeros_like(sigma) if shift_m is None else np.where(sigma > 0.0, shift_m, 0.0)
        self.bc, self.rc = (np.zeros(root.shape[1]) for root in scene.rig_roots[:2])
        self.round = round_landmarks(scene.prisms.vertices, scene.prisms.offsets)

    def delta(self) -> Array:
        """x (-) x0: how far the pose is from the prior's, (6,)."""
        return np.asarray(_difference(self.p_n, self.R_nb, self.p0, self.q0))

    def turned(self, seen: Observation) -> Array:
        """(E, K, 2, T) as Observation.A: unobservable turns of round landmarks about their middles.

        Equivalent to a turn of the vehicle: dtheta = e_d, dp = e_d x (p - c).
        """
        columns = np.zeros((*seen.line.shape, len(self.round)))
        for k, (mark, centre) in enumerate(self.round):
            about = np.array([centre[1] - self.p_n[1], self.p_n[0] - centre[0], 0.0, 0.0, 0.0, 1.0])
            columns[..., k] = ANY_TURN_RAD * (seen.edges.landmark == mark)[:, None, None] * (seen.H @ about)
        return columns

    def present(self, count: int) -> Array:
        """Unit-variance nuisances (count,) drawn already: map, camera poses; cameras 0."""
        used = self.scene.map_used
        mapped: Array = self.shift_m.ravel()[used] / self.scene.map_sigma.ravel()[used]
        if count == len(used):  # a search knows no rig errors
            return mapped
        rest = np.zeros(count - len(mapped) - len(self.bc) - len(self.rc))
        present: Array = np.concatenate((mapped, self.bc, self.rc, rest))
        return present

    def observe(self, config: ObservationConfig, search_px: int = 0, farthest_px: float = 0.0) -> Observation:
        """One observation from this pose."""
        rig = self.scene.moved_rig(self.bc, self.rc)
        return self.scene.observe(self.p_n, self.R_nb, self.shift_m, rig, config, search_px, farthest_px)

    def solve(self, system: System, *, robust: bool = False) -> Solution:
        """The step from here."""
        step = solve_robustly if robust else solve
        return step(system, self.present(system.A.shape[2] - POSE), self.information, self.delta())

    def move(self, step: Solution) -> None:
        """Retract: p + dp, exp(dtheta) R, errors of map and camera poses."""
        self.p_n = self.p_n + step.dx[:3]
        self.R_nb = _turned(self.R_nb, step.dx[3:])
        used = self.scene.map_used
        flat = self.shift_m.ravel()
        flat[used] = step.nuisance[: len(used)] * self.scene.map_sigma.ravel()[used]
        self.shift_m = flat.reshape(self.shift_m.shape)
        if len(step.nuisance) > len(used):
            of_rig, count = step.nuisance[len(used) :], len(self.bc)
            self.bc, self.rc = of_rig[:count], of_rig[count : count + len(self.rc)]


@njit(cache=True)
def _turned(R: Array, dtheta: Array) -> Array:
    return so3.matrix(so3.normalise(so3.multiply(so3.quat_exp(dtheta), so3.from_matrix(R))))


def estimate_pose(
    rig: StereoRig, views: Sequence[Image | None], landmarks: Sequence[Landmark], start: Pose, prior: Prior,
    config: PoseConfig | None = None, shift_m: Array | None = None,
) -> PoseEstimate | NoPose:  # fmt: skip
    """Body pose from landmarks in views (left, right; None: missing), or why none.

    start: p_n, R_nb, outlines within their edges' first window; shift_m: (L, M) known map errors.
    """
    config = config or PoseConfig()
    scene = Scene(rig, views, landmarks)
    if not landmarks or all(image is None for image in scene.images):
        return NoPose("no_image" if landmarks else "too_few_edges")
    try:
        return _decided(scene, start, prior, shift_m, config, landmarks)
    except np.linalg.LinAlgError as error:
        return NoPose("diverged", f"the equations cannot be solved: {error}")


def _decided(
    scene: Scene, start: Pose, prior: Prior, shift_m: Array | None, config: PoseConfig, landmarks: Sequence[Landmark]
) -> PoseEstimate | NoPose:
    found = _estimate(scene, start, prior, shift_m, config)
    if isinstance(found, NoPose):
        return found
    information = prior.information
    for other in alternatives(found.joint_p_n, found.joint_R_nb, landmarks):
        if not _may_be(other, found, prior, information, config):
            continue
        rival = _estimate(scene, other, prior, found.shift_m, config)
        if isinstance(rival, NoPose) or rival.found < 0.9 * found.found or not _apart(rival, found):
            continue
        if abs(rival.cost - found.cost) < config.decided:
            return NoPose("ambiguous", "another pose shows the same image, and the prior allows both")
        found = min(found, rival, key=lambda one: one.cost)
    return found


def _may_be(other: Pose, found: PoseEstimate, prior: Prior, information: Array, config: PoseConfig) -> bool:
    """Whether the prior, information (6, 6), nearly allows another pose."""
    q0 = np.asarray(prior.q_nb_wxyz, dtype=float)
    ours, theirs = difference(found.joint_p_n, found.joint_R_nb, prior.p_n, q0), difference(*other, prior.p_n, q0)
    return bool(theirs @ information @ theirs < ours @ information @ ours + 2.0 * config.decided)


def _apart(rival: PoseEstimate, found: PoseEstimate) -> bool:
    between = difference(rival.joint_p_n, rival.joint_R_nb, found.joint_p_n, so3.from_matrix(found.joint_R_nb))
    return bool(between @ np.linalg.solve(found.joint_covariance, between) > _APART)


def _estimate(scene: Scene, start: Pose, prior: Prior, shift_m: Array | None, config: PoseConfig) -> PoseEstimate | NoPose:
    fit = _Fit(scene, start, prior, shift_m)
    near = False
    for half in config.observation.search_px:
        if not near:
            seen = fit.observe(config.observation, search_px=half)
            if refusal := _not_enough(seen, config):
                return refusal
            near = float(np.mean(seen.off(seen.line)[seen.found] < config.observation.farthest_px[0])) > _MOST
            fit.move(_robust_step(fit, seen, 1.0))
    farthest, *nearer = config.observation.farthest_px
    seen = fit.observe(config.observation, farthest_px=farthest)
    if refusal := _not_enough(seen, config):
        return refusal
    for farthest in nearer:
        step = _robust_step(fit, seen, 0.3)
        left = step.residual.reshape(seen.line.shape)
        if _rms(seen.off(seen.line - left)[seen.found]) < _SETTLED_PX:
            seen = seen.within(seen.off(left), farthest)
        else:
            fit.move(step)
            seen = fit.observe(config.observation, farthest_px=farthest)
        if refusal := _not_enough(seen, config):
            return refusal
    if seen.share < config.least_fitted:
        return NoPose("not_found", f"{seen.share:.0%} of the outline in view at the end")
    system, step = _final_step(fit, seen, config)
    for _ in range(_MORE_OBSERVATIONS):
        if _bend_px(seen, step.dx) < _STRAIGHT_PX:
            break
        fit.move(step)
        seen = fit.observe(config.observation, farthest_px=farthest)
        if refusal := _not_enough(seen, config):
            return refusal
        system, step = _final_step(fit, seen, config)
    return _report(fit, seen, system, step, config)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _bend_px(seen: Observation, dx: Array) -> float:
    """|dtheta x dp| / 2, in px, omitted by a linear step; only the last covariances give weak directions' range."""
    square = np.sum(seen.A[:, :, 0, :3] ** 2, axis=2)[seen.found].max(initial=0.0)
    return float(0.5 * np.sqrt(square * np.sum(np.cross(dx[3:], dx[:3]) ** 2)))


def _not_enough(seen: Observation, config: PoseConfig) -> NoPose | None:
    if seen.numbers < config.least_edges:
        return NoPose("too_few_edges", f"{seen.numbers} edges found")
    return None if seen.share >= config.least_found else NoPose("not_found", f"{seen.share:.0%} of the outline in view")


def _system(seen: Observation, R: Array, *more: Array) -> System:
    """Edges of all images as blocks; R: (E, K, 2, K, 2); more: (E, K, 2, T) further unknowns."""
    edges, images = seen.found.shape
    rows = 2 * images
    A = (np.concatenate((seen.A, *more), axis=3) if more else seen.A).reshape(edges, rows, -1)
    return System.of(seen.line.reshape(edges, rows), A, R.reshape(edges, rows, rows), np.repeat(seen.found, 2, axis=1))


def _robust_step(fit: _Fit, seen: Observation, common_px: float) -> Solution:
    edges, images = seen.found.shape
    R = np.zeros((edges, images, 2, images, 2))
    for k, line in enumerate(seen.lines):
        variance = common_px**2
        R[:, k, :, k] = 0.5 * variance * line.unit  # variance (unit / 2 + diag(1, 1/2)) + diag(opened, 0)
        R[:, k, 0, k, 0] += variance + seen.opened[k]
        R[:, k, 1, k, 1] += 0.5 * variance
    return fit.solve(_system(seen, R), robust=True)


def _final_step(fit: _Fit, seen: Observation, config: PoseConfig) -> tuple[System, Solution]:
    own = by_corners(seen.cornered)
    covariance = line_covariance(seen.lines, seen.block, seen.kind, seen.opened, config.noise)
    R = covariance + (own @ own.transpose(0, 2, 1)).reshape(covariance.shape)
    system = _system(seen, R, fit.turned(seen))
    weight = np.ones(len(system.z))
    for _ in range(int(config.most_left_out * len(weight)) + 1):
        step = fit.solve(system)
        distance = distances(system, step.residual)
        worst = int(np.argmax(distance))
        if distance[worst] < config.edge_gate or system.count <= 2 * config.least_edges:
            break
        weight[worst] = 0.0
        system = system.weighted(weight)
    return system, step


def _report(fit: _Fit, seen: Observation, system: System, step: Solution, config: PoseConfig) -> PoseEstimate | NoPose:
    used = system.W[:, ::2, ::2].diagonal(axis1=1, axis2=2) > 0.0  # (E, K)
    if not np.isfinite(step.dx).all() or np.abs(step.dx[3:]).max() > _LARGEST_TURN_RAD:
        return NoPose("diverged")
    measured = Measured.of(step.omega, fit.information)
    freedom = max(2 * system.count - measured.rank, 1)
    chi2 = float(distances(system, step.residual).sum() + step.nuisance @ step.nuisance)
    factor = (config.freedom * config.expected + chi2) / (config.freedom + freedom)
    if factor > config.worst_factor:
        return NoPose("residual", f"variance factor {factor:.1f}")
    if not measured.rank:
        return NoPose("nothing_new", "the images say nothing of the pose that the prior does not")
    fit.move(step)
    delta = fit.delta()
    image, moved = measured.covariances(system, step.omega, 1.0)  # as it was solved
    p_n, R_nb, directions, readings = fit.p_n, fit.R_nb, None, None
    if measured.whole:
        p_n, R_nb = retract(fit.p0, fit.q0, measured.alone(delta, image + moved @ moved.T))
    else:
        directions, readings = measured.reported_along(delta, image + moved @ moved.T)
    image, moved = measured.covariances(system, step.omega, factor)
    common = moved @ moved.T
    by_landmark, by_rig = _separated(moved, fit)
    if seen.cornered.any():
        own = math.sqrt(factor) * measured.moved_by(system, step.omega, factor, by_corners(seen.cornered))
        again = repeating(own, seen.edges.landmark, len(by_landmark), _MOST_ERRORS - by_landmark.shape[2])
        repeated = np.einsum("lik,ljk->ij", again, again)
        image, common, by_landmark = image - repeated, common + repeated, np.concatenate((by_landmark, again), axis=2)
    image = image * max(measured.surprise(delta, image + common, config.surprise), 1.0)
    joint_p_n, joint_R_nb, joint = combine(fit.prior, p_n, R_nb, image + common, directions, readings)
    return PoseEstimate(
        p_n, R_nb, _symmetric(image), _symmetric(common), directions, readings,
        by_landmark, _symmetric(by_rig @ by_rig.T), joint_p_n, joint_R_nb, joint,
        _rms(step.residual[:, ::2][used]), factor, seen.share, system.count, fit.shift_m,
        chi2 + float(delta @ fit.information @ delta),
    )  # fmt: skip


def _separated(moved: Array, fit: _Fit) -> tuple[Array, Array]:
    """Effects on the pose (6, P) by landmark (L, 6, M), and rig; round landmarks add a column, their turns."""
    sigma, used, turns = fit.scene.map_sigma, fit.scene.map_used, len(fit.round)
    by_landmark = np.zeros((sigma.size, POSE))
    by_landmark[used] = moved[:, : len(used)].T
    errors = by_landmark.reshape(*sigma.shape, POSE).transpose(0, 2, 1)
    if not turns:
        return errors, moved[:, len(used) :]
    errors = np.concatenate((errors, np.zeros((len(errors), POSE, 1))), axis=2)
    for k, (mark, _) in enumerate(fit.round):
        errors[mark, :, -1] = moved[:, moved.shape[1] - turns + k]
    return errors, moved[:, len(used) : -turns]


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def difference(p_n: Array, R_nb: Array, p0_n: Array, q0_nb: Array) -> Array:
    """x (-) x0 = (p - p0, log(R R0^T)), (6,)."""
    return np.asarray(_difference(*(np.ascontiguousarray(part, dtype=np.float64) for part in (p_n, R_nb, p0_n, q0_nb))))


@njit(cache=True)
def _difference(p_n: Array, R_nb: Array, p0_n: Array, q0_nb: Array) -> Array:
    off, turn = np.empty(6), so3.quat_log(so3.multiply(so3.from_matrix(R_nb), so3.conjugate(q0_nb)))
    for k in range(3):
        off[k], off[3 + k] = p_n[k] - p0_n[k], turn[k]
    return off


def retract(p_n: Array, q_nb: Array, step: Array) -> Pose:
    """x (+) step = (p + dp, exp(dtheta) R)."""
    return p_n + step[:3], so3.matrix(so3.quat_exp(step[3:])) @ so3.matrix(q_nb)


def combine(
    prior: Prior, p_n: Array, R_nb: Array, covariance: Array, directions: Array | None = None, readings: Array | None = None
) -> tuple[Array, Array, Array]:
    """Prior and measurement fused: p_n, R_nb, covariance (6, 6); directions D, readings y as LandmarkFix.

    P = (P_0^-1 + C^-1)^-1,  x = x0 (+) P C^-1 (z (-) x0)
    P = P_0 - K D P_0,  x = x0 (+) K (D (z (-) x0) + y),  K = P_0 D^T (D (P_0 + C) D^T)^-1        along D
    """
    P0, q0 = np.asarray(prior.covariance, dtype=float), np.asarray(prior.q_nb_wxyz, dtype=float)
    off = difference(p_n, R_nb, prior.p_n, q0)
    if directions is None or readings is None:
        gain = np.linalg.solve(P0 + covariance, P0).T
        step = gain @ off
    else:
        along = np.linalg.solve(directions @ (P0 + covariance) @ directions.T, directions @ P0).T
        gain, step = along @ directions, along @ (directions @ off + readings)
    return *retract(prior.p_n, q0, step), _symmetric(P0 - gain @ P0)
