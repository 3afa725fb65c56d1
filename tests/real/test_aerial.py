"""The outline path on a few real aerial images: it finds what is there, and has no fix where the map is not.

python -m benchmarks.aerial has all images, and many priors for each.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.aerial import brighton, nust
from benchmarks.aerial.reference import Reference, plane_pose
from benchmarks.aerial.trials import Outcome, Spread, Trial, generator, outline_share, run, turned
from models import so3
from models.camera import CameraModel
from models.maps.landmarks import Landmark, LandmarkMap
from tests.real import footprints

PHOTOS = ("DJI_0026.jpg", "DJI_0033.jpg", "DJI_0034.jpg")
FRAMES = (700, 750, 800)
WIDTH = brighton.AS_FINE_AS_THE_MAP


@pytest.fixture(scope="module")
def landfix_images(landfix_data: Path) -> Path:
    if not all((landfix_data / one.FOLDER).is_dir() for one in (brighton, nust, footprints)):
        pytest.skip("no aerial images: LANDFIX_DATA has no images/brighton_beach_uav, nust_..., spacenet_...")
    return landfix_data


@pytest.fixture(scope="module")
def photos(landfix_images: Path) -> dict[str, Reference]:
    return brighton.references(landfix_images, brighton.landmark_map(), PHOTOS)


def outcomes(trials: Sequence[Trial]) -> list[Outcome]:
    return [run(trial) for trial in trials]


def test_photos_are_located_without_outlines(photos: dict[str, Reference]) -> None:
    """The reference: many points agree to the size of the orthophoto's pixels (2.3 px), 38 m above the ground."""
    for where in photos.values():
        assert where.inliers > 100
        assert 0.5 < where.rms_px < 2.5
        assert where.sigma_m.max() < 0.1
        assert 30.0 < -where.p_nc[2] < 45.0


def test_photos_with_three_outlines(landfix_images: Path, photos: dict[str, Reference]) -> None:
    landmarks, trials = brighton.landmark_map(), []
    for name, where in photos.items():
        case = brighton.case(landfix_images, name, where, landmarks, WIDTH)
        assert len(case.shown) >= 3
        trials += [Trial(case, k, brighton.SPREAD.draw(generator(0, name, k), case.p_n, case.R_nb)) for k in range(2)]
    found = [o for o in outcomes(trials) if o.accepted]
    assert len(found) >= 2  # 3; the others wait for another image that agrees
    assert max(o.error_m for o in found) < 2.0
    assert np.median([o.error_m for o in found]) > 0.05  # the map is not that good
    assert np.mean([o.squared for o in found]) < 4.0


def test_a_map_that_is_turned_is_not_in_the_photos(landfix_images: Path, photos: dict[str, Reference]) -> None:
    landmarks, trials = brighton.landmark_map(), []
    for name, where in photos.items():
        rng = generator(1, name, 0)
        decoy = LandmarkMap.from_landmarks(landmarks.origin, turned(list(landmarks), where.p_nc[:2], rng))
        case = brighton.case(landfix_images, name, where, decoy, WIDTH)
        trials.append(Trial(case, 0, brighton.SPREAD.draw(rng, case.p_n, case.R_nb)))
    assert not any(o.accepted for o in outcomes(trials))


def test_helipads_of_the_video(landfix_images: Path) -> None:
    landmarks, known = nust.landmark_map(), nust.registrations(landfix_images)
    trials = []
    for number, image in nust.frames(landfix_images, FRAMES):
        case = nust.case(number, image, known[number], landmarks)
        assert case.shown == nust.PADS
        trials += [Trial(case, k, nust.SPREAD.draw(generator(0, case.name, k), case.p_n, case.R_nb)) for k in range(2)]
    found = [o for o in outcomes(trials) if o.accepted]
    assert len(found) >= 5
    assert max(o.error_m for o in found) < 2.0


