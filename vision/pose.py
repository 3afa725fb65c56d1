"""Six-degree-of-freedom pose from identified landmarks: Gauss-Newton on the outlines' edges in one or two pictures.

    r = H dx + N nu + e,     dx = (dp_n, dtheta_n),   R_true = exp(dtheta) R          (thesis eq. 3.84-3.92, Table 1; Lowe 1991)

r: offset and tilt of every edge in every picture; nu: errors of map and rig with their own priors, estimated along, so that
landmarks whose map errors are independent are weighed rightly. The prior picks the mode and is where the equations are
linearised, but what is reported is the information of the pictures alone: the measurement z which, fused with this prior, gives
the joint optimum,

    z = x0 (+) (delta + C Lambda_0 delta),   delta = x_joint (-) x0,   C = (H^T V^-1 H)^-1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.landmarks import Landmark
from models.messages import Array
from vision import outline
from vision.edge_lines import EdgeLines, compress, fit_lines
from vision.edge_noise import NoiseConfig, line_covariance
from vision.identify import Prior
from vision.sensitivity import Eye, Samples, edge_gaps, eyes, map_rows, pose_rows, rig_rows, sample_edges, view
from vision.visibility import Kind, MapError, ModelEdges, visible_edges

Image = NDArray[np.uint8]
Pose = tuple[Array, Array]  # p_n (3,), R_nb (3, 3)
_WIDEST_M, _WIDEST_RAD = 200.0, 2.0  # standard deviations are limited to these: still "given", and worth nothing
_SEEN_GAP_PX = 0.2  # walls narrower than this are not fitted as such
_GAP_FACTOR = 4.0  # real walls are not two clean steps: measured over predicted variance of their offsets
_WIDEST_OPEN_PX = 0.7  # an edge whose place is left this open by its gap says nothing
_CLIPPED_PX = 0.25  # how far saturation may shift an edge
_WORTHLESS = 1e-3  # share of the prior's information below which a direction of the pictures is not believed to say anything


class PoseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How outlines are looked for and when a fit is believed."""

    windows_px: tuple[int, ...] = (16, 8)  # half widths of the searches, one after the other
    farthest_px: tuple[float, ...] = (2.5, 1.5)  # how far edges may be off in the sub-pixel fits, one after the other
    fit_half_px: Annotated[int, Meta(ge=3, description="half width of the sub-pixel fit")] = 5
    spacing_px: Annotated[float, Meta(gt=0, description="distance of points along an edge")] = 3.0
    most_points: Annotated[int, Meta(ge=4, description="on one edge")] = 24
    least_points: Annotated[int, Meta(ge=3, description="that make an edge")] = 4
    least_found: Annotated[float, Meta(ge=0, le=1, description="share of the outline in view that must be found")] = 0.4
    freedom: Annotated[float, Meta(gt=0, description="weight of the expected residuals in the variance factor, in numbers")] = (
        16.0
    )
    worst_factor: Annotated[float, Meta(gt=1, description="variance factor above which the fit is not believed")] = 8.0
    edge_gate: Annotated[float, Meta(gt=0, description="chi-square (4) above which an edge is left out")] = 22.0
    noise: NoiseConfig = NoiseConfig()


