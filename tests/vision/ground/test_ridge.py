"""One direction at a time: a river that is all there is to see gives a fix across it alone."""

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.aerial.registration import judge
from benchmarks.aerial.registration_sets import Shot
from models import so3
from models.maps.landmarks import LandmarkMap
from models.messages import Array
from models.prior import Prior
from tests.vision.ground import scene
from vision.ground.features import FeatureMap
from vision.ground.image import Float, GroundImage
from vision.ground.peak import fit_ridge
from vision.ground.registration import register
from vision.ground.ridge import find_line
from vision.ground.search import Peak
from vision.ground.view import Mask
from vision.image.rectify import Image
from vision.pose.pose import difference
from vision.recognisers import MapImage, Recognisers

_SIGMA = np.array([10.0, 10.0, 3.0, 0.01, 0.01, 0.03])
_COURSE = np.array([0.8, -0.6])  # of the river, north and east
_ACROSS = np.array([0.6, 0.8])
_NOTHING = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [])


def _grain(image: Image, rng: np.random.Generator) -> Image:
    """Texture of another day: what is fine is never the same."""
    grain = cv2.GaussianBlur(rng.normal(0.0, 40.0, image.shape).astype(np.float32), (0, 0), 2.0)
    grown: Image = np.clip(image + grain, 0, 255).astype(np.uint8)
    return grown


def _river(day: int) -> Image:
    """Meadows with a straight river 14 m wide, and bushes on its banks that are others on each day."""
    rng = np.random.default_rng(day)
    image = np.full((scene.SIDE, scene.SIDE), 130, np.uint8)
    to_px = np.linalg.inv(scene.AFFINE[:, :2])
    start, end = (np.rint((far * _COURSE - scene.AFFINE[:, 2]) @ to_px.T).astype(int).tolist() for far in (-300.0, 300.0))
    cv2.line(image, start, end, 70, 70, cv2.LINE_AA)
    for far in rng.uniform(-150.0, 150.0, 60):
        bank = far * _COURSE + rng.choice([-8.0, 8.0]) * _ACROSS
        at = np.rint((bank - scene.AFFINE[:, 2]) @ to_px.T).astype(int).tolist()
        cv2.circle(image, at, int(rng.uniform(5, 12)), int(rng.uniform(60, 100)), -1, cv2.LINE_AA)
    return _grain(image, rng)


def _case(seed: int, known: Image) -> tuple[Array, Array, Prior, GroundImage, Image]:
    rng = np.random.default_rng(seed)
    map_image = scene.map_image(known, sigma_m=0.3)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    step = np.append(-(_ACROSS @ p_n[:2]) * _ACROSS, 0.0) + np.append(rng.uniform(-8.0, 8.0) * _ACROSS, 0.0)
    prior = Prior(prior.p_n + step, prior.q_nb_wxyz, prior.covariance)
    return p_n + step, R_nb, prior, map_image, scene.shot(_river(100 + seed), p_n + step, R_nb, rng)


def _peak(prior: Prior, map_image: GroundImage, image: Image) -> Peak:
    peak = register(scene.RIG, image, prior, map_image).peak
    assert peak is not None
    return peak


def test_a_river_gives_its_one_direction() -> None:
    """Across it the fix is as good as it says, which is what a benchmark judges; along it the prior's error remains."""
    squared, along_m = [], []
    for seed in range(4):
        p_n, R_nb, prior, map_image, image = _case(seed, _river(0))
        fit = fit_ridge(scene.RIG, prior, map_image, _peak(prior, map_image, image))
        assert not isinstance(fit, str), (seed, fit)
        assert fit.directions is not None
        assert fit.directions.shape == (1, 6)
        way = fit.directions[0, :2] / np.linalg.norm(fit.directions[0, :2])
        assert abs(way @ _ACROSS) > np.cos(np.radians(4.0))
        squared.append(scene.chi_square(fit, p_n, R_nb) / 6.0)
        along_m.append(abs(_COURSE @ (fit.joint_p_n - p_n)[:2]))
        off_m, _, freedom = judge(scene.RIG, map_image, Shot(0, image, p_n, R_nb, prior), fit)
        assert freedom == 1
        assert off_m < 3.0
        C = fit.joint_covariance[:2, :2]
        assert np.sqrt(_COURSE @ C @ _COURSE) == pytest.approx(_SIGMA[0], rel=0.05)
        assert np.sqrt(_ACROSS @ C @ _ACROSS) < 0.25 * _SIGMA[0]
        e = difference(p_n, R_nb, fit.joint_p_n, so3.from_matrix(np.ascontiguousarray(fit.joint_R_nb)))
        assert e @ np.linalg.solve(fit.joint_covariance, e) < chi2.ppf(1.0 - 1e-4, 6)
    assert max(squared) < chi2.ppf(1.0 - 1e-4, 1)
    assert np.mean(squared) < 2.0
    assert max(along_m) > 6.0


def test_the_recognisers_give_it_last() -> None:
    *_, prior, map_image, image = _case(1, _river(0))
    known = MapImage(map_image, FeatureMap(map_image, np.empty((0, 3)), np.empty((0, 128), np.uint8)))
    result = Recognisers(scene.RIG, _NOTHING, known).process(image, None, 7, prior)
    assert result.fix is not None
    assert "across a line alone" in result.report.detail
    assert result.fix.directions is not None
    assert result.fix.directions.shape == (1, 6)
    far = Prior(prior.p_n + np.append(40.0 * _ACROSS, 0.0), prior.q_nb_wxyz, prior.covariance)
    assert Recognisers(scene.RIG, _NOTHING, known).process(image, None, 7, far).fix is None, "the map shows no river there"


def _scores(*offsets: float, length: float = 1e3) -> tuple[Float, Mask, Array]:
    """Scores of lines along (0.8, 0.6), so far across from the middle; what was searched; its extent."""
    rows, columns = np.indices((81, 81)) - 40.0
    across, along = 0.8 * rows - 0.6 * columns, 0.6 * rows + 0.8 * columns
    rng = np.random.default_rng(1)
    lines = [np.exp(-0.5 * ((across - off) / 2.0) ** 2 - 0.5 * (along / length) ** 2) for off in offsets]
    scores = 0.05 * rng.normal(size=(3, 81, 81)) + 0.6 * np.max(lines, axis=0) * np.array([0.5, 1.0, 0.7])[:, None, None]
    inside = np.hypot(rows, columns) <= 40.0
    return np.where(inside, scores, -1.0).astype(np.float32), inside, 1600.0 * np.eye(2)


def test_one_line_is_one_direction() -> None:
    line = find_line(*_scores(7.0), 1.6)
    assert line is not None
    assert abs(line.normal @ (-0.6, 0.8)) > 0.9999
    scores, _, _ = _scores(7.0)
    _, i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    assert line.normal @ (j - 40.0, i - 40.0) + line.offset == pytest.approx(7.0 * np.sign(line.normal @ (-0.6, 0.8)), abs=0.3)
    assert line.ratio > 1.6


@pytest.mark.parametrize("case", ["two lines", "a point", "at the border", "nothing"])
def test_all_else_is_none(case: str) -> None:
    scores = {
        "two lines": _scores(7.0, -15.0),
        "a point": _scores(7.0, length=2.0),
        "at the border": _scores(38.0),
        "nothing": _scores(1e3),
    }
    assert find_line(*scores[case], 1.6) is None
