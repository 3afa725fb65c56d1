"""The configuration: TOML sections -> parameter structs."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from estimator import strict_toml
from estimator.filter.alignment import InitialiseConfig
from estimator.filter.bounds import BoundsConfig
from estimator.frontend.key_frames import VisualOdometryConfig
from estimator.frontend.requests import VisionConfig
from estimator.fusion import EstimatorConfig, FusionConfig
from estimator.integrity.config import IntegrityConfig
from estimator.map_files.image_file import ImageFile, LearnedFiles
from estimator.publish import OutputConfig
from estimator.service.autopilot.output_policy import AutopilotConfig, Px4Config
from estimator.service.base.clock import ClockConfig
from estimator.service.daemon import ServiceConfig
from estimator.service.log.writer import LogConfig
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.zenoh.config import ZenohConfig
from estimator.sources.aids import SourcesConfig
from estimator.strict_toml import ConfigError
from logs.store.reader import Attachment
from logs.store.recorder import CONFIG_ATTACHMENT
from logs.wire.codec import Decoder, ImuMounting, Topics
from models.imu import ImuNoise
from models.untrusted import toml_text
from models.untrusted.file import opened

__all__ = ["Config", "ConfigError", "load", "parse", "read", "recorded", "with_origin"]

_TOPICS = Topics()
_Topics: TypeAlias = tuple[str, ...]
_Factor: TypeAlias = Annotated[float, Meta(ge=0.01, le=1000)]
_Degrees: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
_Latitude: TypeAlias = Annotated[float, Meta(ge=-90, le=90)]
_Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=180)]
_Height: TypeAlias = Annotated[float, Meta(ge=-1000, le=50_000)]


class Imu(ImuNoise, frozen=True, forbid_unknown_fields=True):
    """[imu]: its noise, and how it sits in the vehicle."""

    axes: Annotated[Literal["flu", "frd"], Meta(description="axes of the messages: forward-left-up or forward-right-down")] = (
        "flu"
    )
    mounting_rpy_deg: Annotated[
        tuple[_Degrees, _Degrees, _Degrees], Meta(description="deg: roll, pitch, yaw of the IMU in the body, both taken as FRD")
    ] = (0.0, 0.0, 0.0)
    others_rpy_deg: Annotated[
        tuple[tuple[_Degrees, _Degrees, _Degrees], ...],
        Meta(description="deg: the same of the second topic of [inputs] imu and those that follow; none: as the first"),
    ] = ()
    others_noise: Annotated[
        tuple[_Factor, ...],
        Meta(description="ratio: noise and walks of the second topic of [inputs] imu and those that follow to these; none: 1"),
    ] = ()


_OWN = re.compile(r"/?landfix/(?!fix$|odometry_delta$)|/?tf(?:_static)?$")
_WILD = re.compile(r"[*?#$]|\s")


class Inputs(Topics, frozen=True, forbid_unknown_fields=True):
    """[inputs]: topics, one or a list each; each is a source."""

    imu: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/Imu; the first leads")] = _TOPICS.imu
    gnss: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/NavSatFix")] = _TOPICS.gnss
    gnss_velocity: Annotated[_Topics, Meta(description="topics of geometry_msgs/msg/TwistWithCovarianceStamped, ENU")] = (
        _TOPICS.gnss_velocity
    )
    odometry: Annotated[
        _Topics, Meta(description="topics of nav_msgs/msg/Odometry, in a frame of its own; none: no odometry is used")
    ] = _TOPICS.odometry
    isaac_status: Annotated[
        _Topics,
        Meta(description="topics of isaac_ros_visual_slam_interfaces/msg/VisualSlamStatus, in the order of odometry; none: none"),
    ] = _TOPICS.isaac_status
    zed_status: Annotated[
        _Topics, Meta(description="topics of zed_msgs/msg/PosTrackStatus, in the order of odometry; none: none")
    ] = _TOPICS.zed_status
    odometry_delta: Annotated[
        _Topics,
        Meta(description="topics of landfix_msgs/msg/OdometryDelta, in addition to that of the cameras; none: no other"),
    ] = _TOPICS.odometry_delta
    optical_flow: Annotated[
        _Topics, Meta(description="topics of landfix_msgs/msg/OdometryDelta that MAVLink's flow becomes; none: it is not used")
    ] = _TOPICS.optical_flow
    attitude: Annotated[
        _Topics, Meta(description="topics of PoseWithCovarianceStamped of which the attitude helps to align; none: none is used")
    ] = _TOPICS.attitude
    pose_fix: Annotated[_Topics, Meta(description="topics of geometry_msgs/msg/PoseWithCovarianceStamped in map")] = (
        _TOPICS.pose_fix
    )
    left_image: Annotated[_Topics, Meta(description="topics of the left camera's images")] = _TOPICS.left_image
    right_image: Annotated[_Topics, Meta(description="topics of the right camera's images")] = _TOPICS.right_image


class Map(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[map]: origin and landmarks."""

    origin: Annotated[
        tuple[_Latitude, _Longitude, _Height] | None,
        Meta(
            description="deg,deg,m: latitude, longitude, ellipsoid height of n's origin; none: the map's, or the first GNSS fix"
        ),
    ] = None
    geoid_m: Annotated[float, Meta(ge=-120, le=100, description="m: height of the geoid above the ellipsoid at the origin")] = 0.0
    landmarks: Annotated[str | None, Meta(description="GeoJSON file of the landmarks, relative to the configuration")] = None
    picture: Annotated[
        str | None,
        Meta(description="orthophoto or satellite image, GeoTIFF or with a world file, relative to the configuration"),
    ] = None
    picture_sigma_m: Annotated[float, Meta(ge=0, le=1e4, description="m: how far it may lie from its place, per axis")] = 1.0
    picture_height_m: Annotated[
        _Height | None, Meta(description="m: of its ground above the ellipsoid; none: the origin's height")
    ] = None
    picture_height_sigma_m: Annotated[float, Meta(ge=0, le=1e4, description="m: how well the height of its ground is known")] = (
        2.0
    )
    picture_heights: Annotated[
        str | None, Meta(description="GeoTIFF or image with a world file: heights [m] of its ground above the ellipsoid")
    ] = None
    picture_epsg: Annotated[int, Meta(ge=0, le=999_999, description="EPSG code of the raster, if it holds none")] = 0
    learned_models: Annotated[
        tuple[str, ...], Meta(description="ONNX files of XFeat and LighterGlue for learned matching; none: without")
    ] = ()
    learned_sha256: Annotated[tuple[str, ...], Meta(description="their SHA-256, in the same order")] = ()


