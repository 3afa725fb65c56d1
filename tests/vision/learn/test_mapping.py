"""Roofs seen from many places: where they are, how surely, and which look belongs to which."""

import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from models.maps import outline as polygon
from models.messages import Array
from models.prior import Prior
from vision.describe.measure import Measured
from vision.describe.regions import Region
from vision.learn.mapping import Mapper, MappingConfig, Observation, observe
from vision.learn.median_outline import merged_outline
from vision.learn.tracks import KeepConfig, learned
from vision.synthetic.rigs import draw_rig, make_rig

HEIGHT_M = 70.0
CONFIG = MappingConfig()
RIG = msgspec.structs.replace(make_rig(exact=False), covariance_rc=None)
POSE_SIGMA = np.array([0.4, 0.4, 0.8, 2e-4, 2e-4, 2e-3])  # m, rad
HOUSE = np.array([[-6.0, -4.0], [-6.0, 4.0], [6.0, 4.0], [6.0, -4.0]])


def region(px: Array, colour: tuple[float, float, float] = (40.0, 50.0, 200.0)) -> Region:
    """A polygon as segmentation gives it, anticlockwise as seen in the image."""
    outline = px if polygon.area(px) < 0.0 else px[::-1]  # v is down
    return Region(outline, outline.copy(), 1.0, (0, 0, 1, 1), np.ones((1, 1), bool), False, colour, 0.1, 1)


def measured(region: Region, distance_m: float, sigma: float, rig_sigma: float) -> Measured:
    """A region whose distance was measured, with these relative errors."""
    three, one = np.zeros(3), np.eye(3)
    return Measured(
        region, three, one, three, three, np.zeros((4, 3)), distance_m, 1.0, 1.0, 1.0, 1.0, 0.0, 0.1, np.eye(5),
        1.0, sigma, rig_sigma,
    )  # fmt: skip


def seen(
    frame: int, roof: Array, down: float, true: tuple[Array, Array], prior: Prior, rig: StereoRig, rng: np.random.Generator,
    depth: tuple[float, float, float] | None = None,
) -> Observation:  # fmt: skip
    """The look at a roof (K, 2) at `down`, from the true pose through the true rig, laid out from the prior ones.

    depth: measured over true distance, and the relative errors that it claims, its own and the rig's.
    """
    p_nc, R_nc = rig.camera_pose(*true)
    corners = np.column_stack((roof, np.full(len(roof), down)))
    px = rig.left.project((corners - p_nc) @ R_nc) + rng.normal(0.0, CONFIG.centre_px, 2)
    seen_region, distance = region(px), float(np.linalg.norm(corners.mean(axis=0) - p_nc))
    pair = None if depth is None else measured(seen_region, depth[0] * distance, *depth[1:])
    found = observe(frame, seen_region, pair, prior, RIG, 0.0, CONFIG)
    assert found is not None
    return found


def flight(rng: np.random.Generator, count: int, leg_m: float = 50.0) -> list[tuple[Array, Array, Prior]]:
    """True and prior poses along a leg, heading turning: an error of the whole flight and one of each image."""
    root, share = np.diag(POSE_SIGMA), CONFIG.fresh_share
    lasting = np.sqrt(1.0 - share) * root @ rng.standard_normal(6)
    poses = []
    for k in range(count):
        p_n = np.array([leg_m * (k / (count - 1) - 0.5), 8.0 * np.sin(k), -HEIGHT_M])
        q = so3.from_euler(0.0, 0.0, 0.4 * k)
        error = lasting + np.sqrt(share) * root @ rng.standard_normal(6)
        q_prior = so3.multiply(so3.quat_exp(error[3:]), q)
        poses.append((p_n, so3.matrix(q), Prior(p_n + error[:3], q_prior, root @ root)))
    return poses


def test_the_covariance_is_consistent() -> None:
    """Error of the learned place over its covariance, pose and mounting drawn anew each time; not too large, not too small."""
    rng, position, squares = np.random.default_rng(1), np.array([5.0, -3.0, -6.0]), []
    for _ in range(150):
        rig, mapper = draw_rig(RIG, rng), Mapper(0.0, CONFIG)
        for k, (p_n, R_nb, prior) in enumerate(flight(rng, 10)):
            mapper.add([seen(k, HOUSE + position[:2], position[2], (p_n, R_nb), prior, rig, rng)])
        (track,) = mapper.tracks
        found = mapper.position(track)
        error = found.position_n - position
        squares.append(float(error @ np.linalg.solve(found.covariance, error)) / 3.0)
    assert 0.8 < np.mean(squares) < 1.25
    assert np.mean(np.array(squares) > 5.42) < 0.04, "99.9 % of chi-square with 3 degrees, over 3"