@dataclass(frozen=True, slots=True)
class NoPose:
    """Why there is no pose."""

    reason: str  # too_few_edges | not_found | residual | diverged | ambiguous | no_picture
    detail: str = ""


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose from the pictures alone, and what it comes to with the prior.

    p_n, R_nb: the measurement z; covariance (6, 6): its error that is new in every picture; covariance_common (6, 6): the part
    that map and rig repeat; both order x y z rx ry rz in NED axes. joint_*: posterior of prior and pictures. residual_px: RMS of
    the edges' offsets; factor: measured over expected variance of the residuals; found: share of the outline in view that was
    found; edges: lines used, over all pictures; shift_m: (L, 4) estimated map errors (MapError).
    """

    p_n: Array
    R_nb: Array
    covariance: Array
    covariance_common: Array
    joint_p_n: Array
    joint_R_nb: Array
    joint_covariance: Array
    residual_px: float
    factor: float
    found: float
    edges: int
    shift_m: Array


@dataclass(frozen=True, slots=True)
class _Round:
    """What one look at the pictures gave: lines (K pictures) of the same samples at a pose."""

    edges: ModelEdges
    samples: Samples
    lines: list[EdgeLines]
    opened: Array  # (K, E) variance of the offsets that narrow walls add, px^2
    H: Array  # (K, E, 2, 6)
    N: Array  # (K, E, 2, P) by the unit-variance nuisances
    found: float


class _Fit:
    """State of one estimation: pose, map errors, and what does not change."""

    def __init__(
        self, rig: StereoRig, views: Sequence[Image | None], landmarks: Sequence[Landmark], start: Pose, prior: Prior,
        config: PoseConfig, shift_m: Array | None,
    ) -> None:  # fmt: skip
        self.rig, self.landmarks, self.config = rig, landmarks, config
        both = zip(eyes(rig), views, strict=False)
        self.eyes: list[tuple[Eye, Image]] = [(eye, _channels(image)) for eye, image in both if image is not None]
        self.p_n, self.R_nb = np.array(start[0], dtype=float), np.array(start[1], dtype=float)
        self.p0, self.q0 = np.asarray(prior.p_n, dtype=float), np.asarray(prior.q_nb_wxyz, dtype=float)
        self.information = np.linalg.inv(prior.covariance)
        sigmas = np.zeros((len(landmarks), len(MapError)))
        for row, mark in zip(sigmas, landmarks, strict=True):
            row[:] = mark.sigma_m, mark.sigma_m, mark.height_sigma_m if mark.height_m > 0.0 else 0.0, mark.outline_sigma_m
        self.map_sigma = sigmas
        self.map_used = np.flatnonzero(sigmas.ravel() > 0.0)
        self.map_shift = np.zeros_like(sigmas) if shift_m is None else np.where(sigmas > 0.0, shift_m, 0.0)
        self.roots = [_root(c) for c in (rig.covariance_bc, rig.covariance_rc, rig.left.covariance, rig.right.covariance)]

    def delta(self) -> Array:
        """x (-) x0: how far the pose is from the prior's, (6,)."""
        turn = so3.quat_log(so3.multiply(so3.from_matrix(self.R_nb), so3.conjugate(self.q0)))
        return np.concatenate((self.p_n - self.p0, turn))

    def move(self, step: Array, nuisance: Array) -> None:
        """Retract by a Gauss-Newton step; nuisance: all unit-variance nuisances, as they now are."""
        self.p_n = self.p_n + step[:3]
        self.R_nb = so3.matrix(so3.normalise(so3.from_matrix(so3.matrix(so3.quat_exp(step[3:])) @ self.R_nb)))
        flat = self.map_shift.ravel()
        flat[self.map_used] = nuisance[: len(self.map_used)] * self.map_sigma.ravel()[self.map_used]

    def present(self) -> Array:
        """The unit-variance nuisances that the drawn outlines already contain; those of the rig are 0."""
        mapped = self.map_shift.ravel()[self.map_used] / self.map_sigma.ravel()[self.map_used]
        return np.concatenate((mapped, np.zeros(sum(root.shape[1] for root in self.roots))))

    def edges(self) -> ModelEdges:
        """Visible edges, at the map errors estimated so far."""
        edges = visible_edges(self.landmarks, self.eyes[0][0].pose(self.p_n, self.R_nb)[0])
        shift = self.map_shift[edges.landmark]
        return replace(
            edges,
            start_n=edges.start_n + np.einsum("eij,ej->ei", edges.map_start, shift),
            end_n=edges.end_n + np.einsum("eij,ej->ei", edges.map_end, shift),
        )

    def look(self, half: int, farthest: float = 0.0) -> _Round:
        """Look for the outline from the present pose within half px, or fit its edges not farther off than that, and linearise."""
        config, fine = self.config, farthest > 0.0
        edges = self.edges()
        samples = sample_edges(edges, self.eyes[0][0], self.p_n, self.R_nb, config.spacing_px, config.most_points)
        count = len(edges.kind)
        lines, opened, H, N, seen_points, found_points = [], [], [], [], 0.0, 0.0
        for eye, image in self.eyes:
            seen = view(edges, samples, eye, self.p_n, self.R_nb, self.landmarks)
            usable = seen.usable & ~outline_conflicts(edges, samples, seen.px, seen.normal, eye, self.p_n, self.R_nb, half, fine)
            gap = edge_gaps(edges, samples, seen, eye, self.p_n, self.R_nb)
            if fine:
                usable &= (edges.kind[samples.edge] != Kind.BASE) | (np.abs(gap[samples.edge]) >= half + 1.5)
            else:
                usable &= edges.kind[samples.edge] == Kind.ROOF
            values = outline.profiles(image, seen.px, seen.normal, half, 1.0, 3 if fine else 1, usable)
            roof = edges.kind == Kind.ROOF
            distance, alien = outline.off_roof(values, samples.edge, edges.landmark, roof, usable)
            if fine:
                usable &= ~alien[samples.edge]
                grey, clipped = outline.along_contrast(values, samples.edge, count, usable)
                double = np.where(roof & (gap > _SEEN_GAP_PX) & (gap < half + 1.5), gap, 0.0)
                offsets, _, variance = outline.fit(grey, samples.edge, double, farthest, 1.0, usable)
                variance = _GAP_FACTOR * variance + np.where(roof & (gap > 0.0) & (gap <= _SEEN_GAP_PX), _SEEN_GAP_PX**2, 0.0)
                offsets[(variance > _WIDEST_OPEN_PX**2)[samples.edge]] = np.nan
                opened.append(variance + np.where(clipped, _CLIPPED_PX**2, 0.0))
            else:
                offsets = outline.search(distance, samples.edge, count, 1.0, usable)
                opened.append(np.zeros(count))
            line = fit_lines(offsets, samples.t, samples.edge, count, config.least_points)
            lines.append(line)
            seen_points += float(usable.sum())
            found_points += float(line.points.sum())
            H.append(compress(line.gain, pose_rows(seen, samples, eye, self.p_n, self.R_nb), samples.edge, count))
            mapped = map_rows(seen, samples, edges, eye, self.p_n, self.R_nb, len(self.landmarks))
            rows = [(mapped * self.map_sigma.ravel())[:, self.map_used]]
            by_bc, by_rc, own = rig_rows(seen, eye, self.rig)
            rows += [by_bc @ self.roots[0] if self.roots[0].size else np.empty((len(own), 0))]
            rows += [by_rc @ self.roots[1] if self.roots[1].size else np.empty((len(own), 0))]
            for right, root in ((False, self.roots[2]), (True, self.roots[3])):
                mine = right == eye.right and root.size
                rows.append(own @ root if mine else np.zeros((len(own), root.shape[1])))
            N.append(compress(line.gain, np.nan_to_num(np.hstack(rows)), samples.edge, count))
        return _Round(edges, samples, lines, np.array(opened), np.array(H), np.array(N), found_points / max(seen_points, 1.0))


