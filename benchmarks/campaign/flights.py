"""The campaign's flights: vehicles, sensors as the filter's model has them, outages, and the configuration."""

import math
import zlib
from typing import Literal

import msgspec

from estimator.filter.alignment import InitialiseConfig
from estimator.fusion import FusionConfig
from estimator.sources.gnss import GnssConfig
from estimator.sources.pose import PoseConfig
from models.imu import ImuNoise
from models.sim.aids import Gnss, PoseFixes
from models.sim.ranges import Interval
from models.sim.scenario import Scenario
from models.sim.sensors import GRADES, Imu
from models.sim.trajectory import FixedWing, Multirotor

IMU_HZ = 100.0  # half of what flies: halves the time of a campaign and changes no conclusion
AIDED_S = 100.0  # before the first outage; the assumed prior is forgotten by then
BETWEEN_S = 30.0  # aided, between outages
LENGTHS_S = (5.0, 10.0, 30.0, 60.0, 120.0)
_ALIGNING_S = 20.0  # pose fixes align a flight that then goes on with GNSS; "alone": it has to find its heading itself
_NEVER_STILL = 1e-9  # rad/s: no levelling at rest, so that the filter's prior is exactly the bound's

Phase = Literal["before", "during", "end", "after"]


class Instant(msgspec.Struct, frozen=True):
    """A fixed time of the flight at which estimates are judged; outage_s: length of the outage it belongs to."""

    t_s: float
    phase: Phase
    outage_s: float

    @property
    def label(self) -> str:
        """Such as "30 s end"."""
        return f"{self.outage_s:g} s {self.phase}"


class Flight(msgspec.Struct, frozen=True, kw_only=True):
    """A scenario of the simulator with its outages (begin, end), and the filter's configuration.

    configured_noise: multiple of the grade's noise.
    """

    name: str
    scenario: Scenario
    outages_s: tuple[Interval, ...]
    configured_noise: float = 1.0

    def seed(self, run: int) -> int:
        """Of the simulation: flights do not share their noise, so that their cells are independent."""
        return (zlib.crc32(self.name.encode()) << 20) + run

    def instants(self) -> list[Instant]:
        """Before, three times during, at the end of and three times after each outage, in order of time."""
        result = []
        rate_hz = self.scenario.imu.rate_hz
        nexts = [begin for begin, _ in self.outages_s[1:]] + [self.scenario.duration_s]
        for (begin, end), until in zip(self.outages_s, nexts, strict=True):
            length = end - begin
            times: list[tuple[Phase, float]] = [("before", begin - 1.0)]
            times += [("during", begin + share * length) for share in (0.25, 0.5, 0.75)]
            times += [("end", end - 1.0 / rate_hz), *(("after", end + share * (until - end)) for share in (0.1, 0.35, 0.8))]
            result += [Instant(round(t * rate_hz) / rate_hz, phase, length) for phase, t in times]
        return result

    def noise(self) -> ImuNoise:
        """The IMU's as the filter knows it: white noise of the grade or a multiple of it, random walks of the grade."""
        noise = GRADES[self.scenario.imu.grade].noise
        white = {"gyro_noise": noise.gyro_noise * self.configured_noise, "accel_noise": noise.accel_noise * self.configured_noise}
        return msgspec.structs.replace(noise, **white)

    def config(self, process_scale: float = 1.0) -> FusionConfig:
        """What the filter knows: the IMU's noise, its turn-on biases as prior; process_scale multiplies Q."""
        imu = self.scenario.imu
        scaled = {name: value * math.sqrt(process_scale) for name, value in msgspec.structs.asdict(self.noise()).items()}
        prior = InitialiseConfig(
            gyro_bias_sigma=GRADES[imu.grade].gyro_turn_on * imu.turn_on,
            accel_bias_sigma=GRADES[imu.grade].accel_turn_on * imu.turn_on,
            still_gyro=_NEVER_STILL,
        )
        gnss = GnssConfig(slow_sigma_m=0.0, velocity_slow_sigma_m_s=0.0)
        pose_fix = PoseConfig(tilt_deg=0.0, mount_deg=0.0)  # simulated fixes: level, true
        return FusionConfig(imu=ImuNoise(**scaled), gnss=gnss, pose_fix=pose_fix, initialise=prior, origin=self.scenario.origin)


def outages(lengths_s: tuple[float, ...], aided_s: float, between_s: float) -> tuple[Interval, ...]:
    """One after the other, with aid before, between and after them."""
    result, begin = [], aided_s
    for length in lengths_s:
        result.append((begin, begin + length))
        begin += length + between_s
    return tuple(result)


def flight(
    name: str,
    vehicle: Multirotor | FixedWing,
    *,
    imu: Imu,
    pose_fix: PoseFixes | None = None,
    gnss: Gnss | None = None,
    alone: bool = False,
    lengths_s: tuple[float, ...] = LENGTHS_S,
    aided_s: float = AIDED_S,
    between_s: float = BETWEEN_S,
    configured_noise: float = 1.0,
) -> Flight:
    """A flight whose absolute aids are all gone in each outage; alone: GNSS without pose fixes at the start."""
    gone = outages(lengths_s, aided_s, between_s)
    duration_s = gone[-1][1] + between_s
    replace = msgspec.structs.replace
    if gnss and not alone:
        pose_fix = PoseFixes(rate_hz=2.0, outages_s=((_ALIGNING_S, duration_s),))
    elif pose_fix:
        pose_fix = replace(pose_fix, outages_s=gone)
    scenario = Scenario(
        name=name,
        duration_s=duration_s,
        vehicle=vehicle,
        imu=imu,
        pose_fix=pose_fix,
        gnss=replace(gnss, outages_s=gone) if gnss else None,
    )
    return Flight(name=name, scenario=scenario, outages_s=gone, configured_noise=configured_noise)


def matched() -> list[Flight]:
    """Vehicles, grades and aids, one with another."""
    controller, industrial = Imu(grade="flight_controller", rate_hz=IMU_HZ), Imu(grade="industrial", rate_hz=IMU_HZ)
    rotor, wing, white = Multirotor(), FixedWing(), Gnss(rate_hz=5.0)
    return [
        flight("rotor-fc-pose2", rotor, imu=controller, pose_fix=PoseFixes(rate_hz=2.0)),
        flight("rotor-fc-pose0.5", rotor, imu=controller, pose_fix=PoseFixes(rate_hz=0.5)),
        flight("rotor-ind-pose1", rotor, imu=industrial, pose_fix=PoseFixes(rate_hz=1.0)),
        flight("wing-fc-pose2", wing, imu=controller, pose_fix=PoseFixes(rate_hz=2.0)),
        flight("wing-fc-pose0.5", wing, imu=controller, pose_fix=PoseFixes(rate_hz=0.5)),
        flight("wing-ind-pose1", wing, imu=industrial, pose_fix=PoseFixes(rate_hz=1.0)),
        flight("rotor-fc-gnss5", rotor, imu=controller, gnss=white),
        flight("rotor-ind-gnss5", rotor, imu=industrial, gnss=white),
        flight("wing-fc-gnss5", wing, imu=controller, gnss=white),
        flight("wing-ind-gnss5", wing, imu=industrial, gnss=white),
        flight("rotor-fc-gnss5-alone", rotor, imu=controller, gnss=white, alone=True),
        flight("wing-fc-gnss5-alone", wing, imu=controller, gnss=white, alone=True),
    ]
