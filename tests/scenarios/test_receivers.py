"""Two GNSS receivers, each with an antenna and a delay of its own; one that goes astray is named and not followed."""

import re
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import ConfigError, parse
from estimator.fusion import Fusion
from models.messages import Array, GnssFix, GnssVelocity, Input, Reason
from models.sim.aids import Gnss
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import Imu
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, ride

END_S, ASTRAY_S = 30.0, 18.0
TOML = f"""
[map]
origin = [{HOME.lat_deg}, {HOME.lon_deg}, {HOME.alt_m}]
[inputs]
gnss = ["/gnss", "/rear"]
gnss_velocity = ["/gnss/velocity", "/rear/velocity"]
[gnss]
antenna_b_m = [1.0, 0.0, -0.2]
"""
REAR = """
[[gnss.receivers]]
topic = "/rear"
antenna_b_m = [-3.0, 0.0, -0.2]
delay_s = 0.25
"""


@cache
def _rides() -> tuple[Ride, Ride]:
    front = Gnss(antenna_b_m=(1.0, 0.0, -0.2), sigma_m=(0.3, 0.3, 0.5))
    rear = Gnss(antenna_b_m=(-3.0, 0.0, -0.2), sigma_m=(0.3, 0.3, 0.5), stamp_lag_s=0.25, delay_s=0.25)
    imu = Imu(grade="flight_controller", rate_hz=50.0)
    one, other = (ride(2.0, END_S - 2.0, seed=seed, yaw=0.5, imu=imu, gnss=gnss) for seed, gnss in ((3, front), (4, rear)))
    return one, other


def _fly(text: str, off_n_m: Array | None = None) -> Run:
    front, rear = _rides()
    messages: list[Input] = list(front.messages)
    for message in rear.messages:
        if isinstance(message, GnssVelocity):
            messages.append(replace(message, topic="/rear/velocity"))
        elif isinstance(message, GnssFix):
            at = np.array(HOME.to_ned(message.lat_deg, message.lon_deg, message.alt_m))
            if off_n_m is not None and message.t_ns > EPOCH_NS + ASTRAY_S * 1e9:
                at = at + off_n_m
            lat, lon, alt = HOME.to_geodetic(at)
            messages.append(replace(message, topic="/rear", lat_deg=lat, lon_deg=lon, alt_m=alt))
    return Run(Fusion(parse(text).fusion())).feed(by_arrival(messages))


def _worst_m(run: Run, start_s: float) -> float:
    return max(float(np.linalg.norm(error(e, _rides()[0].truth)[:2])) for e in within(run.aligned, start_s, END_S))


def test_two_receivers_with_tables_of_their_own_are_both_fused() -> None:
    run = _fly(TOML + REAR)
    assert run.internal_errors() == []
    for topic in ("/gnss", "/rear", "/gnss/velocity", "/rear/velocity"):
        reasons = run.reasons(topic)
        assert set(reasons) <= {Reason.ALIGNING, Reason.FUSED, Reason.GATED}, topic  # neither was ever stopped
        assert reasons.get(Reason.GATED, 0) < 0.03 * reasons[Reason.FUSED]
    assert _worst_m(run, 15.0) < 2.5


def test_one_without_its_table_is_not_used_and_its_delay_is_named() -> None:
    """The rear one is taken for 4 m ahead and a quarter of a second younger than it is."""
    run = _fly(TOML)
    assert run.reasons("/rear")[Reason.GATED] > 0.7 * sum(run.reasons("/rear").values())
    assert run.reasons("/gnss")[Reason.GATED] < 0.1 * sum(run.reasons("/gnss").values())
    late = [int(ms) for h in run.health for ms in re.findall(r"stamps of /rear are (\d+) ms late", h.detail)]
    assert 190 < np.median(late) < 260
    assert _worst_m(run, 15.0) < 2.5


def test_one_that_differs_is_named_and_the_other_one_leads_without_a_jump() -> None:
    run = _fly(TOML + REAR, np.array([0.0, 30.0, 0.0]))
    assert set(run.reasons("/gnss")) == {Reason.ALIGNING, Reason.FUSED}
    after = [s for s in run.statuses if s.topic == "/rear" and s.t_ns > EPOCH_NS + (ASTRAY_S + 1.0) * 1e9]
    assert {s.reason for s in after} == {Reason.GATED}
    assert any("/rear is 3" in h.detail and "not used" in h.detail for h in run.health)
    steps = [float(np.linalg.norm(np.subtract(b.nav[:2], a.nav[:2]))) for a, b in pairwise(run.aligned)]
    assert max(steps) < 0.6  # 10 m/s, 50 Hz
    assert _worst_m(run, ASTRAY_S) < 2.5
    late = within(run.aligned, ASTRAY_S + 1.0, END_S)
    off = [float(np.linalg.norm(error(e, _rides()[0].truth)[:2]) / np.sqrt(e.covariance[:2, :2].trace())) for e in late]
    assert max(off) < 3.0  # the IMU and the other receiver contradict the jump


def test_a_table_of_no_receiver_is_refused_and_a_table_is_in_the_log() -> None:
    with pytest.raises(ConfigError, match="/raer: is none of"):
        parse(TOML + REAR.replace("/rear", "/raer"))
    config = parse(TOML + REAR)
    assert parse(config.toml()) == config
