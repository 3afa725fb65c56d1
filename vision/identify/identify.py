"""Landmark of each region.

Candidates by similarity; identified where the joint posterior reaches `accept_posterior`, else open.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.identify.assignment import SCALE, STATES, Expected, Hypotheses, search
from vision.identify.catalogue import Assumptions, Catalogue, Sighting
from vision.identify.likelihood import options, similarities

NONE = -1  # not a landmark of the map


class IdentifyConfig(msgspec.Struct, frozen=True):
    """accept_posterior: of an identity; fix_posterior: of the position; breadth: joint hypotheses followed."""

    min_similarity: float = 0.75
    accept_posterior: float = 0.999
    fix_posterior: float = 0.9999
    breadth: int = 300
    assumptions: Assumptions = Assumptions()


@dataclass(frozen=True, slots=True)
class Identification:
    """M regions; indices into the catalogue, NONE for none.

    landmark, posterior: most probable identity; accepted: identified
    best, similarity: most similar candidate and its eq. 5.5 (NONE, 0);  own_similarity: of `landmark`; candidates: number
    joint_posterior: all accepted are right;  position_posterior: at least one is, none is another landmark
    x (7,), covariance (7, 7): error of the prior (position, attitude, log scale) then.
    """

    landmark: NDArray[np.int64]
    posterior: Array
    accepted: NDArray[np.bool_]
    best: NDArray[np.int64]
    similarity: Array
    own_similarity: Array
    candidates: NDArray[np.int64]
    joint_posterior: float
    position_posterior: float
    x: Array
    covariance: Array


def identify(
    sightings: Sequence[Sighting], landmarks: Catalogue, prior: Prior, rig: StereoRig, scale_sigma: float,
    config: IdentifyConfig | None = None, *, metric: bool = True,
) -> Identification:  # fmt: skip
    """Identify regions as landmarks near the prior.

    scale_sigma: common relative depth error; metric=False: one camera.
    """
    config = config or IdentifyConfig()
    several = list(sightings)
    covariance = np.zeros((STATES, STATES))
    covariance[:SCALE, :SCALE] = prior.covariance
    covariance[SCALE, SCALE] = scale_sigma**2
    scale = np.ones((len(several), len(landmarks.ids)))
    if not metric and several:
        covariance = covariance + _from_height(prior, float(np.mean([s.arm_n[2] for s in several])))
        scale = _roof_scale(several, landmarks, prior)
    like = _likeness(several, landmarks, scale, float(np.sqrt(covariance[SCALE, SCALE])))
    candidate = like >= config.min_similarity
    choice = options(several, landmarks, prior.p_n, covariance, candidate, scale, config.assumptions)
    found = search(choice, _expected(several, landmarks, prior, rig, config.assumptions), covariance, config.breadth)
    landmark, posterior = _marginals(choice.landmark[found.option], found.probability, len(landmarks.ids))
    accepted, joint, agree = _accept(choice.landmark[found.option], found, landmark, posterior, config.accept_posterior)
    position = _position_posterior(choice.landmark[found.option][:, accepted], found.probability, landmark[accepted])
    x, cov = _moments(found, agree)
    possible = np.zeros_like(candidate)
    region = np.repeat(np.arange(len(several)), np.diff(choice.start))
    is_landmark = choice.landmark >= 0
    possible[region[is_landmark], choice.landmark[is_landmark]] = True
    ranked = np.where(possible, like, 0.0) if len(landmarks.ids) else np.zeros((len(several), 1))
    own = np.where(landmark == NONE, 0.0, ranked[np.arange(len(several)), np.maximum(landmark, 0)])
    return Identification(
        landmark, posterior, accepted, np.where(ranked.max(axis=1) > 0.0, ranked.argmax(axis=1), NONE), ranked.max(axis=1),
        own, possible.sum(axis=1), joint, position, x, cov,
    )  # fmt: skip


def _roof_scale(sightings: list[Sighting], landmarks: Catalogue, prior: Prior) -> Array:
    down = np.array([max(s.arm_n[2], 1e-3) for s in sightings]).reshape(-1, 1)
    return np.asarray(np.maximum((landmarks.position_n[None, :, 2] - prior.p_n[2]) / down, 1e-3))


def _from_height(prior: Prior, down: float) -> Array:
    """One camera's scale from the prior's height: s = -dp_d / down, in (7, 7)."""
    covariance = np.zeros((STATES, STATES))
    covariance[SCALE, :SCALE] = covariance[:SCALE, SCALE] = -prior.covariance[2] / down
    covariance[SCALE, SCALE] = prior.covariance[2, 2] / down**2
    return covariance


def _likeness(sightings: list[Sighting], landmarks: Catalogue, scale: Array, sigma: float) -> Array:
    like = similarities(sightings, landmarks, _fitted(sightings, landmarks, scale, sigma))
    for i, sighting in enumerate(sightings):
        if sighting.partial is not None:
            like[i] = sighting.partial.similarity(scale[i], sigma)
    return like


def _fitted(sightings: list[Sighting], landmarks: Catalogue, scale: Array, sigma: float) -> Array:
    size = np.array([s.size_m2 for s in sightings]).reshape(-1, 1) * scale**2
    wanted = 0.5 * np.log(landmarks.description[None, :, 0] / size)
    return np.asarray(scale * np.exp(np.clip(wanted, -3.0 * sigma, 3.0 * sigma)))


def _expected(sightings: list[Sighting], landmarks: Catalogue, prior: Prior, rig: StereoRig, b: Assumptions) -> Expected:
    """x_c = R_cb (R_bn exp(-dtheta) (l - p - dp) - p_bc)."""
    R_cn = (prior.R_nb @ rig.R_bc).T
    v = landmarks.position_n - prior.p_n
    A = np.zeros((len(v), 3, STATES))
    A[:, :, :3] = -R_cn
    A[:, :, 3:6] = R_cn @ np.array([so3.skew(row) for row in v]).reshape(-1, 3, 3)
    p_c = rig.R_bc.T @ rig.p_bc
    position = np.array([R_cn @ s.arm_n - p_c if s.now else np.full(3, np.nan) for s in sightings]).reshape(-1, 3)
    there = b.found_fraction * (1.0 - b.gone_fraction)
    return Expected(
        x_c=v @ R_cn.T - p_c,
        A=A,
        radius_m=landmarks.radius_m,
        log_missed=np.full(len(v), np.log1p(-there)),
        log_gone=float(np.log(b.gone_fraction)),
        view=view_of(rig),
        position_c=position,
    )


def view_of(rig: StereoRig) -> Array:
    """Limits left, right, top, bottom of x/z, y/z of the left image's inscribed rectangle."""
    c = rig.left
    u, v = np.linspace(0.0, c.width - 1.0, 9), np.linspace(0.0, c.height - 1.0, 9)
    edge = np.concatenate([
        np.column_stack([np.full(9, u[0]), v]), np.column_stack([np.full(9, u[-1]), v]),
        np.column_stack([u, np.full(9, v[0])]), np.column_stack([u, np.full(9, v[-1])]),
    ])  # fmt: skip
    left, right, top, bottom = c.undistort(edge).reshape(4, 9, 2)
    return np.array([left[:, 0].max(), right[:, 0].min(), top[:, 1].max(), bottom[:, 1].min()])


