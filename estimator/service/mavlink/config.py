"""[mavlink]: the link to an autopilot, and what is refused before it is opened."""

import termios
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import msgspec
from msgspec import Meta

from estimator.service.base.loopback import is_loopback
from estimator.service.base.secret_file import read_secret
from estimator.strict_toml import ConfigError

_Id = Annotated[int, Meta(ge=1, le=255)]
_UDP: Final = ("udpin", "udpout")
_LARGEST_PORT: Final = 65535
BAUDS: Final = {int(name[1:]): getattr(termios, name) for name in dir(termios) if name.startswith("B") and name[1:].isdecimal()}


class MavlinkConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[mavlink]: the link to an autopilot. Off without an endpoint."""

    endpoint: Annotated[
        str,
        Meta(description="udpin:127.0.0.1:14540 (listen), udpout:HOST:PORT (begin), or a serial device, /dev/ttyACM0; '': off"),
    ] = ""
    baud: Annotated[int, Meta(ge=9600, le=4_000_000, description="bit/s of a serial device")] = 921_600
    autopilot: Annotated[
        Literal["auto", "px4", "ardupilot"], Meta(description="whose conventions are spoken; auto: as its HEARTBEAT says")
    ] = "auto"
    system: Annotated[_Id, Meta(description="system id of the vehicle, the autopilot's and ours")] = 1
    component: Annotated[_Id, Meta(description="our component id; 197: visual inertial odometry")] = 197
    listen_to: Annotated[tuple[_Id, ...], Meta(description="component ids of the vehicle that are listened to")] = (1,)
    imu: Annotated[bool, Meta(description="whether its IMU is the first topic of [inputs] imu")] = True
    gnss: Annotated[
        bool, Meta(description="whether its receivers are the topics of [inputs] gnss and gnss_velocity, in order")
    ] = True
    baro: Annotated[bool, Meta(description="whether its barometer is the first topic of [inputs] baro")] = True
    magnetometer: Annotated[bool, Meta(description="whether its magnetometer is the first topic of [inputs] magnetometer")] = True
    range: Annotated[bool, Meta(description="whether its range finder is the first topic of [inputs] range")] = True
    airspeed: Annotated[
        bool,
        Meta(description="whether its pitot tube is the first topic of [inputs] airspeed; [airspeed] indicated = true"),
    ] = True
    heading: Annotated[bool, Meta(description="whether the yaw of its receivers is the first topic of [inputs] heading")] = True
    optical_flow: Annotated[
        bool, Meta(description="whether its OPTICAL_FLOW_RAD is the first topic of [inputs] optical_flow")
    ] = True
    velocity_body: Annotated[
        bool, Meta(description="whether its WHEEL_DISTANCE is the first topic of [inputs] velocity_body")
    ] = True
    odometry_from: Annotated[
        tuple[_Id, ...],
        Meta(
            description="component ids, not the autopilot's, whose ODOMETRY is the first topic of [inputs] odometry and"
            " VISION_POSITION_DELTA that of odometry_delta"
        ),
    ] = ()
    attitude_sigma_deg: Annotated[
        tuple[Annotated[float, Meta(ge=0.01, le=90)], Annotated[float, Meta(ge=0.01, le=180)]],
        Meta(description="deg,deg: of its tilt and heading; its ATTITUDE is the first topic of [inputs] attitude, if any"),
    ] = (2.0, 4.0)
    imu_hz: Annotated[float, Meta(ge=0.01, le=1000, description="Hz: requested from the autopilot")] = 200.0
    gnss_hz: Annotated[float, Meta(ge=0.01, le=25, description="Hz: requested from the autopilot")] = 5.0
    odometry: Annotated[bool, Meta(description="whether ODOMETRY is sent, at [autopilot] odometry_hz")] = True
    fixes: Annotated[bool, Meta(description="whether fixes are sent: GLOBAL_POSITION_SENSOR (PX4), GPS_INPUT (ArduPilot)")] = True
    slot: Annotated[
        int, Meta(ge=0, le=255, description="PX4: EKF2_AGPx_ID of the slot for fixes; ArduPilot: gps_id, 0 or more")
    ] = 1
    signing_key_file: Annotated[
        str, Meta(description="file with the passphrase of MAVLink 2 signing, relative to the configuration; '': unsigned")
    ] = ""
    trust_network: Annotated[bool, Meta(description="whether unsigned UDP beyond this machine is meant")] = False


class Udp(NamedTuple):
    """Address to listen on, or to talk to first."""

    host: str
    port: int
    listens: bool


class Serial(NamedTuple):
    """A device."""

    path: str
    baud: int


def address_of(config: MavlinkConfig) -> Udp | Serial:
    """The endpoint's address. Raises ConfigError: malformed, unknown speed, or open to the network unsigned."""
    kind, _, rest = config.endpoint.partition(":")
    if config.endpoint.startswith("/"):
        if config.baud not in BAUDS:
            raise ConfigError(f"mavlink.baud = {config.baud}: is not a speed of serial devices")
        return Serial(config.endpoint, config.baud)
    host, _, port = rest.rpartition(":")
    if kind not in _UDP or not host or not port.isdecimal() or not 0 <= int(port) <= _LARGEST_PORT:
        raise ConfigError(f"mavlink.endpoint = {config.endpoint}: is not udpin:HOST:PORT, udpout:HOST:PORT or /dev/...")
    if not (is_loopback(host) or config.signing_key_file or config.trust_network):
        raise ConfigError(
            f"mavlink.endpoint = {config.endpoint}: anybody in reach could feed it; set mavlink.signing_key_file "
            "(trust_network = true if that is meant)"
        )
    return Udp(host, int(port), kind == "udpin")


def signing_key(config: MavlinkConfig, folder: Path) -> bytes | None:
    """SHA-256 of the passphrase, as in ground stations; None: unsigned. Raises ConfigError."""
    if not config.signing_key_file:
        return None
    return sha256(read_secret("mavlink.signing_key_file", folder / config.signing_key_file).encode()).digest()
