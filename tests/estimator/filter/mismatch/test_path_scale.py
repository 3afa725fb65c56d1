"""The scale between the paths of two sources: fixes in a wrong unit are named, and nothing else is taken for one."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.mismatch.path_scale import Moments, PathScale
from estimator.sources.base.aid import Aid
from estimator.sources.gnss import GnssConfig, position_aid
from estimator.sources.pose import PoseConfig, pose_aid
from models.frames import Origin
from models.messages import Array, GnssFix, Input, PoseFix, Reason, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, fly, position_errors, simulated, within

ORIGIN = Origin(47.0, 8.0, 500.0)
FIX = "/pose_fix"


def _circle(t_s: float) -> Array:
    return np.array([20.0 * math.sin(0.3 * t_s), 20.0 * (1.0 - math.cos(0.3 * t_s)), -10.0 - t_s])


def _straight(t_s: float) -> Array:
    return np.array([12.0 * t_s, 3.0, -50.0])


def _hover(t_s: float) -> Array:
    return np.array([5.0, 3.0, -50.0]) + 0.2 * np.array([math.sin(t_s), math.cos(1.3 * t_s), 0.0])


def _after(
    seconds: float,
    path: Callable[[float], Array],
    unit: float,
    *,
    pull_m_s: float = 0.0,
    pull_from_s: float = 0.0,
    begun: PathScale | None = None,
    seed: int = 4,
) -> PathScale:
    """GNSS at 5 Hz with 1 m of noise, fixes at 2 Hz with 0.1 m, in another unit."""
    rng, scale = np.random.default_rng(seed), begun or PathScale()
    from_ns = EPOCH_NS if begun is None or begun.last is None else begun.last[0] + SECOND // 5
    for k in range(round(10 * seconds)):
        t_ns, t_s = from_ns + k * SECOND // 10, 0.1 * k
        aids: list[Aid] = []
        if k % 2 == 0:
            pulled = path(t_s) + np.array([0.0, pull_m_s * max(t_s - pull_from_s, 0.0), 0.0]) + rng.normal(0.0, 1.0, 3)
            gnss = position_aid(GnssFix(t_ns, t_ns, *ORIGIN.to_geodetic(pulled), np.eye(3)), GnssConfig())
            assert isinstance(gnss, Aid)
            aids.append(gnss)
        if k % 5 == 0:
            p_n = vec3(unit * path(t_s) + rng.normal(0.0, 0.1 * max(unit, 1.0), 3))
            fix = pose_aid(PoseFix(t_ns, t_ns, p_n, (1.0, 0.0, 0.0, 0.0), 0.01 * np.eye(6), topic=FIX), PoseConfig())
            assert isinstance(fix, Aid)
            aids.append(fix)
        for aid in aids:
            z = aid.measurement(ORIGIN)
            assert z is not None
            assert not isinstance(z, tuple)
            scale = scale.also(aid, z)
    return scale


@pytest.mark.parametrize(
    ("unit", "name"), [(100.0, "centimetres"), (1000.0, "millimetres"), (3.2808, "feet"), (7.0, ""), (0.1, "")]
)
def test_the_unit_of_fixes_is_found_beside_gnss(unit: float, name: str) -> None:
    why = _after(15.0, _circle, unit).objection(FIX)
    assert why.startswith("scale ")
    assert why.endswith(f": {name}?" if name else "/gnss")
    assert float(why.split()[1]) == pytest.approx(unit, rel=0.1)


@pytest.mark.parametrize("path", [_circle, _straight, _hover])
@pytest.mark.parametrize("pull_m_s", [0.0, 0.5, 3.0, 20.0])
def test_metres_are_metres_also_while_the_receiver_is_pulled_off(path: Callable[[float], Array], pull_m_s: float) -> None:
    assert _after(60.0, path, 1.0, pull_m_s=pull_m_s).objection(FIX) == ""


@pytest.mark.parametrize("turn", np.linspace(0.0, 5.5, 12))
def test_a_pull_that_begins_within_the_minute_is_no_scale(turn: float) -> None:
    """The bend of its path goes with some part of a slow motion; more of it is left."""

    def path(t_s: float) -> Array:
        return np.array([5.0, 4.0 * math.sin(0.15 * t_s + turn), -50.0])

    for end_s in range(32, 60, 2):
        assert _after(float(end_s), path, 1.0, pull_m_s=3.0, pull_from_s=30.0).objection(FIX) == ""


def test_fixes_that_do_not_move_are_in_no_unit() -> None:
    assert _after(30.0, _circle, 0.0).objection(FIX) == ""


def test_a_hover_shows_no_scale() -> None:
    assert _after(60.0, _hover, 3.28).objection(FIX) == ""


@pytest.mark.parametrize(("motion_m", "scale"), [(1.0, None), (20.0, 0.1)])
def test_a_scale_that_makes_less_than_metres_is_chance(motion_m: float, scale: float | None) -> None:
    moments, rng = Moments(EPOCH_NS, np.zeros(3), np.zeros(3), np.zeros((8, 8))), np.random.default_rng(1)
    for k in range(8):
        g = motion_m * rng.normal(size=3)
        moments = moments.also(EPOCH_NS + k * SECOND, g, 0.1 * g)
    assert moments.scale == (None if scale is None else pytest.approx(scale))


def test_at_rest_the_noise_of_gnss_is_no_motion() -> None:
    for seed in range(300):
        assert _after(3.1, lambda _: np.array([5.0, 3.0, -50.0]), 1.0, seed=seed).objection(FIX) == ""


def test_it_is_forgotten_when_the_fixes_are_in_metres_again_and_not_before() -> None:
    wrong = _after(15.0, _circle, 100.0)
    assert wrong.objection(FIX)
    assert _after(10.0, _hover, 100.0, begun=wrong).objection(FIX)
    assert _after(600.0, _circle, 1.0, begun=wrong).objection(FIX) == ""


def test_a_flight_with_fixes_in_centimetres_follows_gnss_and_reports_why() -> None:
    flight = simulated("duration_s = 40.0\n[imu]\nrate_hz = 100.0\n[gnss]\nrate_hz = 5.0\n[pose_fix]\nrate_hz = 2.0\n", seed=3)
    messages: list[Input] = [
        replace(m, p_n=vec3(100.0 * np.array(m.p_n))) if isinstance(m, PoseFix) else m for m in flight.messages
    ]
    run = fly(flight, messages=messages)
    found = within(run.estimates, 5.0, 40.0)
    off = position_errors(found, flight.truth)
    radius = np.array([2.8 * math.sqrt(np.linalg.eigvalsh(e.covariance[E.P, E.P])[-1]) for e in found])
    assert (off > 3.0 * radius).mean() < 0.01
    assert position_errors(within(run.estimates, 35.0, 40.0), flight.truth).max() < 5.0
    refused = [s for s in run.statuses if s.reason is Reason.IMPLAUSIBLE]
    assert {s.topic for s in refused} == {FIX}
    assert refused[-1].detail.endswith("between /pose_fix and /gnss: centimetres?")
    assert "centimetres?" in run.health[-1].detail
    tracker = run.fusion._history.advance(run.estimates[-1].t_ns)
    assert tracker.core.absolute == {FIX, "/gnss"}
    assert tracker.core.absolute <= tracker.sources.keys()  # what a conflict names is there
    assert run.internal_errors() == []