def _channels(image: Image) -> Image:
    return np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])


def _root(covariance: Array | None) -> Array:
    """L (n, r) with covariance = L L^T; no columns where there is none."""
    if covariance is None:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-14 * max(values[-1], 1e-300)
    root: Array = vectors[:, keep] * np.sqrt(values[keep])
    return root


def outline_conflicts(
    edges: ModelEdges, samples: Samples, px: Array, normal: Array, eye: Eye, p_n: Array, R_nb: Array, half: int, fine: bool
) -> NDArray[np.bool_]:
    """Samples beside which another edge of the model runs through the profile, so that the two cannot be told apart."""
    p_nk, R_nk = eye.pose(p_n, R_nb)
    count = len(edges.kind)
    ends = eye.camera.project((np.concatenate((edges.start_n, edges.end_n)) - p_nk) @ R_nk)
    reach = half + 1.5 if fine else 2.5
    return outline.crossed(px, normal, samples.edge, edges.partner, ends[:count], ends[count:], reach)


def estimate_pose(
    rig: StereoRig, views: Sequence[Image | None], landmarks: Sequence[Landmark], start: Pose, prior: Prior,
    config: PoseConfig | None = None, shift_m: Array | None = None,
) -> PoseEstimate | NoPose:  # fmt: skip
    """Pose of the body from landmarks identified in views (left, right; None = not there), or why there is none.

    start: p_n, R_nb near enough that every outline lies within the first window of its edges; shift_m: (L, 4) what is known
    so far of the map's errors (MapError), as start_from_regions gives it.
    """
    config = config or PoseConfig()
    fit = _Fit(rig, views, landmarks, start, prior, config, shift_m)
    if not fit.eyes:
        return NoPose("no_picture")
    for half in config.windows_px:
        seen = fit.look(half)
        if refusal := _enough(seen, config):
            return refusal
        _robust_step(fit, seen, 1.0)
    for farthest in config.farthest_px:
        seen = fit.look(config.fit_half_px, farthest)
        if refusal := _enough(seen, config):
            return refusal
        if farthest != config.farthest_px[-1]:
            _robust_step(fit, seen, 0.3)
    return _fine_step(fit, seen)


