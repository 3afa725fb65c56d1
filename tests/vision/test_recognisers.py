"""Which recogniser runs, and when its result is accepted."""

import msgspec
import numpy as np
import pytest

from models import so3
from models.maps.landmarks import LandmarkMap
from models.messages import Array
from models.prior import Prior
from tests.vision.ground import scene
from vision import recognisers
from vision.ground.features import FeatureConfig, FeatureMap
from vision.ground.peak import PeakConfig
from vision.ground.search import RegistrationConfig
from vision.image.rectify import Image
from vision.recognisers import MapImage, RecogniserConfig, Recognisers

SECOND = 1_000_000_000
SIGMA = np.array([8.0, 8.0, 3.0, 0.01, 0.01, 0.03])
NOTHING = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [])


@pytest.fixture(scope="module")
def known() -> MapImage:
    return MapImage.of(scene.map_image(scene.drawing(1), sigma_m=0.5))


def _seen(seed: int, sigma: Array = SIGMA, on: float = 0.0) -> tuple[Array, Prior, Image, Image]:
    """Place, prior, left image, and what the right camera sees; on: so many m farther north, the prior off by the same."""
    rng = np.random.default_rng(seed)
    p_n, R_nb, prior = scene.flight(rng, sigma)
    step = np.array([on, 0.0, 0.0])
    p_n, prior = p_n + step, Prior(prior.p_n + step, prior.q_nb_wxyz, prior.covariance)
    beside = R_nb @ scene.R_BC @ np.array([0.3, 0.0, 0.0])
    left, right = (scene.shot(scene.drawing(1), p, R_nb, rng) for p in (p_n, p_n + beside))
    return p_n, prior, left, right


def test_a_good_prior_gets_a_registration(known: MapImage) -> None:
    p_n, prior, left, right = _seen(1)
    result = Recognisers(scene.RIG, NOTHING, known).process(left, right, 7, prior)
    assert result.fix is not None
    assert (result.fix.t_ns, result.fix.landmarks, result.report.outcome) == (7, ("ortho",), "fixed")
    assert "blocks" in result.report.detail
    assert result.fix.covariance_common is not None
    assert result.fix.landmark_errors is not None
    L = result.fix.landmark_errors[0]
    np.testing.assert_allclose(L @ L.T, result.fix.covariance_common)
    e = result.fix.p_n - p_n
    total = (result.fix.covariance + result.fix.covariance_common)[:3, :3]
    assert e @ np.linalg.solve(total, e) < 21.1
    assert result.report.candidates / result.report.regions == pytest.approx(result.fix.similarity)


def test_a_wide_prior_gets_features(known: MapImage) -> None:
    p_n, prior, left, _ = _seen(2, np.array([70.0, 70.0, 10.0, 0.02, 0.02, 0.2]))
    result = Recognisers(scene.RIG, NOTHING, known).process(left, None, 7, prior)
    assert result.fix is not None
    assert "features" in result.report.detail
    assert np.linalg.norm(result.fix.p_n - p_n) < 2.0


def test_the_right_camera_alone(known: MapImage) -> None:
    p_n, prior, _, right = _seen(3)
    fixes = [Recognisers(scene.RIG, NOTHING, known).process(left, right, 7, prior).fix for left in (None, np.zeros_like(right))]
    for fix in fixes:
        assert fix is not None
        assert np.linalg.norm(fix.p_n - p_n) < 1.0, "taken for the left camera it would be off by more in its own frame"


def test_no_image_or_no_prior_is_the_pipelines_word(known: MapImage) -> None:
    _, prior, left, _ = _seen(4)
    both = Recognisers(scene.RIG, NOTHING, known)
    assert both.process(None, None, 7, prior).report.outcome == "no_image"
    assert both.process(np.zeros_like(left), None, 7, prior).report.outcome == "no_image"
    lost = Prior(prior.p_n * np.nan, prior.q_nb_wxyz, prior.covariance)
    assert both.process(left, None, 7, lost).report.outcome == "no_prior"
    assert Recognisers(scene.RIG, NOTHING).process(left, None, 7, prior).report.outcome == "no_landmark_near"


def test_a_position_outside_the_image_is_reported(known: MapImage) -> None:
    _, prior, left, _ = _seen(5)
    far = Prior(prior.p_n + np.array([2000.0, 0.0, 0.0]), prior.q_nb_wxyz, prior.covariance)
    assert Recognisers(scene.RIG, NOTHING, known).process(left, None, 7, far).report.outcome == "outside"


