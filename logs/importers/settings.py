"""Configuration of an imported log (TOML).

Noise is effective: tuned, or by vehicle kind.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from logs.wire.sensors import SENSORS
from models.imu import ImuNoise
from models.messages import ATTITUDE_TOPIC, Vec3

ODOMETRY_TOPIC, DELTA_TOPIC, FLOW_TOPIC = "/odometry", "/odometry_delta", "/optical_flow"

MULTIROTOR = ImuNoise(gyro_noise=5e-3, accel_noise=0.3, gyro_walk=1e-4, accel_walk=5e-3)
FIXED_WING = ImuNoise(gyro_noise=3e-3, accel_noise=0.15, gyro_walk=1e-4, accel_walk=3e-3)
CAR = ImuNoise(gyro_noise=1e-3, accel_noise=5e-2, gyro_walk=5e-5, accel_walk=2e-3)

BY_KIND = "not known for this log: typical of a multirotor's vibration at 50 Hz; tune it"


class Settings(msgspec.Struct, frozen=True):
    """A log's share of the configuration.

    gnss_delay_s: age of a fix at its stamp; antenna_b_m: IMU to antenna; receiver, airspeed: keys of [gnss], [airspeed];
    hard_iron_ut: uT, body axes; origin: deg, deg, m.
    """

    noise: ImuNoise = MULTIROTOR
    noise_reason: str = BY_KIND
    gnss_delay_s: float = 0.0
    antenna_b_m: Vec3 = (0.0, 0.0, 0.0)
    receiver: Mapping[str, float] = {}
    origin: Vec3 | None = None
    altitude: str = ""  # what the heights of GNSS refer to
    hard_iron_ut: Vec3 | None = None
    airspeed: Mapping[str, float | bool] = {}
    wheels: bool = False  # velocities in the body are those of wheels

    def toml(self, kind: str, source: Path, topics: tuple[str, ...]) -> str:
        """The text; topics: inputs in the log."""
        inputs = {
            "imu": [t for t in topics if t.startswith("/imu")],
            "gnss": [t for t in topics if t.startswith("/gnss") and not t.endswith("/velocity")],
            "gnss_velocity": [t for t in topics if t.startswith("/gnss") and t.endswith("/velocity")],
            "pose_fix": [t for t in topics if t.startswith("/pose_fix")],
            **{kind: [t for t in topics if t == sensor.topic] for kind, sensor in SENSORS.items()},
            "odometry": [t for t in topics if t == ODOMETRY_TOPIC and kind == "csv"],  # elsewhere it may be our own
            "odometry_delta": [t for t in topics if t == DELTA_TOPIC],
            "optical_flow": [t for t in topics if t == FLOW_TOPIC],
            "attitude": [t for t in topics if t == ATTITUDE_TOPIC],  # the autopilot's, to begin with
        }
        offered = [_AVAILABLE] if ODOMETRY_TOPIC in topics and not inputs.get("odometry") else []
        return self.text(kind, source, inputs, offered)

    def text(
        self, kind: str, source: Path, inputs: Mapping[str, Sequence[str]], offered: Sequence[str] = (), axes: str = "flu",
        mounting_deg: tuple[float, float] = (0.0, 0.0),
    ) -> str:  # fmt: skip
        """The text; inputs: key -> topics; offered: comments; axes, mounting_deg (roll, pitch) of the IMU."""
        lines = [
            f"# Written by: landfix import {kind} {source.name}   (importing again writes it anew: copy it before you change it)",
            "",
            "[imu]",
            f'axes = "{axes}"',
            *([f"mounting_rpy_deg = [{mounting_deg[0]:g}, {mounting_deg[1]:g}, 0]"] if any(mounting_deg) else []),
            f"# noise: {self.noise_reason}",
            *(f"{field} = {getattr(self.noise, field):.6g}" for field in self.noise.__struct_fields__),
            "",
            "[inputs]",
            *(f"{name} = [{', '.join(map(_quoted, found))}]" for name, found in inputs.items() if found),
            *offered,
        ]
        if inputs.get("gnss"):
            antenna = ", ".join(repr(float(x)) for x in self.antenna_b_m)
            lines += ["", "[gnss]", f"delay_s = {round(self.gnss_delay_s, 6)!r}", f"antenna_b_m = [{antenna}]"]
            lines += [f"{name} = {value!r}" for name, value in self.receiver.items()]
        if inputs.get("magnetometer") and self.hard_iron_ut is not None:
            lines += ["", "[magnetometer]", f"offset_ut = {list(self.hard_iron_ut)}"]
        if inputs.get("airspeed") and self.airspeed:
            lines += ["", "[airspeed]", *(f"{name} = {str(value).lower()}" for name, value in self.airspeed.items())]
        if self.wheels and inputs.get("velocity_body"):
            lines += ["", "[velocity_body]", "across_sigma_m_s = 0.1  # wheels roll forward: neither sideways nor up"]
        if self.origin is not None:
            lat, lon, alt = self.origin
            lines += ["", "[map]", f"origin = [{lat:.10f}, {lon:.10f}, {alt:.4f}]"]
            if self.altitude:
                lines.append(f"# heights: {self.altitude}")
        return "\n".join(lines) + "\n"


_AVAILABLE = f'# odometry = "{ODOMETRY_TOPIC}"  # in the log; use it unless it was made from this estimator'


def _quoted(text: str) -> str:
    return f'"{text}"'


class DataSet(msgspec.Struct, frozen=True):
    """A public collection of flights."""

    axes: str = "frd"
    noise: ImuNoise = MULTIROTOR
    noise_reason: str = BY_KIND
    gnss_delay_s: float = 0.0
    antenna_b_m: Vec3 = (0.0, 0.0, 0.0)
    receiver: Mapping[str, float] = {}
    altitude: str = ""
    hard_iron_ut: Vec3 | None = None
    airspeed: Mapping[str, float | bool] = {}


_RAISED = "effective for this data set: the data sheet's, raised for vibration and what the model leaves out"

UNKNOWN = DataSet()
DATA_SETS = {
    "euroc": DataSet("urf", ImuNoise(7e-4, 4e-2, 1e-4, 1e-3), _RAISED),
    "tumvi_room": DataSet("flu", ImuNoise(1.5e-3, 2e-2, 5e-5, 1e-3), _RAISED),
    "blackbird_clover": DataSet("frd", ImuNoise(7e-4, 2e-2, 1e-4, 1e-3), _RAISED),
    "quad_rtk_dot": DataSet(
        noise=ImuNoise(2e-3, 0.3, 1e-4, 5e-3),
        noise_reason=_RAISED,
        # RTK with an unknown lever arm; height and vertical speed of the record drift apart by 2 m a minute
        receiver={"horizontal_sigma_m": 0.3, "vertical_sigma_m": 1.0},
    ),
    "rtk_drive_walk": DataSet(
        noise=CAR,
        noise_reason="a car: data sheet x 15 (gyro: engine, road) and x 70 (accel: 1 % of scale error besides)",
        gnss_delay_s=-0.075,  # measured: gyro against the velocity's course 0.05; its velocity is 0.125 s older than its position
        antenna_b_m=(0.0, -0.05, 0.0),
        # Velocities are those of the last quarter of a second; carrier phase has no slow error; 0.02 s of stamp at 10 m/s are one
        receiver={"velocity_delay_s": 0.125, "slow_sigma_m": 0.2},
        altitude="above mean sea level",
    ),
    "umn_thor75": DataSet(
        noise=FIXED_WING,
        noise_reason="a fixed wing with engine at 50 Hz: what was measured at rest, x 7 (gyro) and x 50 (accel)",
        hard_iron_ut=(38.8, -16.5, 39.0),  # fitted to the field of the flight; residual 1 uT
    ),
    "inertialnav_logs": DataSet(
        gnss_delay_s=0.21,  # position; velocity 0.23, height 0.35
        noise_reason="typical of a multirotor's vibration at 50 Hz",
        altitude="above mean sea level (f450_glitch), above the take-off point (quad106)",
    ),
    "ardupilot_logs": DataSet(
        gnss_delay_s=0.3,  # measured: velocity against force; the autopilot took 0.2
        noise_reason="typical of a multirotor's vibration at 50 Hz",
        altitude="above mean sea level",
    ),
}


def data_set(folder: Path) -> DataSet:
    """Data set of a folder, by its path; UNKNOWN if none."""
    names = (p.name for p in (folder, *folder.parents))
    return next((DATA_SETS[name] for name in names if name in DATA_SETS), UNKNOWN)
