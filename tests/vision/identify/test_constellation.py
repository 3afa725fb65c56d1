from dataclasses import replace

import numpy as np
import pytest

from models.prior import Prior
from tests.vision.identify.judged import CONFIG
from tests.vision.identify.look_alikes import RIG, SCALE_SIGMA, Conditions, draw_error, draw_pose, draw_world, observe
from vision.identify.catalogue import Sighting, catalogue
from vision.identify.constellation import Constellation, MemoryConfig
from vision.identify.identify import identify
from vision.identify.partial import Partial

SECOND = 1_000_000_000
PRIOR = Prior(np.array([0.0, 0.0, -60.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.diag([25.0] * 3 + [1e-3] * 3))


def sighting(north: float, east: float, size: float = 80.0) -> Sighting:
    side = size**0.5
    return Sighting(
        np.array([north, east, 57.0]), 0.01, 0.01 * np.eye(3), size, side, side, 1.0, 1e-4 * np.eye(2), 0.01, 0.0, 0.01
    )  # fmt: skip


def moved(prior: Prior, north: float, growth: float = 1.0) -> Prior:
    return Prior(prior.p_n + np.array([north, 0.0, 0.0]), prior.q_nb_wxyz, growth * prior.covariance)


def test_a_region_out_of_view_is_remembered_where_it_was() -> None:
    memory, seen = Constellation(), [sighting(10.0, -5.0)]
    memory.hold(seen, [], 0, PRIOR)
    later = moved(PRIOR, 30.0, 1.1)
    (old,) = memory.recall([], SECOND, later)
    np.testing.assert_allclose(later.p_n + old.moved_n + old.arm_n, PRIOR.p_n + seen[0].arm_n)
    np.testing.assert_array_equal(old.arm_n, seen[0].arm_n)  # the lever of the attitude's error then
    assert not old.now
    np.testing.assert_allclose(np.diag(old.covariance_n) - 0.01, 0.1 * 25.0 + 0.05**2)  # by what the prior drifted


def test_a_region_in_view_again_stands_there_once() -> None:
    memory = Constellation()
    memory.hold([sighting(10.0, -5.0), sighting(20.0, 8.0)], [], 0, PRIOR)
    again = replace(sighting(4.5, -5.4), size_m2=84.0)
    remembered = memory.recall([again], SECOND, moved(PRIOR, 5.0))
    assert [r.arm_n[0] for r in remembered] == [20.0]
    other_size = sighting(4.5, -5.4, size=200.0)
    assert len(memory.recall([other_size], SECOND, moved(PRIOR, 5.0))) == 2


def test_what_is_old_or_from_before_another_fix_is_forgotten() -> None:
    memory = Constellation(MemoryConfig(memory_s=2.0))
    memory.hold([sighting(0.0, 0.0)], [], 0, PRIOR)
    assert len(memory.recall([], SECOND, PRIOR)) == 1
    assert not memory.recall([], 3 * SECOND, PRIOR)
    memory.hold([sighting(0.0, 0.0)], [], 0, PRIOR)
    assert not memory.recall([], SECOND, moved(PRIOR, 0.0, growth=0.5))  # surer than before: something was fused
    memory.hold([sighting(0.0, 0.0)], [], 5 * SECOND, PRIOR)
    assert not memory.recall([], 4 * SECOND, PRIOR)  # time went back
    memory.hold([sighting(0.0, 0.0)], [], 0, PRIOR)
    memory.clear()
    assert not memory.recall([], SECOND, PRIOR)


def test_what_the_border_cuts_off_is_not_remembered_but_stands_for_what_was() -> None:
    part = Partial(np.zeros(3), np.zeros(4), np.ones(4, np.bool_), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
    cut, memory = replace(sighting(4.5, -5.4, size=30.0), partial=part), Constellation()
    memory.hold([sighting(10.0, -5.0)], [], 0, PRIOR)
    assert not memory.recall([cut], SECOND, moved(PRIOR, 5.0))  # the same house, of which less is in view
    memory.hold([cut], [], SECOND, PRIOR)
    assert not memory.recall([], 2 * SECOND, PRIOR)


def test_there_is_room_for_the_newest() -> None:
    memory = Constellation(MemoryConfig(most=3))
    first = [sighting(20.0 * k, 0.0, 60.0 + k) for k in range(2)]
    memory.hold(first, [], 0, PRIOR)
    remembered = memory.recall([], SECOND, PRIOR)
    memory.hold([sighting(20.0 * k, 50.0, 70.0 + k) for k in range(2)], remembered, SECOND, PRIOR)
    assert [r.size_m2 for r in memory.recall([], 2 * SECOND, PRIOR)] == pytest.approx([70.0, 71.0, 60.0])


@pytest.mark.parametrize("seed", [1, 3, 7])
def test_images_that_say_nothing_alone_together_say_where(seed: int) -> None:
    """Two regions an image are open each time; remembered ones decide."""
    rng, c = np.random.default_rng(seed), Conditions("grid", 5.0, unmapped=0.0, gone=0.0, found=1.0, bad=0.0)
    world = draw_world(rng, c)
    p_n, q_nb = draw_pose(rng, c)
    error, memory, alone, together = draw_error(rng, c), Constellation(), [], []
    for image in range(3):
        frame = observe(rng, world, p_n + image * np.array([25.0, 0.0, 0.0]), q_nb, error, c)
        two = frame.sightings[:2]
        near = catalogue(world.map.near(frame.prior.p_n[0], frame.prior.p_n[1], 110.0))
        remembered = memory.recall(two, image * SECOND, frame.prior)
        alone.append(identify(two, near, frame.prior, RIG, SCALE_SIGMA, CONFIG).position_posterior)
        found = identify([*two, *remembered], near, frame.prior, RIG, SCALE_SIGMA, CONFIG)
        together.append(found.position_posterior)
        memory.hold(two, remembered, image * SECOND, frame.prior)
    assert max(alone) < CONFIG.fix_posterior < together[-1]
    assert np.linalg.norm(frame.p_n - frame.prior.moved(found.x)[0]) < 5.0
