"""Identification judged frame by frame in worlds of look-alikes, beside the most similar landmark alone (thesis, eq. 5.5).

Wrong fix: off by more than 3 m and outside its 99.99 % ellipsoid. Wrong identity: another landmark, or none.
"""

import msgspec
import numpy as np

from tests.vision.identify.look_alikes import RIG, Conditions, Frame, draw_error, draw_pose, draw_world, observe
from vision.identify.catalogue import Catalogue, catalogue
from vision.identify.identify import Identification, IdentifyConfig, identify
from vision.identify.likelihood import similarities

INSIDE_9999 = 21.108  # chi-square of 3
OFF_M = 3.0
FRAMES_PER_WORLD = 10
CONFIG = IdentifyConfig()


class Outcome(msgspec.Struct, frozen=True):
    """One frame of at least 3 regions."""

    regions: int
    fixed: bool
    wrong_fix: bool
    identified: int
    wrong: int
    alone_identified: int
    alone_wrong: int
    posterior: tuple[float, ...]  # of the most probable landmark of each region
    right: tuple[bool, ...]


def run(conditions: Conditions, frames: int, seed: int) -> list[Outcome]:
    """Frames with at least 3 regions."""
    rng, outcomes, k = np.random.default_rng(seed), list[Outcome](), 0
    world = draw_world(rng, conditions)
    while len(outcomes) < frames:
        if (k := k + 1) % FRAMES_PER_WORLD == 0:
            world = draw_world(rng, conditions)
        p_n, q_nb = draw_pose(rng, conditions)
        frame = observe(rng, world, p_n, q_nb, draw_error(rng, conditions), conditions)
        if len(frame.sightings) >= 3:
            near = world.map.near(frame.prior.p_n[0], frame.prior.p_n[1], 4.0 * conditions.prior_sigma_m + 70.0)
            outcomes.append(judge(frame, catalogue(near)))
    return outcomes


def judge(frame: Frame, landmarks: Catalogue) -> Outcome:
    found = identify(frame.sightings, landmarks, frame.prior, RIG, frame.scale_sigma, CONFIG)
    fixed = found.position_posterior >= CONFIG.fix_posterior
    named = [landmarks.ids[k] if k >= 0 else None for k in found.landmark]
    right = [name == truth for name, truth in zip(named, frame.truth, strict=True)]
    identified = found.accepted & fixed
    is_landmark = [k >= 0 for k in found.landmark]
    alone = similarity_alone(frame, landmarks)
    alone_right = [name == truth for name, truth in zip(alone, frame.truth, strict=True) if name]
    return Outcome(
        regions=len(right),
        fixed=fixed,
        wrong_fix=fixed and is_wrong(frame, found),
        identified=int(identified.sum()),
        wrong=int((identified & ~np.array(right)).sum()),
        alone_identified=len(alone_right),
        alone_wrong=alone_right.count(False),
        posterior=tuple(float(p) for p, k in zip(found.posterior, is_landmark, strict=True) if k),
        right=tuple(r for r, k in zip(right, is_landmark, strict=True) if k),
    )


def is_wrong(frame: Frame, found: Identification) -> bool:
    e = frame.p_n - frame.prior.moved(found.x)[0]
    return bool(np.linalg.norm(e) > OFF_M and e @ np.linalg.solve(found.covariance[:3, :3], e) > INSIDE_9999)


def similarity_alone(frame: Frame, landmarks: Catalogue) -> list[str | None]:
    """Identity of each region by similarity >= 75 %."""
    like = similarities(frame.sightings, landmarks, np.ones((len(frame.sightings), len(landmarks.ids))))
    arm = np.array([s.arm_n for s in frame.sightings])
    position = landmarks.position_n[None] - arm[:, None]  # of the body, if region i were landmark j
    sigma = np.sqrt(np.diag(frame.prior.covariance)[:3])
    like[(((position - frame.prior.p_n) / sigma) ** 2).sum(axis=-1) > INSIDE_9999] = 0.0
    if not like.size:
        return [None] * len(arm)
    best = like.argmax(axis=1)
    known = like.max(axis=1) >= CONFIG.min_similarity
    return [landmarks.ids[j] if k else None for j, k in zip(best, known, strict=True)]