@pytest.mark.parametrize(("size", "least"), [(10, 7), (3, 1)])
def test_footprints_are_found_together_and_turned_ones_are_not(landfix_images: Path, size: int, least: int) -> None:
    """Hipped roofs under trees: hardly one of them gives a fit. Three outlines rarely have one place only."""
    of = footprints.scene(landfix_images)
    trials, decoys = [], []
    for marks in footprints.sets(of.landmarks, size)[::6]:
        rng = generator(0, marks[0].id, size)
        apart_m = footprints.misregistration(of, marks)
        assert np.linalg.norm(apart_m) < 1.2  # the file's footprints lie on their houses, whichever are left out
        case = footprints.case(of, marks[0].id, marks, apart_m)
        trials.append(Trial(case, 0, footprints.prior(case, rng)))
        turned_marks = turned(marks, np.mean([m.centre_n for m in marks], axis=0), rng)
        decoy = footprints.case(of, marks[0].id, turned_marks, apart_m)
        decoys.append(Trial(decoy, 0, footprints.prior(decoy, rng)))
    assert len(trials) == 8
    found = [o for o in outcomes(trials) if o.accepted]
    assert len(found) >= least
    assert max(o.error_m for o in found) < 2.0
    assert not any(o.accepted for o in outcomes(decoys))


def test_an_image_that_is_shifted_shows_as_misregistration(landfix_images: Path) -> None:
    of = footprints.scene(landfix_images)
    some = footprints.sets(of.landmarks, 10)[0]
    moved = footprints.Scene(of.image, of.landmarks, of.camera, of.p_nc, of.R_nc, np.roll(of.slope, (4, -3), axis=(1, 2)))
    apart = footprints.misregistration(moved, some) - footprints.misregistration(of, some)
    np.testing.assert_allclose(apart, footprints.STEP_M * np.array([-3.0, 4.0]), atol=0.1)


def test_a_shifted_prior_shows_as_projected_shift(landfix_images: Path) -> None:
    """North is up but for the grid's convergence of 1.4 degrees: a camera moved north shows the houses moved down."""
    of = footprints.scene(landfix_images)
    marks = footprints.sets(of.landmarks, 3)[0]
    case = footprints.case(of, "", marks, np.zeros(2))
    shift = footprints.projected_shift(of, marks, case.p_n + np.array([10.0, 0.0, 0.0]), case.R_nb)
    np.testing.assert_allclose(shift, [0.0, 10.0], atol=0.4)
    assert case.judge(case.p_n + np.array([10.0, 0.0, 0.0]), case.R_nb) == pytest.approx(10.0, abs=0.1)


def test_the_pose_over_a_plane() -> None:
    camera = CameraModel(852, 480, 650.0, 650.0, 425.5, 239.5)
    R_nc = so3.matrix(so3.from_euler(0.06, -0.04, 1.8)) @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    p_nc = np.array([20.0, -30.0, -150.0])
    x_n = np.random.default_rng(0).uniform(-60.0, 60.0, (20, 3)) * np.array([1.0, 1.0, 0.0]) + np.array([20.0, -30.0, 5.0])
    p, R = plane_pose(x_n, camera.project((x_n - p_nc) @ R_nc), camera)
    np.testing.assert_allclose(p, p_nc, atol=1e-3)
    np.testing.assert_allclose(R, R_nc, atol=1e-5)


def test_priors_are_what_they_say() -> None:
    spread = Spread(7.0, 1.5, 0.02, 0.05)
    rng, p_n, R_nb = np.random.default_rng(0), np.array([1.0, 2.0, -40.0]), so3.matrix(so3.from_euler(0.0, 0.0, 1.0))
    error = np.array([spread.draw(rng, p_n, R_nb).p_n - p_n for _ in range(3000)])
    distance = np.hypot(error[:, 0], error[:, 1])
    assert 6.8 < distance.max() <= 7.0
    np.testing.assert_allclose(error.std(axis=0), spread.sigma[:3], rtol=0.06)


def test_how_much_of_an_outline_is_in_the_image() -> None:
    camera = CameraModel(100, 100, 100.0, 100.0, 49.5, 49.5)
    R_nc = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    box = np.array([(-10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (10.0, -10.0)])
    for north, share in ((0.0, 1.0), (50.0, 0.5), (200.0, 0.0)):
        mark = Landmark.of("", box + np.array([north, 0.0]))
        assert outline_share(camera, np.array([0.0, 0.0, -100.0]), R_nc, mark) == pytest.approx(share, abs=0.05)
