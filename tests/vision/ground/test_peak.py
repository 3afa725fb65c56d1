"""A fix by the peak of the search alone: drawn ground in another season, true poses, drawn priors; blocks never agree."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from models import so3
from models.messages import Array
from models.prior import Prior
from tests import long
from tests.vision.ground import scene
from vision.ground.image import GroundImage, Heights
from vision.ground.orientation import coefficient, directions
from vision.ground.peak import PeakConfig, fit_peak, peak_flaw
from vision.ground.registration import register
from vision.ground.search import NotRegistered, Peak, RegistrationConfig, structure
from vision.pose.pose import difference

_SIGMA = np.array([8.0, 8.0, 3.0, 0.01, 0.01, 0.03])
_NO_BLOCKS = RegistrationConfig(least_blocks=10**6)


def _case(seed: int, known: Array | None = None) -> tuple[Array, Array, Prior, GroundImage, Peak | None]:
    rng = np.random.default_rng(seed)
    map_image = scene.map_image(scene.drawing(seed, 1) if known is None else known)
    p_n, R_nb, prior = scene.flight(rng, _SIGMA)
    found = register(scene.RIG, scene.shot(scene.drawing(seed), p_n, R_nb, rng), prior, map_image, _NO_BLOCKS)
    assert isinstance(found, NotRegistered)
    return p_n, R_nb, prior, map_image, found.peak


def test_the_peak_is_a_partial_fix_whose_covariance_holds() -> None:
    """North and east alone: two directions, height and yaw of the joint are the prior's."""
    alone, joint = [], []
    for seed in range(12):
        p_n, R_nb, prior, map_image, peak = _case(seed)
        assert peak is not None
        fit = fit_peak(scene.RIG, prior, map_image, peak)
        assert not isinstance(fit, str), (seed, fit)
        assert fit.directions is not None
        assert fit.directions.shape == (2, 6)
        alone.append(scene.chi_square(fit, p_n, R_nb) / 3.0)  # of 2
        e = difference(p_n, R_nb, fit.joint_p_n, so3.from_matrix(np.ascontiguousarray(fit.joint_R_nb)))
        joint.append(float(e @ np.linalg.solve(fit.joint_covariance, e)))
        assert fit.joint_covariance[2, 2] == pytest.approx(prior.covariance[2, 2], rel=0.05)
        assert np.diag(fit.joint_covariance)[:2].max() < 0.1 * prior.covariance[0, 0]
    assert max(alone) < chi2.ppf(1.0 - 1e-4, 2)
    assert max(joint) < chi2.ppf(1.0 - 1e-4, 6)
    assert 0.05 < np.mean(alone) / 2.0 < 1.4


@long.parametrize("decoy", ["turned", "another place", "another ground"])
def test_a_wrong_map_has_no_such_peak(decoy: str) -> None:
    for seed in range(12):
        ground = scene.drawing(seed)
        known = {
            "turned": ground[::-1, ::-1],
            "another place": np.roll(ground, 500, (0, 1)),
            "another ground": scene.drawing(seed + 99),
        }[decoy]
        peak = _case(seed, known)[-1]
        assert peak is None or peak_flaw(peak, PeakConfig())


def test_each_condition_counts() -> None:
    *_, prior, map_image, peak = _case(0)
    assert peak is not None
    for change, said in (
        ({"ratio": 1.24}, "times the second"),
        ({"correlation": 0.19}, "correlation 0.19"),
        ({"deviations": 4.9, "oriented": 0.19}, "needed 5"),
        ({"deviations": 2.9}, "needed 3"),
        ({"curvature": None}, "no single peak"),
    ):
        flaw = fit_peak(scene.RIG, prior, map_image, replace(peak, **change))
        assert isinstance(flaw, str)
        assert said in flaw


def test_the_less_is_explained_the_less_is_claimed() -> None:
    """What moves the peak is common to all images: it does not average out."""
    *_, prior, map_image, peak = _case(0)
    map_image = replace(map_image, heights=Heights.level(float(map_image.heights.down[0, 0])))
    assert peak is not None
    sigma = []
    for rho in (0.8, 0.4, 0.25):
        fit = fit_peak(scene.RIG, prior, map_image, replace(peak, correlation=rho))
        assert not isinstance(fit, str)
        assert fit.directions is not None
        sigma.append(float(np.sqrt(np.trace(fit.directions @ fit.covariance_common @ fit.directions.T))))
    assert sigma[0] < sigma[1] < sigma[2]


@pytest.mark.parametrize(
    ("turned", "shifted", "least", "most"), [(0, 0, 0.99, 1.01), (0, 1, 0.9, 1.01), (1, 0, -0.1, 0.1), (0, 20, -0.1, 0.1)]
)
def test_edges_lie_the_same_way_where_the_image_is(turned: int, shifted: int, least: float, most: float) -> None:
    """One point beside the position is near enough; turned by an eighth, or elsewhere, the coefficient is none."""
    view = np.asarray(scene.drawing(3)[400:560, 400:560], dtype=np.float32)
    whole = directions(view, structure(view))
    part = whole[30:126, 30:126]
    if turned:
        part = np.stack((-part[..., 1], part[..., 0]), axis=-1)
    found = coefficient(whole, np.ascontiguousarray(part), np.ones((96, 96), np.float32), (30, 30 + shifted))
    assert least < found < most
