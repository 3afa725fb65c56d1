"""Images become pairs, pairs become requests with the prior of their exposure."""

import math

import numpy as np
import pytest

from estimator.frontend.requests import Pair, Pairing, Shot, Track, VisionConfig, prior_at
from models import so3
from models.messages import Estimate, ImageName, Mode
from models.state import E, X

MS = 1_000_000
SECOND = 1_000_000_000


def _shot(t_ms: float, side: str = "left", late_ms: float = 30.0) -> Shot:
    t_ns = round(t_ms * MS)
    return Shot(f"/{side}/image", "sensor_msgs/msg/Image", b"", t_ns, t_ns, t_ns + round(late_ms * MS))


def _put(pairing: Pairing, *shots: Shot) -> list[tuple[int | None, int | None]]:
    pairs: list[Pair] = []
    for shot in shots:
        pairs += pairing.put(shot.topic.split("/")[1], shot)
    return [tuple(None if s is None else s.t_ns // MS for s in pair) for pair in pairs]  # type: ignore[misc]


def test_images_of_one_exposure_are_a_pair_whichever_comes_first() -> None:
    pairing = Pairing(VisionConfig())
    assert _put(pairing, _shot(1000), _shot(1002, "right")) == [(1000, 1002)]
    assert _put(pairing, _shot(1200, "right"), _shot(1201)) == [(1201, 1200)]


def test_images_too_far_apart_are_not() -> None:
    pairing = Pairing(VisionConfig(pair_ms=5.0, patience_ms=100.0))
    assert _put(pairing, _shot(1000), _shot(1006, "right")) == []


def test_one_that_waits_in_vain_goes_alone() -> None:
    pairing = Pairing(VisionConfig(patience_ms=100.0))
    assert _put(pairing, _shot(1000)) == []
    assert pairing.overdue(round(1129 * MS)) == []
    (pair,) = pairing.overdue(round(1131 * MS))
    assert pair == Pair(_shot(1000), None)
    assert pairing.overdue(2 * SECOND) == []


def test_an_image_whose_other_was_lost_gives_way_to_the_next_pair() -> None:
    pairing = Pairing(VisionConfig(patience_ms=1000.0))
    assert _put(pairing, _shot(1000), _shot(1250), _shot(1250, "right")) == [(1250, 1250)]
    assert pairing.overdue(10 * SECOND) == []


def test_at_most_most_hz_go_on_and_none_twice() -> None:
    pairing = Pairing(VisionConfig(most_hz=10.0))
    seen = [p for k in range(30) for p in _put(pairing, _shot(1000 + 100 / 3 * k), _shot(1000 + 100 / 3 * k, "right"))]
    assert len(seen) == 10
    assert _put(pairing, _shot(1000), _shot(1000, "right")) == []  # long gone


def test_a_clock_that_begins_again_is_followed() -> None:
    pairing = Pairing(VisionConfig())
    assert len(_put(pairing, _shot(50_000), _shot(50_000, "right"))) == 1
    assert len(_put(pairing, _shot(100), _shot(100, "right"))) == 1


def _estimate(t_ns: int = SECOND) -> Estimate:
    nav = np.zeros(X.SIZE)
    nav[X.P], nav[X.V], nav[X.Q] = (1.0, 2.0, -30.0), (4.0, 0.0, -1.0), so3.from_euler(0.1, -0.2, 1.0)
    a = np.random.default_rng(1).standard_normal((E.SIZE, E.SIZE))
    return Estimate(t_ns, t_ns, nav, a @ a.T * 1e-3, (0.0, 0.0, 0.5), Mode.AIDED, 0, t_ns)


def test_the_prior_is_carried_to_the_exposure() -> None:
    p_n, q, _ = prior_at(_estimate(), SECOND + 20 * MS)
    np.testing.assert_allclose(p_n, [1.08, 2.0, -30.02])
    turned = so3.matrix(so3.from_euler(0.1, -0.2, 1.0)).T @ so3.matrix(q)
    np.testing.assert_allclose(so3.quat_log(so3.from_matrix(turned)), [0.0, 0.0, 0.01], atol=1e-12)


def test_its_attitude_error_is_about_the_axes_of_n() -> None:
    """Drawn: body-axes errors theta with P; R exp(theta) = exp(R theta) R."""
    estimate = _estimate()
    _, q, covariance = prior_at(estimate, estimate.t_ns)
    R = so3.matrix(np.ascontiguousarray(q))
    P = estimate.covariance
    np.testing.assert_allclose(covariance[3:, 3:], R @ P[E.THETA, E.THETA] @ R.T, atol=1e-15)
    np.testing.assert_allclose(covariance[:3, 3:], P[E.P, E.THETA] @ R.T, atol=1e-15)
    np.testing.assert_allclose(covariance[:3, :3], P[E.P, E.P], atol=1e-15)
    np.testing.assert_array_equal(covariance, covariance.T)


def test_a_request_names_its_images_and_takes_the_nearest_estimate() -> None:
    track = Track()
    track.note([_estimate(SECOND - 50 * MS), _estimate(SECOND), _estimate(SECOND + 50 * MS)])
    request = track.request(Pair(_shot(1010), None), 2 * SECOND, run=3)
    assert request is not None
    assert (request.t_ns, request.run) == (1010 * MS, 3)
    assert (request.left, request.right) == (ImageName("/left/image", 1010 * MS), None)
    assert request.p_n[0] == pytest.approx(1.04)
    assert math.hypot(*request.q_nb_wxyz) == pytest.approx(1.0)


def test_where_nobody_knows_the_position_nothing_is_asked() -> None:
    track = Track()
    assert track.request(Pair(_shot(1010), None), 2 * SECOND) is None
    track.note([_estimate(SECOND)])
    assert track.request(Pair(_shot(1500), None), 2 * SECOND) is None
