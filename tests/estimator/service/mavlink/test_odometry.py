"""Odometry over MAVLink: bytes that pymavlink has packed, against the motion that they were made of."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as mavlink

from estimator.service.mavlink import codec
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.flow_range import FlowRange
from estimator.service.mavlink.inputs import Inputs
from estimator.service.mavlink.wire import Wire
from logs.wire.codec import Decoder, Topics, encode_input
from logs.wire.increments import Range
from models import so3
from models.messages import Array, Estimate, ImuSample, Mode, OdometryDelta, OdometryPose, Reading, Reason
from models.relative_pose import between
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import X
from tests.estimator.filter.relative.odometers import pose_at
from tests.estimator.scenes import Run, by_arrival, fly, position_errors, simulated

MS, SECOND = 1_000_000, 1_000_000_000
T0 = 1_795_000_000 * SECOND
CAMERA = 198
TOPICS = Topics(odometry=("/odometry",), odometry_delta=("/vision_delta",), optical_flow=("/flow",))
FLIGHT = """
duration_s = 80.0
[vehicle]
kind = "multirotor"
height_m = 30.0
[imu]
rate_hz = 100.0
grade = "hobby"
[pose_fix]
rate_hz = 2.0
"""
LOST_S, END_S = 35.0, 80.0


def _inputs(**settings: Any) -> Inputs:
    return Inputs(MavlinkConfig(odometry_from=(CAMERA,), imu=False), TOPICS, 0.0, **settings)


def _over_the_wire(message: Any, component: int = CAMERA) -> Any:
    """Packed by pymavlink, parsed by our codec."""
    wanted = _inputs().wanted
    wire = Wire(1, 197, frozenset({1, CAMERA}), wanted, None, 0)
    (read,) = wire.messages(bytes(message.pack(mavlink.MAVLink(None, 1, component))), whole=True)
    return read


def _delta(t_ns: int, step: Array, seconds: float, confidence: float = 80.0) -> Any:
    """VISION_POSITION_DELTA of a step (7,), dp seen in the body at its end."""
    R = so3.matrix(step[3:])
    return ardupilotmega.MAVLink_vision_position_delta_message(
        t_ns // 1000, round(seconds * 1e6), so3.quat_log(step[3:]).tolist(), (R.T @ step[:3]).tolist(), confidence
    )


def _flow(t_ns: int, flow: Array, turn: Array, us: int = 100_000, quality: int = 200, distance: float = -1.0) -> Any:
    return mavlink.MAVLink_optical_flow_rad_message(t_ns // 1000, 0, us, *flow, *turn, 0, quality, 0, distance)


def test_deltas_seen_in_the_later_body_are_turned_back_and_joined() -> None:
    """Ten steps of 50 ms become one increment of 0.5 s, whose motion is that from the first pose to the last."""
    rng, inputs = np.random.default_rng(2), _inputs()
    pose = np.array([1.0, 2.0, -30.0, *so3.from_euler(0.1, -0.2, 2.0)])
    first, got = pose, list[Any]()
    for k in range(10):
        step = np.array([0.3, 0.05, -0.1, *so3.quat_exp(0.1 * rng.standard_normal(3))])
        moved = np.concatenate((pose[:3] + so3.matrix(pose[3:]) @ step[:3], so3.multiply(pose[3:], step[3:])))
        t_ns = T0 + (k + 1) * 50 * MS
        got += inputs.odometry(_over_the_wire(_delta(t_ns, step, 0.05)), t_ns)
        pose = moved
    (delta,) = got
    assert isinstance(delta, OdometryDelta)
    true = between(first, pose)
    np.testing.assert_allclose(delta.dp_b, true[:3], atol=1e-5)
    np.testing.assert_allclose(so3.quat_log(so3.multiply(so3.conjugate(true[3:]), np.array(delta.dq_wxyz))), 0.0, atol=1e-5)
    assert (delta.t0_ns, delta.t_ns, delta.topic) == (T0, T0 + SECOND // 2, "/vision_delta")
    assert not delta.covariance.any()  # [odometry] says how uncertain it is


def test_a_step_that_is_missing_ends_an_increment_and_none_overlap() -> None:
    inputs, got = _inputs(), list[Any]()
    step = np.array([0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for k in (1, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16):
        t_ns = T0 + k * 50 * MS
        got += inputs.odometry(_over_the_wire(_delta(t_ns, step, 0.05)), t_ns)
    spans = [((d.t0_ns - T0) // MS, (d.t_ns - T0) // MS, round(d.dp_b[0], 3)) for d in got]
    assert spans == [(0, 150, 0.3), (250, 750, 1.0)]


def test_a_camera_without_confidence_is_ignored_and_nonsense_is_refused() -> None:
    inputs, step = _inputs(), np.array([0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert not list(inputs.odometry(_over_the_wire(_delta(T0, step, 0.6, confidence=0.0)), T0))
    for wrong in (_delta(T0, np.full(7, math.nan), 0.6), _delta(T0, step, 0.0), _delta(T0, step, 60.0)):
        with pytest.raises(ValueError, match="no motion over a time"):
            list(inputs.odometry(_over_the_wire(wrong), T0))


@pytest.mark.parametrize("climbs", [True, False])
def test_flow_over_a_range_is_motion_over_the_ground(climbs: bool) -> None:
    """10 m above ground, 3 m/s forward and 1 m/s to the right, while the body turns: 0.2 s are 0.6 and 0.2 m."""
    inputs, got = _inputs(), list[Any]()
    turn, r = np.array([0.02, -0.03, 0.05]), 10.0
    for k in (1, 2):
        seen = so3.matrix(so3.quat_exp(-0.5 * turn)) @ np.array([0.3, 0.1, 0.05 * climbs])
        flow = np.array([turn[0] - seen[1] / r, turn[1] + seen[0] / r])
        t_ns = T0 + k * 100 * MS
        got += inputs.measured(_over_the_wire(_flow(t_ns, flow, turn, distance=r), 1), t_ns, t_ns, codec.PX4)
    (delta,) = got
    steps = [np.array([0.3, 0.1, 0.0]), so3.matrix(so3.quat_exp(turn)) @ np.array([0.3, 0.1, 0.0])]
    np.testing.assert_allclose(delta.dp_b[:2], sum(steps)[:2], atol=0.004)  # what its climb mixes in is not known
    assert (delta.t0_ns, delta.t_ns, delta.topic) == (T0, T0 + 200 * MS, "/flow")
    variances = np.diag(delta.covariance)
    np.testing.assert_allclose(np.sqrt(variances[:2]), 10.0 * 0.15 * 0.1 * math.sqrt(2.0), rtol=1e-6)
    assert (variances[2:] < 0.0).all()
    assert delta.systematic is not None
    np.testing.assert_allclose(delta.systematic[:2, 0], math.hypot(0.03, 0.02) * np.array(delta.dp_b[:2]), rtol=1e-6)
    assert not delta.systematic[2:].any()
    written = encode_input(delta)
    read = Decoder(TOPICS).decode(*written, delta.t_ns)
    assert isinstance(read, OdometryDelta)
    np.testing.assert_array_equal(read.covariance[:2, :2], delta.covariance[:2, :2])
    assert (read.dp_b, read.topic, read.epoch) == (delta.dp_b, "/flow", 1)


def test_wheels_are_a_velocity_forward_and_not_sideways() -> None:
    """Two wheels at 20 Hz, one with 10 % more way: the mean, at the middle; a pause begins anew; nonsense is refused."""
    inputs = Inputs(MavlinkConfig(imu=False), Topics(velocity_body=("/wheels",)), 0.0)
    assert mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE in dict(inputs.requests(T0, codec.ARDUPILOT))
    wire = Wire(1, 197, frozenset({1}), inputs.wanted, None, 0)

    def hear(t_ns: int, *ways: float) -> list[Any]:
        message = mavlink.MAVLink_wheel_distance_message(t_ns // 1000, len(ways), [*ways, *[0.0] * (16 - len(ways))])
        (read,) = wire.messages(bytes(message.pack(mavlink.MAVLink(None, 1, 1))), whole=True)
        return list(inputs.measured(read, t_ns, t_ns, codec.ARDUPILOT))

    got = [reading for k in range(5) for reading in hear(T0 + 50 * k * MS, 0.1 * k, 0.11 * k)]
    got += [reading for k in range(3) for reading in hear(T0 + 10 * SECOND + 50 * k * MS, 50.0 - 0.1 * k, 50.0 - 0.1 * k)]
    assert [(m.t_ns - T0, m.arrived_ns - m.t_ns, m.topic) for m in got] == [
        (50 * MS, 50 * MS, "/wheels"), (150 * MS, 50 * MS, "/wheels"), (10_050 * MS, 50 * MS, "/wheels"),
    ]  # fmt: skip
    np.testing.assert_allclose([m.values for m in got], [(2.1, 0, 0), (2.1, 0, 0), (-2.0, 0, 0)], atol=1e-4)
    read = Decoder(Topics(velocity_body=("/wheels",))).decode(*encode_input(got[0]), got[0].arrived_ns)
    assert isinstance(read, Reading)
    assert read.values == got[0].values
    with pytest.raises(ValueError, match="distance is none"):
        hear(T0 + 11 * SECOND, math.inf, 1.0)
    with pytest.raises(ValueError, match="distance is none"):
        hear(T0 + 11 * SECOND, 1e308, 1e308)
    assert not hear(T0 + 12 * SECOND)


def test_a_flow_takes_the_range_of_the_message_of_a_finder_or_of_the_filter() -> None:
    nav = np.zeros(16)
    nav[X.P], nav[X.Q] = (0.0, 0.0, -22.0), so3.from_euler(math.radians(20.0), 0.0, 1.0)
    estimate = Estimate(T0, T0, nav, np.eye(15) * 0.25, (0.0, 0.0, 0.0), Mode.AIDED, 0, T0)
    silent = _over_the_wire(_flow(T0, np.zeros(2), np.zeros(3)), 1)
    of = FlowRange((2.0, 1.2))
    assert of.at(silent, T0) is None
    of.note_estimate(estimate)
    at = of.at(silent, T0)
    assert at is not None
    assert (at.metres, at.sigma_m) == pytest.approx((20.0 / math.cos(math.radians(20.0)), 1.3 / math.cos(math.radians(20.0))))
    assert of.at(silent, T0 + SECOND) is None  # an old estimate
    of.note_estimate(replace(estimate, covariance=np.eye(15) * 100.0))
    assert of.at(silent, T0) is None  # 10 of 20 m: no scale to estimate
    of.note_finder(T0, 18.0)
    assert of.at(silent, T0) == Range(18.0, 0.36, "finder")
    of.note_finder(T0, math.inf)
    assert of.at(silent, T0) is None
    own = of.at(_over_the_wire(_flow(T0, np.zeros(2), np.zeros(3), distance=7.0), 1), T0)
    assert own is not None
    assert (own.metres, own.kind) == (7.0, "flow")
    assert own.sigma_m == pytest.approx(0.14)


def test_another_source_of_the_range_is_another_epoch() -> None:
    """The error of its scale is another one."""
    inputs, epochs = _inputs(), list[int]()
    for k, distance in enumerate((10.0, 10.0, -1.0, -1.0)):
        inputs.flow_range.note_finder(T0, 10.0)
        t_ns = T0 + (k + 1) * 100 * MS
        message = _over_the_wire(_flow(t_ns, np.zeros(2), np.zeros(3), distance=distance), 1)
        epochs += [d.epoch for d in inputs.measured(message, t_ns, t_ns, codec.PX4) if isinstance(d, OdometryDelta)]
    assert epochs == [1, 2]


def test_a_flow_without_quality_range_or_gyroscope_is_none() -> None:
    inputs = _inputs()
    assert {mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR} <= dict(
        inputs.requests(T0, codec.PX4)
    ).keys()
    blind = _over_the_wire(_flow(T0, np.zeros(2), np.zeros(3), quality=0, distance=5.0), 1)
    assert not list(inputs.measured(blind, T0, T0, codec.PX4))
    with pytest.raises(ValueError, match="no range"):
        list(inputs.measured(_over_the_wire(_flow(T0, np.zeros(2), np.zeros(3)), 1), T0, T0, codec.PX4))
    with pytest.raises(ValueError, match="gyroscope"):
        list(inputs.measured(_over_the_wire(_flow(T0, np.zeros(2), np.full(3, math.nan)), 1), T0, T0, codec.PX4))
    unnamed = Inputs(MavlinkConfig(imu=False), Topics(), 0.0)
    assert mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD not in unnamed.wanted
    seen = _over_the_wire(_flow(T0, np.zeros(2), np.zeros(3), distance=5.0), 1)
    assert not list(unnamed.measured(seen, T0, T0, codec.PX4))


def _odometry(t_ns: int, **fields: Any) -> Any:
    values = {"frame_id": 20, "child_frame_id": 12, "reset_counter": 3, "estimator_type": 3, "quality": 50} | fields
    frames, rest = [values.pop(name) for name in ("frame_id", "child_frame_id")], [0.0] * 6
    q = so3.from_euler(0.1, -0.2, 2.0).tolist()
    return mavlink.MAVLink_odometry_message(
        t_ns // 1000, *frames, values.pop("x", 1.0), 2.0, 3.0, q, *rest, [0.0] * 21, [0.0] * 21, **values
    )


def test_poses_of_a_companion_are_odometry_and_a_reset_is_another_frame() -> None:
    inputs = _inputs()
    (first,) = inputs.odometry(_over_the_wire(_odometry(T0)), T0)
    (second,) = inputs.odometry(_over_the_wire(_odometry(T0, reset_counter=4)), T0)
    assert isinstance(first, OdometryPose)
    assert isinstance(second, OdometryPose)
    assert (first.t_ns, first.p_o, first.topic) == (T0, (1.0, 2.0, 3.0), "/odometry")
    np.testing.assert_allclose(first.q_ob_wxyz, so3.from_euler(0.1, -0.2, 2.0), rtol=1e-6)
    assert first.frame != second.frame


@pytest.mark.parametrize("fields", [{"estimator_type": 8}, {"estimator_type": 4}])
def test_an_autopilots_own_estimate_is_no_odometry(fields: dict[str, int]) -> None:
    assert not list(_inputs().odometry(_over_the_wire(_odometry(T0, **fields)), T0))


@pytest.mark.parametrize(("quality", "is_lost"), [(-1, True), (0, False), (100, False)])
def test_a_quality_of_minus_one_is_a_lost_camera(quality: int, is_lost: bool) -> None:
    (got,) = _inputs().odometry(_over_the_wire(_odometry(T0, quality=quality)), T0)
    assert isinstance(got, OdometryPose)
    assert (got.t_ns, got.topic, got.is_lost) == (T0, "/odometry", is_lost)


@pytest.mark.parametrize(
    ("fields", "says"), [({"child_frame_id": 0}, "BODY_FRD"), ({"frame_id": 21}, "LOCAL_FRD"), ({"x": math.inf}, "not finite")]
)
def test_poses_in_other_axes_are_refused_with_the_reason(fields: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        list(_inputs().odometry(_over_the_wire(_odometry(T0, **fields)), T0))


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulated(FLIGHT, seed=6)


def _steps(simulation: Simulation, seconds: float) -> Iterator[tuple[int, Array, Array]]:
    """Time, pose there and step since the one before, of a camera that looks all the time."""
    step_ns = round(seconds * 1e9)
    for t_ns in range(EPOCH_NS + 15 * SECOND, EPOCH_NS + round(END_S) * SECOND - step_ns, step_ns):
        a, b = pose_at(simulation, t_ns), pose_at(simulation, t_ns + step_ns)
        yield t_ns + step_ns, b, between(a, b)


def _flown(simulation: Simulation, odometry: list[Any]) -> Run:
    lost_ns = EPOCH_NS + round(LOST_S * 1e9)
    kept = [m for m in simulation.messages if isinstance(m, ImuSample) or m.t_ns < lost_ns]
    return fly(simulation, None, by_arrival([*kept, *odometry]))


def test_flow_and_deltas_carry_the_estimate_through_an_outage(simulation: Simulation) -> None:
    """45 s without positions: the message's bytes are all that the filter has of the motion."""
    rng = np.random.default_rng(8)
    by_delta, by_flow = _inputs(), _inputs(level=(0.0, 0.5))
    deltas, flows = list[Any](), list[Any]()
    for t_ns, pose, step in _steps(simulation, 0.1):
        noisy = np.concatenate((step[:3] * (1.0 + 0.02 * rng.standard_normal(3)), step[3:]))
        deltas += by_delta.odometry(_over_the_wire(_delta(t_ns, noisy, 0.1)), t_ns)
        turn = so3.quat_log(step[3:])
        seen = so3.matrix(so3.quat_exp(-0.5 * turn)) @ step[:3]
        r = -pose[2] / so3.matrix(pose[3:])[2, 2]
        flow = np.array([turn[0] - seen[1] / r, turn[1] + seen[0] / r]) + 0.005 * rng.standard_normal(2)
        nav = np.zeros(16)
        nav[X.P], nav[X.Q] = pose[:3], pose[3:]
        by_flow.flow_range.note_estimate(Estimate(t_ns, t_ns, nav, np.eye(15) * 0.25, (0.0,) * 3, Mode.AIDED, 0, t_ns))
        flows += by_flow.measured(_over_the_wire(_flow(t_ns, flow, turn), 1), t_ns, t_ns, codec.PX4)
    alone, carried, flown = (_flown(simulation, odometry) for odometry in ([], deltas, flows))
    ends = [position_errors(run.estimates[-1:], simulation.truth)[0] for run in (alone, carried, flown)]
    assert ends[1] < 0.1 * ends[0]
    assert ends[2] < 0.3 * ends[0]
    assert carried.reasons("/vision_delta")[Reason.FUSED] > 100
    assert flown.reasons("/flow")[Reason.FUSED] > 250
    for run in (carried, flown):
        assert run.estimates[-1].mode is Mode.ODOMETRY
        assert not run.internal_errors()