class Rig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[rig]: the cameras."""

    file: Annotated[str | None, Meta(description="calibration file of the cameras, relative to the configuration")] = None


class Config(SourcesConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All sections."""

    imu: Imu = Imu()
    inputs: Inputs = Inputs()
    map: Map = Map()
    rig: Rig = Rig()
    vision: VisionConfig = VisionConfig()
    visual_odometry: VisualOdometryConfig = VisualOdometryConfig()
    output: OutputConfig = OutputConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    bounds: BoundsConfig = BoundsConfig()
    integrity: IntegrityConfig = IntegrityConfig()
    initialise: InitialiseConfig = InitialiseConfig()
    service: ServiceConfig = ServiceConfig()
    clock: ClockConfig = ClockConfig()
    log: LogConfig = LogConfig()
    zenoh: ZenohConfig = ZenohConfig()
    autopilot: AutopilotConfig = AutopilotConfig()
    px4: Px4Config = Px4Config()
    mavlink: MavlinkConfig = MavlinkConfig()

    def fusion(self) -> FusionConfig:
        """Configuration of the estimator."""
        return FusionConfig(
            imu=self.imu,
            **self.sources(),
            initialise=self.initialise,
            estimator=self.estimator,
            bounds=self.bounds,
            integrity=self.integrity,
            imu_topics=self.inputs.imu,
            imu_factors=self.imu.others_noise,
            origin=self.map.origin,
        )

    def decoder(self) -> Decoder:
        """The wire decoder. Raises ConfigError."""
        for name in self.inputs.__struct_fields__:
            for topic in getattr(self.inputs, name):
                if _OWN.match(topic) or _WILD.search(topic):
                    what = "is an output of landfix" if _OWN.match(topic) else "names more than one topic"
                    raise ConfigError(f"[inputs] {name}: {topic} {what}")
        try:
            return Decoder(self.inputs, self.mounting())
        except ValueError as error:
            raise ConfigError(f"[inputs]: {error}") from None

    @property
    def geoid_m(self) -> float:
        """Height of the geoid above the ellipsoid."""
        return self.map.geoid_m

    def mounting(self) -> ImuMounting:
        """How the IMU sits in the vehicle."""
        others = dict(zip(self.inputs.imu[1:], self.imu.others_rpy_deg, strict=False))
        return ImuMounting(self.imu.axes, *self.imu.mounting_rpy_deg, others)

    def files(self) -> dict[str, str]:
        """Named files: description and path."""
        named = {"calibration": self.rig.file, "map": self.map.landmarks}
        return {name: file for name, file in named.items() if file}

    def map_image(self, folder: Path) -> ImageFile | None:
        """The map's image, where given; paths count from `folder`."""
        m = self.map
        if m.picture is None:
            return None
        heights = folder / m.picture_heights if m.picture_heights else None
        learned = None
        if m.learned_models or m.learned_sha256:
            if len(m.learned_models) != 2 or len(m.learned_sha256) != 2 or not all(m.learned_sha256):
                raise ConfigError("[map]: learned_models needs two files, and learned_sha256 the SHA-256 of each")
            extractor, matcher = (folder / name for name in m.learned_models)
            learned = LearnedFiles(extractor, matcher, *m.learned_sha256)
        return ImageFile(
            folder / m.picture, m.picture_sigma_m, m.picture_height_m, m.picture_height_sigma_m, heights, m.picture_epsg, learned
        )

    def toml(self) -> str:
        """All keys with their values, defaults included."""
        return strict_toml.encode(self)


