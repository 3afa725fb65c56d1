"""Which source makes a measurement of which message."""

from typing import Protocol

from estimator.sources.attitude import attitude_aid
from estimator.sources.baro import BaroConfig, baro_aid
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from estimator.sources.landmark import landmark_aid
from estimator.sources.pose import PoseConfig, pose_aid
from estimator.sources.source import Aid, Refusal
from models.messages import AttitudePrior, Baro, GnssFix, GnssVelocity, Input, LandmarkFix, PoseFix


class SourcesConfig(Protocol):
    """The sections that configure the sources (estimator.fusion.FusionConfig has them)."""

    @property
    def gnss(self) -> GnssConfig: ...  # noqa: D102
    @property
    def pose_fix(self) -> PoseConfig: ...  # noqa: D102
    @property
    def landmark_fix(self) -> PoseConfig: ...  # noqa: D102
    @property
    def baro(self) -> BaroConfig: ...  # noqa: D102


def aid_of(message: Input, config: SourcesConfig) -> Aid | Refusal | None:
    """The message as a measurement, or why it is none; None where its kind is not that of an aid."""
    match message:
        case PoseFix():
            return pose_aid(message, config.pose_fix)
        case LandmarkFix():
            return landmark_aid(message, config.landmark_fix)
        case GnssFix():
            return position_aid(message, config.gnss)
        case GnssVelocity():
            return velocity_aid(message, config.gnss)
        case Baro():
            return baro_aid(message, config.baro)
        case AttitudePrior():
            return attitude_aid(message)
        case _:
            return None