def test_what_repeats_is_not_averaged_away() -> None:
    """Ten times as many looks make it no surer than the pose is; what is each look's own does shrink."""
    rng = np.random.default_rng(2)
    few, many = (Mapper(0.0, CONFIG) for _ in range(2))
    for mapper, count in ((few, 6), (many, 60)):
        for k, (p_n, R_nb, prior) in enumerate(flight(rng, count)):
            mapper.add([seen(k, HOUSE, -6.0, (p_n, R_nb), prior, RIG, rng)])
    a, b = few.position(few.tracks[0]), many.position(many.tracks[0])
    assert np.trace(b.own) < 0.2 * np.trace(a.own)
    floor = np.sqrt(1.0 - CONFIG.fresh_share) * POSE_SIGMA[0]
    assert floor < np.sqrt(b.covariance[0, 0]) < 1.1 * np.sqrt(a.covariance[0, 0])


def test_rays_that_meet_tell_the_height_and_parallel_ones_do_not() -> None:
    rng = np.random.default_rng(3)
    sigmas = []
    for leg_m in (0.1, 50.0):
        mapper = Mapper(0.0, CONFIG)
        for k, (p_n, R_nb, prior) in enumerate(flight(rng, 12, leg_m)):
            still = np.array([p_n[0], 0.0, p_n[2]]), R_nb
            pose = Prior(prior.p_n - p_n + still[0], prior.q_nb_wxyz, prior.covariance)
            mapper.add([seen(k, HOUSE, -9.0, still, pose, RIG, rng)])
        sigmas.append(float(np.sqrt(mapper.position(mapper.tracks[0]).own[2, 2])))
    assert sigmas[0] > 4.0, "what roofs have in general"
    assert 0.1 < sigmas[1] < 1.0


def heights(leg_m: float, depth: tuple[float, float, float] | None) -> tuple[float, float]:
    """Error of a roof's height 12 m above ground, exact poses, and the standard deviation of it."""
    rng, mapper = np.random.default_rng(10), Mapper(0.0, CONFIG)
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 30, leg_m)):
        position = np.array([p_n[0], 0.0, p_n[2]])
        exact = Prior(position, so3.from_matrix(np.ascontiguousarray(R_nb)), prior.covariance)
        mapper.add([seen(k, HOUSE, -12.0, (position, R_nb), exact, RIG, rng, depth)])
    (track,) = mapper.tracks
    found = mapper.position(track)
    return float(found.position_n[2] + 12.0), float(np.sqrt(found.own[2, 2] + found.F[2, -1] ** 2))


def test_the_rig_s_error_of_distance_counts_once_however_often_it_is_seen() -> None:
    """Thirty pairs whose distances are all a fifth too short: the rays know better. A good pair helps a flight that hovers."""
    off, sigma = heights(5.0, (0.8, 0.01, 0.25))
    assert abs(off) < 0.6
    assert sigma < 3.0
    hovering, good = heights(1.0, None), heights(1.0, (1.0, 0.01, 0.01))
    assert hovering[1] > 2.0
    assert good[1] < 1.0
    assert abs(good[0]) < 3.0 * good[1]


def test_neighbours_are_kept_apart_although_the_whole_image_is_off() -> None:
    """Two equal houses 14 m apart, and poses 1 m off to one side and the other."""
    rng, mapper = np.random.default_rng(4), Mapper(0.0, CONFIG)
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 10, 30.0)):
        off = Prior(
            prior.p_n + np.array([0.0, (-1.0) ** k, 0.0]), prior.q_nb_wxyz, np.diag([1.2, 1.2, 1.2, 2e-4, 2e-4, 2e-3]) ** 2
        )
        mapper.add([seen(k, HOUSE + np.array([0.0, east]), -6.0, (p_n, R_nb), off, RIG, rng) for east in (-7.0, 7.0)])
    assert sorted(len(track.observations) for track in mapper.tracks) == [10, 10]
    assert sorted(round(float(track.position[1])) for track in mapper.tracks) == pytest.approx([-7, 7], abs=1)


def test_what_moves_is_no_landmark_and_what_is_seen_once_is_none_either() -> None:
    rng, mapper = np.random.default_rng(5), Mapper(0.0, CONFIG)
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 12)):
        observations = [
            seen(k, HOUSE + np.array([0.0, east]), -6.0, (p_n, R_nb), prior, RIG, rng) for east in (0.0, 20.0 + 0.9 * k)
        ]
        if k == 5:
            observations.append(seen(k, HOUSE + np.array([0.0, -20.0]), -6.0, (p_n, R_nb), prior, RIG, rng))
        mapper.add(observations)
    found = learned(mapper, 0.0, KeepConfig(least_frames=3))
    assert [round(float(np.hypot(*mark.centre_n))) for mark in found.landmarks] == pytest.approx([0], abs=1)
    assert found.seen == [12]
    assert found.left_out["seen in fewer than 3 images"] >= 1
    assert found.left_out["not at one position: it moves, or is several things"] >= 1