def load(path: Path | None) -> Config:
    """The configuration of a file (None: defaults) with origin. Raises ConfigError."""
    return with_origin(read(path), path.parent) if path else Config()


def read(path: Path) -> Config:
    """The content of the file, named files unread. Raises ConfigError."""
    try:
        with opened(path) as file:
            text = toml_text.decode(file.read(toml_text.MOST_BYTES + 1))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    return parse(text, str(path))


def with_origin(config: Config, folder: Path) -> Config:
    """The configuration with its map's origin. Raises ConfigError."""
    landmarks, picture = config.map.landmarks, config.map_image(folder)
    if config.map.origin is not None or not (landmarks or picture):
        return config
    from estimator.frontend.files import map_origin  # noqa: PLC0415  (vision is loaded only where it is configured)

    origin = map_origin(folder / landmarks if landmarks else None, picture)
    return msgspec.structs.replace(config, map=msgspec.structs.replace(config.map, origin=origin))


def recorded(attachments: Iterable[Attachment], log: str) -> Config:
    """The configuration attached to a log, perhaps by another version; defaults if there is none. Raises ConfigError."""
    text = next((a.data for a in attachments if a.name == CONFIG_ATTACHMENT), b"")
    return parse(text.decode("utf-8", "replace"), f"{log}, {CONFIG_ATTACHMENT}", is_recorded=True)


def parse(text: str, name: str = "configuration", *, is_recorded: bool = False) -> Config:
    """The configuration of a TOML text called `name`; is_recorded: without the keys that were removed. Raises ConfigError."""
    config = strict_toml.decode(Config, text, name, is_recorded=is_recorded)
    try:
        config.decoder()
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None
    if why := _not_of_the_vehicle(config):
        raise ConfigError(f"{name}: {why}")
    if config.bounds.vehicle == "boat":  # an autopilot's "landed" means that it is disarmed
        config = msgspec.structs.replace(config, inputs=msgspec.structs.replace(config.inputs, rest=()))
    return config


def _not_of_the_vehicle(config: Config) -> str:
    vehicle = config.bounds.vehicle
    for receiver in config.gnss.receivers:
        if receiver.topic not in config.inputs.gnss:
            return f"[[gnss.receivers]] topic = {receiver.topic}: is none of [inputs] gnss: {', '.join(config.inputs.gnss)}"
    if config.drag.enabled and vehicle not in {"any", "multirotor"}:
        return f'[drag] enabled: rotors have this drag, and [bounds] vehicle is "{vehicle}"; set enabled = false'
    if config.rest.enabled and vehicle == "boat":
        return '[rest] enabled: it is for what stands on the ground, and [bounds] vehicle is "boat"; set enabled = false'
    if config.initialise.course_sigma_deg and vehicle == "multirotor":
        return '[initialise] course_sigma_deg: a vehicle of [bounds] vehicle "multirotor" flies sideways; leave it out'
    return ""