def _enough(seen: _Round, config: PoseConfig) -> NoPose | None:
    number = sum(int(line.found.sum()) for line in seen.lines)
    if number < 3:
        return NoPose("too_few_edges", f"{number} edges found")
    return None if seen.found >= config.least_found else NoPose("not_found", f"{seen.found:.0%} of the outline in view")


def _system(seen: _Round) -> tuple[NDArray[np.bool_], Array, Array, Array]:
    """Mask (E, K, 2) of the lines found, and residuals (E, K, 2), H (E, K, 2, 6), N (E, K, 2, P) with edges first."""
    found = np.array([line.found for line in seen.lines]).T
    z = np.array([line.line for line in seen.lines]).transpose(1, 0, 2)
    return np.repeat(found[:, :, None], 2, axis=2), z, seen.H.transpose(1, 0, 2, 3), seen.N.transpose(1, 0, 2, 3)


def _solve(fit: _Fit, H: Array, N: Array, weight: Array, z: Array) -> tuple[Array, Array, Array]:
    """Joint step of pose and nuisances with their priors; weight (M, M) = R^-1. Returns dx, nuisances, information matrix."""
    A = np.hstack((H, N))
    present = fit.present()
    WA = weight @ A
    omega = A.T @ WA
    eta = WA.T @ (z + N @ present)  # of the nuisances as such, not of their change
    omega[6:, 6:] += np.eye(N.shape[1])
    prior = omega.copy()
    prior[:6, :6] += fit.information
    eta[:6] -= fit.information @ fit.delta()
    solution = np.linalg.solve(prior, eta)
    return solution[:6], solution[6:], omega


def _robust_step(fit: _Fit, seen: _Round, common_px: float) -> None:
    """Iteratively reweighted step: an edge caught by a shadow or a neighbour is an outlier as a whole."""
    mask, z, H, N = _system(seen)
    unit = np.array([line.unit for line in seen.lines]).transpose(1, 0, 2, 3)
    block = (0.5 * unit + np.diag([1.0, 0.5])) * common_px**2
    block[:, :, 0, 0] += seen.opened.T
    inverse = np.linalg.inv(block)
    inverse[~mask[:, :, 0]] = 0.0
    count = mask.shape[0] * mask.shape[1]
    flat_z, flat_H, flat_N = z.reshape(-1), H.reshape(2 * count, -1), N.reshape(2 * count, -1)
    inverse = inverse.reshape(count, 2, 2)
    used = mask[:, :, 0].ravel()
    robust = np.ones(count)
    step, nuisance = np.zeros(6), fit.present()
    for k in range(6):
        W = np.zeros((count, 2, count, 2))
        W[np.arange(count), :, np.arange(count), :] = inverse * robust[:, None, None]
        step, nuisance, _ = _solve(fit, flat_H, flat_N, W.reshape(2 * count, 2 * count), flat_z)
        left = (flat_z - flat_H @ step - flat_N @ (nuisance - fit.present())).reshape(count, 2)
        distance = np.sqrt(np.einsum("ci,cij,cj->c", left, inverse, left))
        scale = max(1.4826 * float(np.median(distance[used])), 0.5)
        ratio = distance / scale
        robust = 1.0 / np.maximum(ratio, 1.0) if k < 3 else np.where(ratio < 5.0, (1.0 - (ratio / 5.0) ** 2) ** 2, 0.0)
    fit.move(step, nuisance)


def _fine_step(fit: _Fit, seen: _Round) -> PoseEstimate | NoPose:
    """Step with the full covariance of the lines; edges that do not fit are left out one after the other."""
    config = fit.config
    mask, z, H, N = _system(seen)
    V = line_covariance(seen.lines, seen.samples.edge, seen.edges.kind, seen.opened, config.noise)
    pictures = mask.shape[1]
    kept = mask.copy()
    dropped = 0
    while True:
        rows = np.flatnonzero(kept.ravel())
        if len(rows) < 8:
            return NoPose("too_few_edges", f"{len(rows) // 2} edges fit")
        R = _block_matrix(V)[np.ix_(rows, rows)]
        fz, fH, fN = z.reshape(-1)[rows], H.reshape(-1, 6)[rows], N.reshape(-1, N.shape[3])[rows]
        W = np.linalg.inv(R)
        step, nuisance, omega = _solve(fit, fH, fN, W, fz)
        left = fz - fH @ step - fN @ (nuisance - fit.present())
        worst, edge = _worst_edge(left, W, rows, 2 * pictures, len(kept))
        if worst < config.edge_gate or dropped >= 0.25 * len(kept):
            break
        kept[edge] = False
        dropped += 1
    return _report(fit, seen, _Linear(fz, fH, fN, R, W, omega, step, nuisance, left))