def test_what_moves_against_the_rest_of_the_image_is_not_followed() -> None:
    """Poses so vague that each step of a car would pass by itself; next to three houses that stand still it does not."""
    rng, mapper = np.random.default_rng(11), Mapper(0.0, CONFIG)
    vague = np.diag([2.0, 2.0, 2.0, 2e-4, 2e-4, 2e-3]) ** 2
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 10, 30.0)):
        pose = Prior(prior.p_n, prior.q_nb_wxyz, vague)
        positions = [(0.0, 0.0), (0.0, -22.0), (-12.0, 0.0), (0.0, 18.0 + 2.5 * k)]
        mapper.add([seen(k, HOUSE + np.array(position), -6.0, (p_n, R_nb), pose, RIG, rng) for position in positions])
    counts = sorted(len(track.observations) for track in mapper.tracks)
    assert counts[-3:] == [10, 10, 10]
    assert counts[-4] <= 6


def test_what_looks_different_from_side_to_side_is_no_roof() -> None:
    rng, mapper = np.random.default_rng(12), Mapper(0.0, CONFIG)
    triangle = np.array([[-4.0, -3.0], [-4.0, 6.0], [8.0, -3.0]])
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 10)):
        mapper.add([seen(k, (-1.0) ** k * triangle, -6.0, (p_n, R_nb), prior, RIG, rng)])
    assert [len(track.observations) for track in mapper.tracks] == [10]
    assert learned(mapper, 0.0).left_out == {"its outlines differ from side to side, as those of walls do": 1}


def test_a_learned_landmark_has_size_height_and_colour() -> None:
    rng, mapper = np.random.default_rng(9), Mapper(0.0, CONFIG)
    for k, (p_n, R_nb, prior) in enumerate(flight(rng, 20)):
        observations = [
            seen(k, HOUSE + position[:2], position[2], (p_n, R_nb), prior, RIG, rng) for position in ((0, 0, -8), (0, 20, 0))
        ]
        mapper.add(observations)
    found = learned(mapper, 0.0)
    house, painted = sorted(found.landmarks, key=lambda mark: mark.centre_n[1])
    assert (house.width_m, house.length_m) == pytest.approx((8.0, 12.0), abs=0.25)
    assert house.height_m == pytest.approx(8.0, abs=3.0 * np.hypot(house.height_sigma_m, POSE_SIGMA[2]))
    assert (house.sigma_m, house.height_sigma_m) == pytest.approx((0.22, 0.28), abs=0.06), (
        "the drift along the flight, and its own"
    )
    assert np.sqrt(np.diag(found.common)) == pytest.approx([0.4, 0.4, 0.8], rel=0.1), "the pose's own error"
    assert 0.03 < house.outline_sigma_m < 0.15
    assert house.colour_bgr == (40, 50, 200)
    assert (painted.height_m, len(painted.outline_n)) == (0.0, 4)


def test_fragments_of_one_thing_are_united() -> None:
    rng, mapper = np.random.default_rng(7), Mapper(0.0, CONFIG)
    poses = flight(rng, 12)
    for k, (p_n, R_nb, prior) in enumerate(poses):
        if k == 6:
            mapper.tracks, first = [], mapper.tracks
        mapper.add([seen(k, HOUSE, -6.0, (p_n, R_nb), prior, RIG, rng)])
    mapper.tracks += first
    assert len(mapper.tracks) == 2
    assert learned(mapper, 0.0).seen == [12]


def test_outlines_vote() -> None:
    """Of nine L-shapes two are cut and one is blown up: the L comes out, to less than a cell."""
    ell = np.array([[0.0, 0.0], [0.0, 12.0], [5.0, 12.0], [5.0, 5.0], [11.0, 5.0], [11.0, 0.0]])
    rng = np.random.default_rng(8)
    outlines = [ell + rng.normal(0.0, 0.05, ell.shape) for _ in range(6)] + [1.4 * ell, ell[[0, 1, 2, 3]], ell[[0, 3, 4, 5]]]
    found = merged_outline(outlines, 0.1)
    assert found is not None
    described = polygon.describe(found.outline, np.array([0, len(found.outline)]))[0]
    assert described[polygon.SIZE] == pytest.approx(polygon.area(ell), rel=0.03)
    assert described[[polygon.WIDTH, polygon.LENGTH]] == pytest.approx([11.0, 12.0], abs=0.15)
    assert described[[polygon.NORTH, polygon.EAST]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert len(found.outline) == 6
    assert 0.7 < found.agreement < 0.95


def test_outlines_that_have_nothing_in_common_give_none() -> None:
    ring = np.array([[0.0, 0.0], [0.0, 1.0], [30.0, 1.0], [30.0, 0.0]])
    turned = [ring @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in (0.3, 1.3, 2.3)]
    lines = [outline + np.array([100.0 * k, 0.0]) for k, outline in enumerate(turned)]
    found = merged_outline(lines, 0.1)
    assert found is None or (polygon.area(found.outline) < 5.0 and found.agreement < 0.3)
