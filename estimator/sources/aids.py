"""Registry of the sources' sections and measurements.

An own sensor: docs/own_sensor.md.
"""

import math
from typing import Any

import msgspec

from estimator.sources.air.airspeed import AirspeedConfig
from estimator.sources.air.drag import DragConfig
from estimator.sources.air.wind import WindConfig
from estimator.sources.attitude import attitude_aid
from estimator.sources.baro import BaroConfig
from estimator.sources.base.aid import Aid, Refusal, SensorConfig
from estimator.sources.beacon import BeaconConfig
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from estimator.sources.heading import HeadingConfig
from estimator.sources.landmark import landmark_aid
from estimator.sources.magnetometer import MagnetometerConfig
from estimator.sources.odometry import OdometryConfig, increment_aid, odometry_pose_aid
from estimator.sources.pose import LandmarkFixConfig, PoseConfig, pose_aid
from estimator.sources.range import RangeConfig
from estimator.sources.rest import RestConfig
from estimator.sources.velocity_body import VelocityBodyConfig
from models.messages import (
    AttitudePrior,
    GnssFix,
    GnssVelocity,
    Input,
    LandmarkFix,
    OdometryDelta,
    OdometryPose,
    PoseFix,
    Reading,
    Reason,
)


class SourcesConfig(msgspec.Struct, frozen=True, kw_only=True):
    """A section per source; optional sensors are named by their readings' kind."""

    gnss: GnssConfig = GnssConfig()
    pose_fix: PoseConfig = PoseConfig()
    landmark_fix: LandmarkFixConfig = LandmarkFixConfig()
    baro: BaroConfig = BaroConfig()
    velocity_body: VelocityBodyConfig = VelocityBodyConfig()
    range: RangeConfig = RangeConfig()
    beacon: BeaconConfig = BeaconConfig()
    airspeed: AirspeedConfig = AirspeedConfig()
    drag: DragConfig = DragConfig()
    wind: WindConfig = WindConfig()
    rest: RestConfig = RestConfig()
    heading: HeadingConfig = HeadingConfig()
    magnetometer: MagnetometerConfig = MagnetometerConfig()
    odometry: OdometryConfig = OdometryConfig()

    def sources(self) -> dict[str, Any]:
        """Sections by name."""
        return {name: getattr(self, name) for name in SourcesConfig.__struct_fields__}


def aid_of(message: Input, config: SourcesConfig) -> Aid | Refusal | None:
    """The message as a measurement, or its refusal; None for other kinds."""
    match message:
        case PoseFix():
            return pose_aid(message, config.pose_fix)
        case LandmarkFix():
            return landmark_aid(message, config.landmark_fix)
        case GnssFix():
            return position_aid(message, config.gnss)
        case GnssVelocity():
            return velocity_aid(message, config.gnss)
        case Reading():
            return _sensor_aid(message, config)
        case OdometryDelta():
            return increment_aid(message, config.odometry)
        case OdometryPose():
            return odometry_pose_aid(message, config.odometry)
        case AttitudePrior():
            return attitude_aid(message)
        case _:
            return None


def _sensor_aid(reading: Reading, config: SourcesConfig) -> Aid | Refusal | None:
    rules = getattr(config, reading.kind, None)
    if not isinstance(rules, SensorConfig):
        return None
    if not all(map(math.isfinite, reading.values)):
        return Refusal(Reason.NOT_FINITE, f"{reading.kind}: its reading")
    return rules.aid(reading, config.wind) if isinstance(rules, AirspeedConfig) else rules.aid(reading)
