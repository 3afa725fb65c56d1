"""Looks at worlds of look-alikes in numbers: identification alone, from regions as the stereo stage would measure them."""

from typing import Final

import numpy as np

from benchmarks.identification.batch import Batch, Case, Job, case_of, counted
from benchmarks.identification.worlds import RIG, SCALE_SIGMA, World, draw_world, observe
from vision.identify.catalogue import catalogue
from vision.identify.identify import IdentifyConfig, identify

LOOKS: Final = 100  # of one world
_CONFIG: Final = IdentifyConfig()


def look(job: Job) -> Batch:
    """Some worlds."""
    _, layout, prior_m, count, seed, _ = job
    fixes = list[Case]()
    for first in range(0, count, LOOKS):
        world = world_of(layout, prior_m, seed, first)
        found = (judge(prior_m, seed, number, world) for number in range(first, min(first + LOOKS, count)))
        fixes += [one for one in found if one is not None]
    return counted(job, fixes)


def world_of(layout: str, prior_m: float, seed: int, first: int) -> World:
    """The world of the looks from `first` on."""
    return draw_world(np.random.default_rng([seed, int(prior_m), first, 1]), grid=layout == "grid")


def judge(prior_m: float, seed: int, number: int, world: World) -> Case | None:
    """A look with three regions or more, of its own random numbers; None without a fix."""
    rng = np.random.default_rng([seed, int(prior_m), number])
    while len((frame := observe(rng, world, prior_m)).sightings) < 3:
        pass
    landmarks = catalogue(world.map.near(frame.prior.p_n[0], frame.prior.p_n[1], 4.0 * prior_m + 70.0))
    found = identify(frame.sightings, landmarks, frame.prior, RIG, SCALE_SIGMA, _CONFIG)
    if found.position_posterior < _CONFIG.fix_posterior:
        return None
    named = [(landmarks.ids[found.landmark[k]], frame.truth[k]) for k in np.flatnonzero(found.accepted)]
    wrong = tuple(f"{name} for {truth or 'an unmapped one'}" for name, truth in named if name != truth)
    error = frame.p_n - frame.prior.moved(found.x)[0]
    return case_of(number, error, found.covariance[:3, :3], len(named), wrong, 1.0 - found.position_posterior)