def test_defects_do_not_end_the_flight(known: MapImage, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("broken")

    monkeypatch.setattr(recognisers, "register", broken)
    _, prior, left, _ = _seen(1)
    report = Recognisers(scene.RIG, NOTHING, known).process(left, None, 7, prior).report
    assert (report.outcome, report.detail) == ("internal", "RuntimeError: broken")


def _unsure() -> RecogniserConfig:
    """One image is never enough, and features and the peak never are."""
    return RecogniserConfig(
        registration=RegistrationConfig(sure=1e-300), features=FeatureConfig(least=10**6), peak=PeakConfig(ratio=1e9)
    )


def test_features_come_in_where_registration_is_uncertain(known: MapImage) -> None:
    p_n, prior, left, _ = _seen(1)
    config = RecogniserConfig(registration=RegistrationConfig(sure=1e-300), peak=PeakConfig(ratio=1e9))
    result = Recognisers(scene.RIG, NOTHING, known, config).process(left, None, 7, prior)
    assert result.fix is not None
    assert "features agree" in result.report.detail
    assert np.linalg.norm(result.fix.p_n - p_n) < 2.0


def test_a_likely_position_waits_for_an_image_that_agrees(known: MapImage) -> None:
    """Of the same view it is no confirmation, however often it comes."""
    waiting = Recognisers(scene.RIG, NOTHING, known, _unsure())
    results = []
    for t, on in enumerate((0.0, 0.0, 5.0, 45.0, 45.0)):
        _, prior, left, _ = _seen(1, on=on)
        results.append(waiting.process(left, None, t * SECOND, prior))
    assert [r.fix is not None for r in results] == [False, False, False, True, False], "the same view, a fix begins anew"
    assert results[0].report.outcome == "ambiguous"


@pytest.mark.parametrize(("seconds", "moved"), [(20.0, 0.0), (-1.0, 0.0), (1.0, 6.0)])
def test_too_late_out_of_order_or_elsewhere_confirms_nothing(known: MapImage, seconds: float, moved: float) -> None:
    _, prior, left, _ = _seen(1)
    waiting = Recognisers(scene.RIG, NOTHING, known, _unsure())
    waiting.process(left, None, 20 * SECOND, prior)
    _, prior, left, _ = _seen(1, on=45.0)
    later = Prior(prior.p_n + np.array([moved, 0.0, 0.0]), prior.q_nb_wxyz, prior.covariance)
    assert waiting.process(left, None, 20 * SECOND + round(seconds * SECOND), later).report.outcome == "ambiguous"


def _only_a_peak(oriented: float = 1.0) -> RecogniserConfig:
    """Blocks and features never agree, nor do the directions of edges."""
    never = RegistrationConfig(least_blocks=10**6)
    return RecogniserConfig(registration=never, features=FeatureConfig(least=10**6), peak=PeakConfig(oriented=oriented))


def test_a_clear_peak_alone_waits_for_two_other_views(known: MapImage) -> None:
    """Hovering over the same ground is no other view, and an image that shows another error of the prior begins anew."""
    waiting = Recognisers(scene.RIG, NOTHING, known, _only_a_peak())
    results = []
    for t, on in enumerate((0.0, 0.0, 40.0, 0.0, -40.0)):
        _, prior, left, _ = _seen(1, on=on)
        results.append(waiting.process(left, None, t * SECOND, prior))
    assert [r.report.outcome for r in results] == ["waiting", "waiting", "waiting", "waiting", "fixed"]
    assert [r.pose is not None for r in results] == [False, False, False, False, True]
    assert "other views agree" in results[4].report.detail
    contradicted = Recognisers(scene.RIG, NOTHING, known, _only_a_peak())
    _, prior, left, _ = _seen(1)
    contradicted.process(left, None, 0, prior)
    for t, on in enumerate((40.0, -40.0), 1):
        _, prior, left, _ = _seen(1, on=on)
        later = Prior(prior.p_n + np.array([8.0, 0.0, 0.0]), prior.q_nb_wxyz, prior.covariance)
        assert contradicted.process(left, None, t * SECOND, later).report.outcome == "waiting"


def test_a_clear_peak_is_a_fix_where_edges_lie_the_same_way(known: MapImage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before features are sought."""
    monkeypatch.setattr(recognisers, "recognise", lambda *_: pytest.fail("features were sought"))
    p_n, prior, left, _ = _seen(1)
    result = Recognisers(scene.RIG, NOTHING, known, _only_a_peak(oriented=0.2)).process(left, None, 7, prior)
    assert result.fix is not None
    assert result.pose is not None
    assert "peak of the search alone" in result.report.detail
    assert np.linalg.norm(result.pose.joint_p_n[:2] - p_n[:2]) < 3.0


def test_a_prior_that_excludes_the_position_is_accepted(known: MapImage) -> None:
    """Heading known to 2 degrees and 40 off: features still match, and the pose is rejected."""
    _, prior, left, _ = _seen(2, np.array([70.0, 70.0, 10.0, 0.02, 0.02, 0.03]))
    turned = so3.multiply(so3.from_euler(0.0, 0.0, 0.7), prior.q_nb_wxyz)
    result = Recognisers(scene.RIG, NOTHING, known).process(left, None, 7, Prior(prior.p_n, turned, prior.covariance))
    assert result.fix is None


def test_the_same_requests_give_the_same_bytes(known: MapImage) -> None:
    answers = []
    for _ in range(2):
        again = Recognisers(scene.RIG, NOTHING, MapImage(known.image, FeatureMap.of(known.image)), _unsure())
        results = [again.process(_seen(s)[2], None, s * SECOND, _seen(s)[1]) for s in (1, 2, 3)]
        answers.append([(msgspec.json.encode(r.report), r.fix.covariance.tobytes() if r.fix else b"") for r in results])
    assert answers[0] == answers[1]
