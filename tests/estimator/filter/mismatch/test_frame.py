"""Axes and unit of pose fixes, by the IMU: the frame that they are in is named, and nothing else is taken for one."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.mismatch import Frame
from estimator.filter.mismatch.frame import Moments
from models.frames import ENU_FROM_NED, FLU_FROM_FRD
from models.messages import GnssFix, ImuSample, Input, PoseFix, Reason, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.scenes import SECOND, fly, position_errors, radii, simulated, within

Change = Callable[[PoseFix], PoseFix]
_FLIGHT = 'duration_s = 60.0\n[vehicle]\nkind = "{kind}"\n[imu]\nrate_hz = 100.0\n[pose_fix]\nrate_hz = 2.0\n'
SWAPPED, OTHER = "positions are (east, north, up)", "/other"


@pytest.fixture(scope="module", params=["multirotor", "fixed_wing"])
def flight(request: pytest.FixtureRequest) -> Simulation:
    return simulated(_FLIGHT.format(kind=request.param), seed=3)


def _moved(fix: PoseFix, m: object) -> PoseFix:
    return replace(fix, p_n=vec3(np.asarray(m) @ np.array(fix.p_n)))


def _turned(fix: PoseFix, change: Callable[[Rotation], Rotation]) -> PoseFix:
    w, x, y, z = change(Rotation.from_quat(fix.q_nb_wxyz, scalar_first=True)).as_quat(scalar_first=True).tolist()
    return replace(fix, q_nb_wxyz=(w, x, y, z))


def _enu(fix: PoseFix) -> PoseFix:
    T, F = ENU_FROM_NED, FLU_FROM_FRD
    return _turned(_moved(fix, T), lambda R: Rotation.from_matrix(T @ R.as_matrix() @ F))


def _late(fix: PoseFix) -> PoseFix:
    return replace(fix, t_ns=fix.t_ns + SECOND // 4)


def _said(messages: Sequence[Input], change: Change) -> str | None:
    """What is said in the end; it does not change its words."""
    samples, frame, said = ImuBuffer(), None, list[str]()
    for m in messages:
        if isinstance(m, ImuSample):
            samples.insert(m)
    for m in sorted((change(m) for m in messages if isinstance(m, PoseFix)), key=lambda fix: fix.t_ns):
        p_n, q = np.array(m.p_n), np.array(m.q_nb_wxyz)
        frame = Frame.of(m.t_ns, p_n, q) if frame is None else frame.also(m.t_ns, p_n, q, samples)
        said += [frame.says] if frame.says and frame.says not in said else []
    assert len(said) <= 1
    return None if frame is None else frame.says


def _moments(a: object, m: object, seed: int = 1) -> Moments:
    """Of changes of velocity a (n, 3) that fixes show as m a."""
    rng, found = np.random.default_rng(100 + seed), Moments(EPOCH_NS, np.zeros((2, 7, 7)), np.eye(3)[0])
    for row in np.asarray(a, dtype=float):
        by_fixes = np.asarray(m) @ row + rng.normal(0.0, 0.1, 3)
        found = found.also(np.zeros((2, 2, 7)), np.full((2, 2, 7), [1.0, *row, *by_fixes]), np.zeros(3))
    return found


@pytest.mark.parametrize("seed", range(8))
def test_a_frame_that_another_explains_as_well_is_not_shown(seed: int) -> None:
    """Level flight: the sign of the height cannot be seen; of two frames that are as good the one with fewer changes is named."""
    level = np.random.default_rng(seed).normal(0.0, 1.0, (60, 3)) * [1.0, 1.0, 0.005]
    assert _moments(level, np.eye(3), seed).verdict is None
    found = _moments(level, np.diag([1.0, -1.0, 1.0]), seed).verdict
    if found is not None:
        np.testing.assert_array_equal(found[1], np.diag([1.0, -1.0, 1.0]))


def test_a_turn_that_no_exchange_of_axes_makes_is_none() -> None:
    """All motion along one diagonal: exchanged axes are near to a turn of 60 degrees, but another map is better."""
    rng = np.random.default_rng(3)
    along = rng.normal(0.0, 1.0, (40, 1)) * [1.0, 0.2, 0.0] + rng.normal(0.0, 0.2, (40, 3))
    turn = Rotation.from_euler("z", 60.0, degrees=True).as_matrix()
    assert _moments(along, turn).verdict is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: _moved(f, ENU_FROM_NED), SWAPPED),
        (lambda f: _moved(f, np.diag([1.0, -1.0, 1.0])), "positions are (north, west, down)"),
        (_enu, f"{SWAPPED}, its attitudes are in ENU and FLU"),
        (lambda f: _moved(f, 100.0 * np.eye(3)), "the metres: centimetres?"),
        (lambda f: _moved(f, np.eye(3) / 0.3048), "the metres: feet?"),
        (lambda f: _moved(f, 0.001 * np.eye(3)), "the metres: kilometres?"),
        (lambda f: _moved(f, 7.0 * np.eye(3)), "the metres, not"),
    ],
)
def test_fixes_in_other_axes_or_another_unit_are_named(flight: Simulation, change: Change, says: str) -> None:
    said = _said(flight.messages, change)
    assert said is not None
    assert says in said


@pytest.mark.parametrize(
    "change",
    [
        lambda f: f,
        _late,
        lambda f: _moved(f, 1.3 * np.eye(3)),
        lambda f: _turned(f, lambda R: Rotation.from_euler("z", 30.0, degrees=True) * R),
        lambda f: _turned(f, lambda R: Rotation.from_euler("z", 90.0, degrees=True) * R),
        lambda f: _moved(f, np.diag([-1.0, -1.0, 1.0])),
        lambda f: _turned(f, lambda R: R * Rotation.from_euler("y", 15.0, degrees=True)),
        lambda f: _turned(f, lambda R: R.inv()),
        lambda f: replace(f, q_nb_wxyz=(1.0, 0.0, 0.0, 0.0)),
        lambda f: _moved(f, np.zeros((3, 3))),
        lambda f: replace(f, p_n=vec3(np.random.default_rng(f.t_ns).normal(0.0, 9.0, 3))),
    ],
    ids=[
        "sound",
        "late",
        "scaled",
        "heading",
        "quarter-turn",
        "half-turn",
        "camera",
        "inverse",
        "no-attitude",
        "nowhere",
        "noise",
    ],
)
def test_nothing_else_is_taken_for_a_frame(flight: Simulation, change: Change) -> None:
    assert not _said(flight.messages, change)


@pytest.mark.parametrize("angle_deg", [20.0, 90.0, 180.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_imu_that_is_mounted_otherwise_says_nothing_of_the_fixes(flight: Simulation, axis: int, angle_deg: float) -> None:
    mount = Rotation.from_rotvec(np.radians(angle_deg) * np.eye(3)[axis])
    messages = [
        replace(m, gyro_b=vec3(mount.apply(m.gyro_b)), accel_b=vec3(mount.apply(m.accel_b))) if isinstance(m, ImuSample) else m
        for m in flight.messages
    ]
    assert not _said(messages, lambda f: f)


@pytest.mark.parametrize("seed", range(8))
def test_sound_fixes_are_in_their_frame_for_every_flight(seed: int) -> None:
    toml = _FLIGHT.format(kind="multirotor").replace(
        "rate_hz = 2.0", "rate_hz = 5.0\nsigma_m = [0.4, 0.4, 0.4]\noutlier_share = 0.05"
    )
    assert not _said(simulated(toml, seed).messages, lambda f: f)


def test_once_shown_it_stays_until_the_fixes_are_right(flight: Simulation) -> None:
    def until(fix: PoseFix, end_s: float) -> PoseFix:
        return _moved(fix, np.eye(3) * (100.0 if fix.t_ns < EPOCH_NS + end_s * 1e9 else 1.0))

    assert "centimetres" in (_said(flight.messages, lambda f: until(f, 60.0)) or "")
    longer = simulated(_FLIGHT.format(kind="fixed_wing").replace("60.0", "200.0"), seed=3)
    assert not _said(longer.messages, lambda f: until(f, 40.0))


def test_a_flight_with_fixes_in_other_axes_alone_ends_the_estimate_with_the_reason() -> None:
    flight = simulated(_FLIGHT.format(kind="fixed_wing"), seed=3)
    run = fly(flight, messages=[_moved(m, ENU_FROM_NED) if isinstance(m, PoseFix) else m for m in flight.messages])
    assert within(run.estimates, 5.0, 60.0)
    assert not within(run.estimates, 40.0, 60.0)
    assert SWAPPED in run.health[-1].detail
    assert {s.reason for s in run.statuses[-5:]} == {Reason.IMPLAUSIBLE}
    assert run.internal_errors() == []


_TWO = "duration_s = 60.0\n[imu]\nrate_hz = 100.0\n[gnss]\nrate_hz = 5.0\n[pose_fix]\nrate_hz = 2.0\n"


@pytest.mark.parametrize(("k", "unit"), [(100.0, "centimetres"), (1.0 / 0.3048, "feet"), (0.001, "kilometres")])
@pytest.mark.parametrize("known", [6, 3], ids=["poses", "positions"])
def test_a_receiver_leads(k: float, unit: str, known: int) -> None:
    flight = simulated(_TWO, seed=3)
    scale, given = k * np.eye(3), np.diag([0.0] * known + [math.inf] * (6 - known))
    messages = [
        replace(_moved(m, scale), covariance=m.covariance + given) if isinstance(m, PoseFix) else m for m in flight.messages
    ]
    run = fly(flight, messages=messages)
    found = within(run.estimates, 5.0, 60.0)
    assert np.mean(position_errors(found, flight.truth) > 3.0 * radii(found)) < 0.01
    assert position_errors(within(run.estimates, 45.0, 60.0), flight.truth).max() < 5.0
    assert unit in run.health[-1].detail
    assert math.isfinite(run.health[-1].radius95_m)
    assert run.internal_errors() == []


def test_another_source_of_fixes_goes_on() -> None:
    """The wrong one came first and led."""
    flight = simulated(_FLIGHT.format(kind="fixed_wing"), seed=3)
    wrong = [_moved(replace(m, topic=OTHER), ENU_FROM_NED) for m in flight.messages if isinstance(m, PoseFix)]
    messages = sorted([*flight.messages, *wrong], key=lambda m: m.t_ns)
    run = fly(flight, messages=messages)
    found = within(run.estimates, 40.0, 60.0)
    assert position_errors(found, flight.truth).max() < 2.0
    assert radii(found).max() < 3.0
    assert f"{OTHER} is" not in run.health[-1].detail
    assert "positions are" in run.health[-1].detail


def test_a_receiver_that_was_lost_long_ago_keeps_nothing() -> None:
    flight = simulated(_TWO.replace("[imu]", '[vehicle]\nkind = "fixed_wing"\n[imu]'), seed=3)
    early = EPOCH_NS + 2 * SECOND
    messages = [
        _moved(m, ENU_FROM_NED) if isinstance(m, PoseFix) else m
        for m in flight.messages
        if not (isinstance(m, GnssFix) and m.t_ns > early)
    ]
    run = fly(flight, messages=messages)
    assert not within(run.estimates, 50.0, 60.0)


def _compared(k: float, seconds: range, before: Frame | None = None) -> Frame:
    """Fixes each second on a circle of 20 m, in a unit of which a metre has k, compared with a receiver."""
    frame = before
    for t_s in seconds:
        t_ns, p_n = EPOCH_NS + t_s * SECOND, np.array([20.0 * math.cos(0.3 * t_s), 20.0 * math.sin(0.3 * t_s), -5.0])
        frame = (frame or Frame.of(t_ns, k * p_n, np.array([1.0, 0.0, 0.0, 0.0]))).compared(t_ns, k * p_n, p_n)
    assert frame is not None
    return frame


def test_a_unit_that_changes_in_flight_is_named_within_a_minute() -> None:
    sound = _compared(1.0, range(200))
    assert sound.says is None
    assert "feet" in (_compared(1.0 / 0.3048, range(200, 260), sound).says or "")


def test_a_path_is_turned_for_a_minute_while_its_fixes_are_used() -> None:
    """30 fixes 1.5 times as far apart as the receiver's positions, which is no unit."""
    scaled = _compared(1.5, range(30))
    assert scaled.says is None
    assert scaled.is_turned(EPOCH_NS + 30 * SECOND)
    assert not scaled.is_turned(EPOCH_NS + 90 * SECOND)
    assert not replace(scaled, says="in another frame").is_turned(EPOCH_NS + 30 * SECOND)
    assert not _compared(1.0, range(30)).is_turned(EPOCH_NS + 30 * SECOND)