def _block_matrix(V: Array) -> Array:
    """(M, M) of (E, K, 2, K, 2): edges do not disturb each other."""
    edges, size = V.shape[0], V.shape[1] * 2
    full = np.zeros((edges, size, edges, size))
    full[np.arange(edges), :, np.arange(edges), :] = V.reshape(edges, size, size)
    return full.reshape(edges * size, edges * size)


def _worst_edge(left: Array, W: Array, rows: NDArray[np.intp], per_edge: int, edges: int) -> tuple[float, int]:
    distance = np.zeros(edges)
    np.add.at(distance, rows // per_edge, left * (W @ left))
    edge = int(np.argmax(distance))
    return float(distance[edge]), edge


@dataclass(frozen=True, slots=True)
class _Linear:
    """The last linear system: residuals z (M,), H (M, 6), N (M, P), noise R and W = R^-1, information without the pose's prior."""

    z: Array
    H: Array
    N: Array
    R: Array
    W: Array
    omega: Array
    step: Array
    nuisance: Array
    left: Array


def _report(fit: _Fit, seen: _Round, at: _Linear) -> PoseEstimate | NoPose:
    config = fit.config
    freedom = max(len(at.z) - 6, 1)
    chi2 = float(at.left @ at.W @ at.left + at.nuisance @ at.nuisance)
    factor = (config.freedom + chi2) / (config.freedom + freedom)
    fit.move(at.step, at.nuisance)
    if factor > config.worst_factor:
        return NoPose("residual", f"variance factor {factor:.1f}")
    if not np.isfinite(at.step).all() or np.abs(at.step[3:]).max() > 0.2:
        return NoPose("diverged")

    floor = np.array([_WIDEST_M**-2] * 3 + [_WIDEST_RAD**-2] * 3)
    omega = at.omega / factor
    omega[6:, 6:] = at.omega[6:, 6:] / factor + (1.0 - 1.0 / factor) * np.eye(len(omega) - 6)
    limited = omega.copy()
    limited[range(6), range(6)] += floor
    inverse = np.linalg.inv(limited)
    gain = inverse[:6] @ np.hstack((at.H, at.N)).T @ at.W / factor
    image = gain @ (factor * at.R) @ gain.T + (inverse[:6, :6] * floor) @ inverse[:6, :6]
    by_nuisance = gain @ at.N
    common = by_nuisance @ by_nuisance.T
    total = image + common
    joint = np.linalg.inv(fit.information + np.linalg.inv(total))
    p_n, R_nb = _pictures_alone(fit, total)
    lines = at.left[0::2]
    return PoseEstimate(
        p_n, R_nb, _symmetric(image), _symmetric(common), fit.p_n, fit.R_nb, _symmetric(joint),
        float(np.sqrt(np.mean(lines**2))), factor, seen.found, len(at.z) // 2, fit.map_shift.copy(),
    )  # fmt: skip


def _pictures_alone(fit: _Fit, covariance: Array) -> Pose:
    """z = x0 (+) (delta + C Lambda_0 delta); directions worth nothing beside the prior keep delta alone."""
    delta = fit.delta()
    low = np.linalg.cholesky(fit.information)
    values, vectors = np.linalg.eigh(low.T @ covariance @ low)  # C in units of the prior's
    values = np.where(values < 1.0 / _WORTHLESS, values, 0.0)
    white = vectors @ (values * (vectors.T @ (low.T @ delta)))
    step = delta + np.linalg.solve(low.T, white)
    return fit.p0 + step[:3], so3.matrix(so3.quat_exp(step[3:])) @ so3.matrix(fit.q0)


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def combine(prior: Prior, p_n: Array, R_nb: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """Prior and a measurement fused: p_n, R_nb and covariance (6, 6) of the posterior.

    P = (P_0^-1 + C^-1)^-1,  x = x0 (+) P C^-1 (z (-) x0)
    """
    P0, q0 = np.asarray(prior.covariance), np.asarray(prior.q_nb_wxyz, dtype=float)
    turn = so3.quat_log(so3.multiply(so3.from_matrix(R_nb), so3.conjugate(q0)))
    innovation = np.concatenate((p_n - prior.p_n, turn))
    gain = np.linalg.solve(P0 + covariance, P0).T
    step = gain @ innovation
    return prior.p_n + step[:3], so3.matrix(so3.quat_exp(step[3:])) @ so3.matrix(q0), _symmetric(P0 - gain @ P0)