def _marginals(landmark: NDArray[np.int64], probability: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    best, posterior = np.full(landmark.shape[1], NONE), np.zeros(landmark.shape[1])
    for i in range(landmark.shape[1]):
        mass = np.bincount(landmark[:, i] + 1, probability, count + 1)
        best[i] = int(mass.argmax()) - 1
        posterior[i] = mass.max()
    return best, posterior


def _accept(
    landmark: NDArray[np.int64], found: Hypotheses, best: NDArray[np.int64], posterior: Array, threshold: float
) -> tuple[NDArray[np.bool_], float, NDArray[np.bool_]]:
    accepted = (posterior >= threshold) & (best != NONE)
    while True:
        agree = np.all(landmark[:, accepted] == best[accepted], axis=1)
        joint = float(found.probability[agree].sum())
        if joint >= threshold or not accepted.any():
            return accepted, joint if accepted.any() else 0.0, agree
        accepted[np.flatnonzero(accepted)[posterior[accepted].argmin()]] = False


def _position_posterior(landmark: NDArray[np.int64], probability: Array, accepted: NDArray[np.int64]) -> float:
    same, contrary = landmark == accepted, (landmark != accepted) & (landmark != NONE)
    return float(probability[same.any(axis=1) & ~contrary.any(axis=1)].sum())


def _moments(found: Hypotheses, agree: NDArray[np.bool_]) -> tuple[Array, Array]:
    w = found.probability[agree] / found.probability[agree].sum()
    mean = w @ found.x[agree]
    e = found.x[agree] - mean
    return mean, np.asarray(np.einsum("h,hab->ab", w, found.covariance[agree]) + np.einsum("h,ha,hb->ab", w, e, e))