def test_another_receiver_takes_over_where_the_first_is_silent() -> None:
    flight, found = simulated(_TWO, seed=3), list[Input]()
    for m in flight.messages:
        is_other = isinstance(m, GnssFix) and m.t_ns > EPOCH_NS + 5 * SECOND
        found.append(replace(m, topic=OTHER) if is_other and isinstance(m, GnssFix) else m)
    path = fly(flight, messages=found).fusion._history.tracker.frames["/pose_fix"].path
    assert EPOCH_NS * 1e-9 + 30.0 < path.t < EPOCH_NS * 1e-9 + 60.0


def test_what_the_imu_has_shown_stays() -> None:
    right = replace(_compared(1.0, range(5)), says="")
    assert _compared(100.0, range(5, 60), right).says == ""


def test_fixes_are_compared_with_one_receiver_and_with_its_position_of_the_last_second() -> None:
    """It ends after 15 s, another one is 500 m off: 29 fixes of 2 Hz until then and two after it."""
    flight, found = simulated(_TWO, seed=3), list[Input]()
    for m in flight.messages:
        if not isinstance(m, GnssFix):
            found.append(m)
        elif m.t_ns < EPOCH_NS + 15 * SECOND:
            later = {"t_ns": m.t_ns + SECOND // 10, "arrived_ns": m.arrived_ns + SECOND // 10}
            found += [m, replace(m, topic=OTHER, lat_deg=m.lat_deg + 0.005, **later)]
    found.sort(key=lambda m: m.arrived_ns)
    path = fly(flight, messages=found).fusion._history.tracker.frames["/pose_fix"].path
    assert 28 <= path.n <= 34
    assert path.gg < 100.0 * path.n  # m^2: no jump of 500 m
