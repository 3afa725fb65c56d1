"""The autopilot's messages as measurements.

IMU: HIGHRES_IMU, else RAW_IMU (ArduPilot) or SCALED_IMU (`coarse`: 0.01 m/s^2, 0.001 rad/s); others: SCALED_IMU2, 3.
"""

from collections.abc import Iterator
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from estimator.service.base.clock import SECOND_NS
from estimator.service.mavlink import codec
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.flow_range import FlowRange
from estimator.service.mavlink.odometry import camera, flow, pose, wheels
from estimator.service.mavlink.wire import GNSS_INTEGRITY, VISION_POSITION_DELTA
from logs.wire.codec import Topics
from logs.wire.increments import CameraSteps, FlowSteps, Wheels
from models.messages import Input, Reading, ReceiverState

_MISSING_NS: Final = 3 * SECOND_NS  # not heard for so long: asked for (again)
_MICRO: Final = 1e6
_SYSTEM_TIME_HZ: Final = 1.0
_SLOWER_US: Final = 3_125, 6_250, 12_500, 25_000, 40_000  # 80 % of a loop of 400, 200, 100, 50 Hz; what still navigates
_ATTITUDE_HZ: Final = 2.0
_ORIGIN_HZ: Final = 1.0
_LANDED: Final[int] = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
_LANDED_HZ: Final = 1.0
_ORIGIN: Final[int] = mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
_ATTITUDE: Final[int] = mavlink.MAVLINK_MSG_ID_ATTITUDE
_IMU: Final[int] = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
_RAW: Final[int] = mavlink.MAVLINK_MSG_ID_RAW_IMU
_SCALED: Final[int] = mavlink.MAVLINK_MSG_ID_SCALED_IMU
_IMUS: Final = {"HIGHRES_IMU": _IMU, "RAW_IMU": _RAW, "SCALED_IMU": _SCALED}
_OTHERS: Final = (mavlink.MAVLINK_MSG_ID_SCALED_IMU2, mavlink.MAVLINK_MSG_ID_SCALED_IMU3)
_RECEIVERS: Final = (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, mavlink.MAVLINK_MSG_ID_GPS2_RAW)
_PRESSURES: Final[int] = mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE
_DISTANCE: Final[int] = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
_FLOW: Final[int] = mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD
_WHEELS: Final[int] = mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE
_STEPS_HZ: Final = 20.0  # of flow, of its range, and of wheels
_ODOMETRY: Final[int] = mavlink.MAVLINK_MSG_ID_ODOMETRY
_NUMBERS: Final = (
    _IMUS
    | {"DISTANCE_SENSOR": _DISTANCE, "SCALED_PRESSURE": _PRESSURES}
    | dict(zip(("GPS_RAW_INT", "GPS2_RAW"), _RECEIVERS, strict=True))
)  # of those that carry sensors
_NEVER: Final = -(2**62)


