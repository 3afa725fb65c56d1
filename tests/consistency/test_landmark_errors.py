"""Fixes on landmarks whose places are wrong by what their map says: the filter stays as sure as it may be."""

from collections.abc import Sequence
from typing import TypeAlias

import msgspec
import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import MOST_OF_A_KIND, innovation
from estimator.sources.base.aid import Aid
from estimator.sources.pose import LandmarkFixConfig, pose_aid
from models.imu import Coast, ImuNoise, constants
from models.messages import Array, LandmarkFix, vec3
from models.state import E, X
from tests import long

SIGMA_MAP_M, SIGMA_FIX_M, SIGMA_RAD = 0.5, 0.1, 0.01
Q = (1.0, 0.0, 0.0, 0.0)
Visits: TypeAlias = Sequence[tuple[str, ...]]


def _fix(names: tuple[str, ...], shifts: dict[str, Array], rng: np.random.Generator, k: int) -> LandmarkFix:
    """A fix at the origin that is off by the mean of its landmarks' errors."""
    share = SIGMA_MAP_M / len(names) * np.eye(6)[:, :3]
    off = sum(shifts[name] for name in names) / len(names) + SIGMA_FIX_M * rng.standard_normal(3)
    x, y, z = (0.5 * SIGMA_RAD * rng.standard_normal(3)).tolist()
    cov = np.diag([SIGMA_FIX_M**2] * 3 + [SIGMA_RAD**2] * 3)
    common = len(names) * share @ share.T
    errors = np.array([share] * len(names))
    return LandmarkFix(k, k, vec3(off), (1.0, x, y, z), cov, common, names, 0.9, 0.3, errors)


def _fly(visits: Visits, seed: int) -> tuple[Array, Eskf]:
    rng = np.random.default_rng(seed)
    shifts = {name: SIGMA_MAP_M * rng.standard_normal(3) for names in visits for name in names}
    x = np.zeros(X.SIZE)
    x[X.Q] = Q
    eskf = Eskf(0, x, np.diag([100.0] * 3 + [1.0] * 3 + [0.01] * 3 + [1e-4] * 6), constants(ImuNoise(), Coast(), None))
    for k, names in enumerate(visits):
        aid = pose_aid(_fix(names, shifts, rng, k), LandmarkFixConfig(lasting_share=0.0))
        assert isinstance(aid, Aid)
        z = aid.measurement(None)
        assert z is not None
        eskf.update(innovation(eskf, aid, z, np.zeros(3)))
    return eskf.x[X.P].copy(), eskf


VISITS: dict[str, Visits] = {
    "one for long": [("a",)] * 40,
    "one, then another": [("a",)] * 20 + [("b",)] * 20,
    "two that overlap": [("a",), ("a", "b"), ("b",)] * 13,
    "away and back": [("a",)] * 10 + [("b",)] * 10 + [("a",)] * 10,
    "more than are kept": [(f"{k % (MOST_OF_A_KIND + 4)}",) for k in range(40)],
}


@long.parametrize("name", VISITS)
def test_position_is_consistent(name: str) -> None:
    runs = [_fly(VISITS[name], seed) for seed in range(60)]
    nees = np.mean([error @ np.linalg.solve(eskf.cov[E.P, E.P], error) for error, eskf in runs]) / 3.0
    forgetful = name == "more than are kept"  # a vehicle that never moves and forgets its landmarks: the limit
    assert 0.73 < nees < (4.0 if forgetful else 1.31)  # 99 % band of 180 degrees of freedom


def test_two_landmarks_are_worth_more_than_one_and_fixes_on_one_are_worth_no_more() -> None:
    stays: tuple[Visits, ...] = [("a",)] * 5, [("a",)] * 50, [("a",)] * 25 + [("b",)] * 25
    one, long, two = (_fly(visits, 0)[1] for visits in stays)
    sigma = [float(np.sqrt(eskf.cov[0, 0])) for eskf in (one, long, two)]
    assert sigma[1] == pytest.approx(SIGMA_MAP_M, rel=0.02)
    assert sigma[0] == pytest.approx(sigma[1], rel=0.02)
    assert sigma[2] == pytest.approx(SIGMA_MAP_M / np.sqrt(2.0), rel=0.03)


def test_as_many_are_kept_as_shall_be() -> None:
    _, eskf = _fly(VISITS["more than are kept"], 0)
    assert len(eskf.slow.columns) == MOST_OF_A_KIND
    assert len(eskf.cov) == E.SIZE + 3 * MOST_OF_A_KIND


def test_a_fix_on_as_many_landmarks_as_are_kept_beside_others_and_a_rig_is_fused() -> None:
    names = [f"{k}" for k in range(2 * MOST_OF_A_KIND)]
    rng = np.random.default_rng(4)
    x = np.zeros(X.SIZE)
    x[X.Q] = Q
    eskf = Eskf(0, x, np.eye(E.SIZE), constants(ImuNoise(), Coast(), None))
    for k in range(20):
        seen = tuple(rng.permutation(names)[: rng.integers(1, MOST_OF_A_KIND + 1)].tolist())
        fix = msgspec.structs.replace(_fix(seen, dict.fromkeys(names, np.zeros(3)), rng, k), covariance_rig=1e-4 * np.eye(6))
        aid = pose_aid(fix, LandmarkFixConfig(lasting_share=0.0))
        assert isinstance(aid, Aid)
        z = aid.measurement(None)
        assert z is not None
        eskf.update(innovation(eskf, aid, z, np.zeros(3)))
        assert len(eskf.slow.columns) <= MOST_OF_A_KIND + 1
    assert "/landfix/fix.rig" in eskf.slow.columns


def test_a_new_landmark_of_a_fix_does_not_make_room_at_the_cost_of_a_known_one_of_it() -> None:
    _, eskf = _fly([(f"{k}",) for k in range(MOST_OF_A_KIND)], 0)
    rng, none = np.random.default_rng(0), np.zeros(3)
    aid = pose_aid(_fix(("new", "0"), {"new": none, "0": none}, rng, 99), LandmarkFixConfig(lasting_share=0.0))
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    innovation(eskf, aid, z, none)
    columns = eskf.slow.columns
    assert "/landfix/fix/1" not in columns
    assert np.abs(eskf.cov[E.P, columns["/landfix/fix/0"]]).max() > 0.01  # what is known of it is kept
    assert not eskf.cov[E.P, columns["/landfix/fix/new"]].any()
