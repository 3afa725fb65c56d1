"""Each of examples/rigs/ finds its position and holds it: simulated messages of its topics, rates, axes, antennas, delays."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import Config, Inputs, load
from estimator.fusion import Fusion
from estimator.service.start import Start
from logs.wire.codec import encode_input
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, OdometryPose, PoseFix, Quat, Reading, Reason, vec3
from models.sim.aids import Gnss
from models.sim.scenario import EPOCH_NS, Truth
from models.sim.sensors import Imu
from tests import long
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, barometer, heading, ride, velocity_body

RIGS = sorted((Path(__file__).parents[2] / "examples" / "rigs").glob("*.toml"))
IMU_HZ, REST_S, END_S = 200.0, 3.0, 13.0
MOST_M = {"ardupilot_tags": 0.3, "rover_uwb": 0.5}  # horizontally, in the last 4 s; with GNSS:
MOST_GNSS_M = 1.3
UP = {"d455_openvins": (0.0, -9.8, 0.0), "oakd": (-9.8, 0.0, 0.0)}  # of the driver's specific force at rest, m/s^2; else REP 103


@cache
def _ride(antenna_b_m: tuple[float, float, float], delay_s: float) -> Ride:
    gnss = Gnss(rate_hz=5.0, antenna_b_m=antenna_b_m, stamp_lag_s=delay_s, delay_s=delay_s)
    return ride(REST_S, END_S - REST_S, seed=2, imu=Imu(grade="flight_controller", rate_hz=IMU_HZ), gnss=gnss)


def _quat(q: Array) -> Quat:
    w, x, y, z = q.tolist()
    return w, x, y, z


def _poses(truth: Truth, rate_hz: float) -> list[tuple[int, Array, Quat]]:
    return [
        (int(truth.t_ns[k]), truth.p_n[k], _quat(truth.q_nb_wxyz[k])) for k in range(0, len(truth.t_ns), round(IMU_HZ / rate_hz))
    ]


def _camera(truth: Truth, topic: str) -> list[Input]:
    """Poses from where the camera woke up, 30 Hz, with a scale that is 1 % off."""
    start = truth.p_n[0]
    return [OdometryPose(t, t, vec3(1.01 * (p - start)), quat, "odom", topic) for t, p, quat in _poses(truth, 30.0)]


def _fixes(truth: Truth, topic: str, sigma_m: float, sigma_rad: float) -> list[Input]:
    """Ten a second."""
    rng, covariance = np.random.default_rng(4), np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    return [
        PoseFix(t, t, vec3(p + sigma_m * rng.standard_normal(3)), quat, covariance, topic=topic)
        for t, p, quat in _poses(truth, 10.0)
    ]


def _ranges(truth: Truth, config: Config) -> list[Input]:
    """Ten a second each, noise of 0.1 m."""
    rng, lever = np.random.default_rng(5), np.array(config.beacon.antenna_b_m)
    found: list[Input] = []
    for topic, at in zip(config.inputs.beacon, config.beacon.at_n_m, strict=True):
        for k in range(0, len(truth.t_ns), round(IMU_HZ / 10.0)):
            z = float(np.linalg.norm(truth.p_n[k] + truth.R_nb[k] @ lever - at)) + 0.1 * rng.standard_normal()
            found.append(Reading(int(truth.t_ns[k]), int(truth.t_ns[k]), topic, "beacon", (z,)))
    return found


def _typed(truth: Truth) -> list[Input]:
    """`landfix start` before the vehicle moves: a position known to 0.5 m."""
    start = Start(vec3(truth.p_n[0]), 0.5)
    return [start.fix(EPOCH_NS + k * 500_000_000) for k in range(2, 5)]  # then it moves


def _messages(config: Config, journey: Ride) -> list[Input]:
    """Of the rig's sensors, on its topics."""
    names, truth = config.inputs, journey.truth
    found: list[Input] = [replace(m, topic=names.imu[0]) for m in journey.messages if isinstance(m, ImuSample)]
    for kind, topics in (GnssFix, names.gnss), (GnssVelocity, names.gnss_velocity):
        found += [replace(m, topic=topics[0]) for m in journey.messages if isinstance(m, kind) and topics]
    made = {"baro": barometer, "heading": heading, "velocity_body": velocity_body}
    for name, sense in made.items():
        found += [replace(m, topic=topic) for topic in getattr(names, name) for m in sense(truth)]
    found += [m for topic in names.odometry for m in _camera(truth, topic)]
    found += _fixes(truth, names.pose_fix[0], 0.05, 0.01) if names.pose_fix != Inputs().pose_fix else []
    found += _ranges(truth, config) if names.beacon else []
    found += _typed(truth) if not names.gnss and names.pose_fix == Inputs().pose_fix else []
    return by_arrival(found)


@long.parametrize("file", RIGS, ids=lambda f: f.stem)
def test_a_rig_finds_its_position_and_holds_it(file: Path) -> None:
    config = load(file)
    config = replace(config, map=replace(config.map, origin=(HOME.lat_deg, HOME.lon_deg, HOME.alt_m)))
    journey = _ride(config.gnss.antenna_b_m, config.gnss.delay_s)
    decoder, run = config.decoder(), Run(Fusion(config.fusion()))
    for message in _messages(config, journey):
        encoded = encode_input(message, config.mounting())
        decoded = decoder.decode(encoded.topic, encoded.schema, encoded.data, message.arrived_ns)
        assert decoded is not None
        run.feed([decoded])
    assert run.internal_errors() == []
    named = {topic for kind in Inputs.__struct_fields__ for topic in getattr(config.inputs, kind)}
    fused = {s.topic for s in run.statuses if s.reason is Reason.FUSED}
    assert named - fused <= {
        *config.inputs.imu,
        *Inputs().pose_fix,
        *Inputs().attitude,
        *Inputs().rest,
        *config.inputs.zed_status,
        *Inputs().left_image,
        *Inputs().right_image,
    }
    late = within(run.aligned, END_S - 4.0, END_S, every=1)
    assert len(late) == 4.0 * IMU_HZ
    off = np.array([np.linalg.norm(error(e, journey.truth)[:2]) for e in late])
    assert off.max() < MOST_M.get(file.stem, MOST_GNSS_M)


@pytest.mark.parametrize("file", RIGS, ids=lambda f: f.stem)
def test_its_axes_are_those_of_the_driver(file: Path) -> None:
    config = load(file)
    if not config.mavlink.endpoint:  # an autopilot's IMU has the body's axes
        up = np.array(UP.get(file.stem, (0.0, 0.0, 9.8)))
        np.testing.assert_allclose(config.mounting().matrix() @ up, [0.0, 0.0, -9.8], atol=1e-12)
