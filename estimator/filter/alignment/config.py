"""What filter, smoother and tracker are configured with."""

import msgspec

from estimator.filter.alignment.initialise import InitialiseConfig
from estimator.filter.bounds import BoundsConfig
from estimator.sources.aids import SourcesConfig
from estimator.sources.air.drag import DragConfig
from estimator.sources.rest import RestConfig
from models.frames import Origin
from models.imu import Coast, ImuNoise


class FilterConfig(SourcesConfig, frozen=True, kw_only=True):
    """Configuration of filter and smoother; origin: (lat_deg, lon_deg, alt_m) or None."""

    imu: ImuNoise = ImuNoise()
    coast: Coast = Coast()
    initialise: InitialiseConfig = InitialiseConfig()
    origin: tuple[float, float, float] | None = None


class TrackerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of a tracker; origin None: the first GNSS fix."""

    imu: ImuNoise
    coast: Coast
    initialise: InitialiseConfig
    origin: Origin | None
    bounds: BoundsConfig = BoundsConfig()
    rest: RestConfig = RestConfig()
    drag: DragConfig = DragConfig()