class Inputs:
    """Of one link."""

    def __init__(self, config: MavlinkConfig, topics: Topics, geoid_m: float, level: tuple[float, float] | None = None) -> None:
        self._attitude_sigma_deg = config.attitude_sigma_deg
        self._attitude_topic = topics.attitude[0] if topics.attitude else None
        self._geoid_m = geoid_m
        self._sends_odometry = config.odometry
        self._needs_origin = config.odometry or self._attitude_topic is not None  # ArduPilot's
        self._imu_topic = topics.imu[0] if config.imu and topics.imu else None
        self._other_imus = dict(zip(_OTHERS, topics.imu[1:] if config.imu else (), strict=False))
        kinds = {kind for sensors in codec.SENSORS.values() for kind in sensors if getattr(config, kind)}
        self._sensor_topics = {kind: named[0] for kind in sorted(kinds) if (named := getattr(topics, kind))}
        self._readings: dict[str, tuple[float, ...]] = {}  # the last of each kind
        self._positions = dict(zip(_RECEIVERS, topics.gnss if config.gnss else (), strict=False))
        self._velocities = dict(zip(_RECEIVERS, topics.gnss_velocity if config.gnss else (), strict=False))
        self._fastest_us = self._imu_us = round(_MICRO / config.imu_hz)
        self._gnss_us, self._denied = round(_MICRO / config.gnss_hz), False
        imus = frozenset(_IMUS.values()) if self._imu_topic else frozenset()
        attitudes = frozenset({_ATTITUDE} if self._attitude_topic else ())
        self._carriers = frozenset(
            _NUMBERS[name] for name, sensors in codec.SENSORS.items() if sensors.keys() & self._sensor_topics.keys()
        )
        self.flow_range = FlowRange(level)
        flows = topics.optical_flow if config.optical_flow else ()
        self._flow = FlowSteps(flows[0]) if flows else None
        rolling = topics.velocity_body if config.velocity_body else ()
        self._wheels = Wheels(rolling[0]) if rolling else None
        self._steppers = frozenset({_FLOW, _DISTANCE} if self._flow else ()) | ({_WHEELS} if self._wheels else set())
        self.companions = frozenset(config.odometry_from)
        named = topics.odometry_delta if self.companions else ()
        self._steps = CameraSteps(named[0]) if named else None
        self._pose_topic = topics.odometry[0] if topics.odometry and self.companions else None
        odometries = frozenset({VISION_POSITION_DELTA} if self._steps else ()) | ({_ODOMETRY} if self._pose_topic else set())
        self.wanted = imus | attitudes | self._carriers | self._steppers | odometries
        self.wanted |= self._other_imus.keys() | self._positions.keys() | self._velocities.keys()
        self.wanted |= {GNSS_INTEGRITY} if self._positions else set()
        self._states: dict[int, tuple[ReceiverState, int]] = {}  # message id of the receiver's fixes -> its flags, and when
        self._authentication: dict[int, str] = {}  # id of the receiver -> in words
        self._rest_topic = topics.rest[0] if topics.rest else None
        self.wanted |= {_LANDED} if self._rest_topic else set()
        self._heard: dict[int, int] = {}  # message id -> when
        self._asked: dict[int, int] = {}
        self._began_ns: int | None = None  # when an IMU was first asked for
        self.imu_kind = "none"
        self._field_ns = _NEVER if imus else None  # of its last magnetic field; None: its IMU is not read
        self._is_blind = False  # an attitude was not taken for want of a field

    def ask_again(self) -> None:
        """Repeat all requests."""
        self._asked.clear()
        self._heard.clear()
        self._began_ns, self._imu_us, self._denied = None, self._fastest_us, False

    def deny(self) -> None:
        """Note a denied rate."""
        self._denied = True

    def requests(self, now_ns: int, autopilot: int | None) -> Iterator[tuple[int, int]]:
        """Id and period in us of messages to request now."""
        self._slow_down(now_ns)
        for number, period_us in self._missing(now_ns, autopilot).items():
            asked_ns = self._asked.get(number)  # once in any case: it may come by itself, but too seldom
            if asked_ns is None or now_ns - max(asked_ns, self._heard.get(number, _NEVER)) > _MISSING_NS:
                self._asked[number] = now_ns
                yield number, period_us

    def hear(self, message: Any, now_ns: int) -> None:
        """It comes, so it need not be asked for."""
        self._heard[message.get_msgId()] = now_ns

    def measured(self, message: Any, t_ns: int, now_ns: int, autopilot: int | None) -> Iterator[Input]:
        """Measurements of a message valid at t_ns."""
        number, kind = message.get_msgId(), message.get_type()
        if kind in _IMUS and (has_field := codec.has_field(message)) is not None and self._field_ns is not None:
            self._field_ns = now_ns if has_field else _NEVER
        if kind in _IMUS and self._imu_topic and self._is_best(kind, now_ns, autopilot):
            sample = codec.imu(message, t_ns, self._imu_topic)
            if sample is not None:
                self.imu_kind = kind
                yield sample
        if number in self._other_imus and (sample := codec.imu(message, t_ns, self._other_imus[number])) is not None:
            yield sample
        if number in self._carriers and (kind not in _IMUS or self._is_best(kind, now_ns, autopilot)):
            yield from self._sensors(message, kind, t_ns, autopilot)
        if number == _ATTITUDE and self._attitude_topic and self._is_true_heading(now_ns, autopilot):
            yield codec.attitude(message, t_ns, self._attitude_sigma_deg, self._attitude_topic)
        if number in self._positions:
            yield codec.gnss_fix(message, t_ns, self._geoid_m, self._positions[number], self._state(number, now_ns))
        if number in self._velocities:
            velocity = codec.gnss_velocity(message, t_ns, self._velocities[number])
            if velocity is not None:
                yield velocity

        if number == _DISTANCE and (values := codec.SENSORS[kind]["range"](message)) is not None:
            self.flow_range.note_finder(t_ns, values[0])
        if number == _FLOW and self._flow is not None:
            yield from flow(self._flow, message, t_ns, self.flow_range.at(message, t_ns))
        if number == _WHEELS and self._wheels is not None:
            yield from wheels(self._wheels, message, t_ns)

    def note_integrity(self, message: Any, now_ns: int) -> None:
        """Note GNSS_INTEGRITY (no stamp); its id counts receivers from 0."""
        if message.id < len(_RECEIVERS):
            self._states[_RECEIVERS[message.id]] = codec.receiver_state(message), now_ns
            self._authentication[message.id] = codec.authentication(message)

    def landed(self, message: Any, now_ns: int) -> Iterator[Input]:
        """EXTENDED_SYS_STATE (no stamp)."""
        if self._rest_topic:
            yield Reading(now_ns, now_ns, self._rest_topic, "rest", (float(message.landed_state),))

    def _state(self, number: int, now_ns: int) -> ReceiverState:
        state, heard_ns = self._states.get(number, (ReceiverState.UNKNOWN, _NEVER))
        return state if now_ns - heard_ns <= _MISSING_NS else ReceiverState.UNKNOWN

    def odometry(self, message: Any, t_ns: int) -> Iterator[Input]:
        """The measurements in a message of one of the companions."""
        number = message.get_msgId()
        if number == VISION_POSITION_DELTA and self._steps is not None:
            yield from camera(self._steps, message, t_ns)
        elif number == _ODOMETRY and self._pose_topic and (measured := pose(message, t_ns, self._pose_topic)) is not None:
            yield measured

    def _sensors(self, message: Any, name: str, t_ns: int, autopilot: int | None) -> Iterator[Input]:
        for kind, read in codec.SENSORS[name].items():
            if (name, kind, autopilot) == ("HIGHRES_IMU", "airspeed", codec.ARDUPILOT):
                continue
            topic, values = self._sensor_topics.get(kind), read(message)
            if topic is not None and values is not None and values != self._readings.get(kind):
                self._readings[kind] = values
                yield Reading(t_ns, t_ns, topic, kind, values)

    def report(self) -> dict[str, Any]:
        """For the status."""
        coarse = " (coarse: steps of 0.01 m/s^2, 0.001 rad/s)" if self.imu_kind in codec.COARSE else ""
        heading = {"attitude": "not taken: the autopilot's magnetometer reads zero or nothing"} if self._is_blind else {}
        receiver = ", ".join(f"{k + 1}: {words}" for k, words in sorted(self._authentication.items()) if words)
        return {"imu": self.imu_kind + coarse, "receiver": receiver} | heading

    def _missing(self, now_ns: int, autopilot: int | None) -> dict[int, int]:
        wanted = {mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: round(_MICRO / _SYSTEM_TIME_HZ)}
        if self._needs_origin and (autopilot == codec.ARDUPILOT or (autopilot == codec.PX4 and self._sends_odometry)):
            wanted[_ORIGIN] = round(_MICRO / _ORIGIN_HZ)
        wanted |= dict.fromkeys(self._positions.keys() | self._velocities.keys(), self._gnss_us)
        if self._attitude_topic:
            wanted[_ATTITUDE] = round(_MICRO / _ATTITUDE_HZ)
        if self._rest_topic:
            wanted[_LANDED] = round(_MICRO / _LANDED_HZ)
        wanted |= dict.fromkeys(self._other_imus, self._imu_us)
        wanted |= dict.fromkeys(self._carriers - {_RAW, _SCALED}, self._gnss_us)
        wanted |= dict.fromkeys(self._steppers, round(_MICRO / _STEPS_HZ))
        coarse = _coarse_of(autopilot)
        if self._imu_topic:
            wanted[_IMU] = self._imu_us
        if _IMU in wanted:
            self._began_ns = now_ns if self._began_ns is None else self._began_ns
            if self._is_gone(_IMU, now_ns) and (self._imu_topic or coarse in self._carriers):
                wanted[coarse] = wanted[_IMU]
        return wanted

    def _is_best(self, kind: str, now_ns: int, autopilot: int | None) -> bool:
        return kind == "HIGHRES_IMU" or (_IMUS[kind] == _coarse_of(autopilot) and self._is_gone(_IMU, now_ns))

    def _slow_down(self, now_ns: int) -> None:
        """Request less: ArduPilot denies above 80 % of its loop rate."""
        asked_ns = self._asked.get(_IMU, now_ns)
        if self._denied and now_ns - asked_ns > _MISSING_NS and self._heard.get(_IMU, _NEVER) < asked_ns:
            self._imu_us, self._denied = next((us for us in _SLOWER_US if us > self._imu_us), self._imu_us), False

    def _is_true_heading(self, now_ns: int, autopilot: int | None) -> bool:
        """None with a dead compass, or without one; ArduPilot's is magnetic until EKF3 has an origin."""
        self._is_blind = self._field_ns is not None and now_ns - self._field_ns > _MISSING_NS
        return not self._is_blind and (autopilot != codec.ARDUPILOT or _ORIGIN in self._heard)

    def _is_gone(self, number: int, now_ns: int) -> bool:
        since_ns = max(self._heard.get(number, _NEVER), self._began_ns or _NEVER)
        return self._began_ns is not None and now_ns - since_ns > _MISSING_NS


def _coarse_of(autopilot: int | None) -> int:
    """Others' RAW_IMU is in counts of the chip."""
    return _RAW if autopilot == codec.ARDUPILOT else _SCALED
