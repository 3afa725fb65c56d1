"""The autopilot link: one thread that never waits to send."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from estimator.publish import Pace
from estimator.service.autopilot.clock import AutopilotClock
from estimator.service.autopilot.local_frame import LocalOrigin
from estimator.service.autopilot.output_policy import OutputPolicy, is_sound, newest
from estimator.service.base.clock import SECOND_NS, Clock
from estimator.service.base.ports import Inbox
from estimator.service.mavlink import codec, ekf_sources
from estimator.service.mavlink.config import MavlinkConfig, address_of, signing_key
from estimator.service.mavlink.inputs import Inputs
from estimator.service.mavlink.io import opened
from estimator.service.mavlink.wire import Wire
from estimator.strict_toml import ConfigError
from logs.wire.codec import Encoded, Topics
from models import so3
from models.frames import Origin
from models.messages import Alert, Estimate, Output, vec3
from models.radius import horizontal_radius
from models.state import X

_HEARTBEAT_NS: Final = SECOND_NS
_NO_ORIGIN_NS: Final = 5 * SECOND_NS  # without an answer: PX4 has none
_SETTLED_NS: Final = 3 * SECOND_NS  # of usable odometry: EKF2 has it, and keeps it where it is given an origin
_TIMESYNC_NS: Final = SECOND_NS // 4
_GONE_NS: Final = 3 * SECOND_NS  # without a HEARTBEAT
_IMPLAUSIBLE_NS: Final = 2 * SECOND_NS  # a stamp further from now than this is of no known clock
_ODOMETRIES: Final = frozenset({"ODOMETRY", "VISION_POSITION_DELTA"})
_TURN_S: Final = 0.02  # the thread looks at the time this often
_US_NS: Final = 1_000
_DEGREES, _METRES = 1e-7, 1e-3  # of GPS_GLOBAL_ORIGIN
_EKFS: Final = {codec.PX4: "EKF2", codec.ARDUPILOT: "EKF3"}
_AUTOPILOTS: Final = {"px4": codec.PX4, "ardupilot": codec.ARDUPILOT}
_NAMES: Final = {number: name for name, number in _AUTOPILOTS.items()}
_IN_PROGRESS: Final = frozenset({mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS})
_OF_THE_LINK: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_TIMESYNC,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        *ekf_sources.WANTED,
    }
)


class MavlinkLink:
    """An Outbox that feeds an Inbox. Raises ConfigError."""

    def __init__(
        self,
        config: MavlinkConfig,
        folder: Path,
        topics: Topics,
        clock: Clock,
        policy: OutputPolicy,
        odometry_hz: float,
        geoid_m: float,
        say: Callable[[str], None] = lambda _: None,
        level: tuple[float, float] | None = None,
    ) -> None:
        """say: prints a line; level: see FlowRange. Raises ConfigError."""
        if clash := set(config.odometry_from) & {config.component, *config.listen_to}:
            raise ConfigError(f"mavlink.odometry_from = {min(clash)}: is the autopilot or landfix itself: name another component")
        self._config, self._clock, self._policy, self._geoid_m = config, clock, policy, geoid_m
        self._say, self._said, self._said_ns = say, "", -SECOND_NS
        self._inputs = Inputs(config, topics, geoid_m, level)
        key, heard = signing_key(config, folder), frozenset(config.listen_to) | self._inputs.companions
        wanted = _OF_THE_LINK | self._inputs.wanted
        self._in, self._out = (
            Wire(config.system, config.component, heard, wanted, key, clock.now_ns()) for _ in ("what it parses", "what it packs")
        )
        self._pace, self._fix_waits = Pace(odometry_hz), False
        self._boot, self._local, self._ekf = AutopilotClock(), LocalOrigin(), ekf_sources.EkfSources()
        self._map_origin: tuple[float, float, float] | None = None
        self._quality: int | None = None  # of the last odometry
        self._alerted: Alert | None = None  # as the last STATUSTEXT said
        self._alerts = 0  # how many there were, counted anew after 65535
        self._unix_ahead_ns: int | None = None  # of our clock, as SYSTEM_TIME says
        self._autopilot = _AUTOPILOTS.get(config.autopilot)
        self._peer: Any = None
        self._is_boat = False
        self._heartbeat_ns = self._peer_ns = -SECOND_NS * 3600
        self._next_heartbeat_ns = self._next_timesync_ns = self._since_ns = 0
        self._given_ns, self._usable_since_ns = -_NO_ORIGIN_NS, 0  # an origin was given; of odometry
        self._sending, self._stopping = threading.Lock(), False
        self.sent_odometry = self.sent_fixes = self.unsent = self.strangers = self.commands_refused = self.defects = 0
        self.refused = self.out_of_range = self.impossible_dates = self.implausible_companions = 0
        self._defect = self._refusal = ""  # the last one
        self._endpoint = opened(address_of(config))
        self._thread: threading.Thread | None = None

    def open_inputs(self, inbox: Inbox) -> None:
        """From now on measurements go there, and the autopilot hears of us."""
        self._thread = threading.Thread(target=self._run, args=(inbox,), name="mavlink", daemon=True)
        self._thread.start()

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:  # noqa: ARG002  (an Outbox is given both)
        """Send the outputs meant for the autopilot."""
        self._fix_waits |= self._policy.note(outputs)
        estimate = newest(outputs)
        autopilot = self._autopilot
        if autopilot is None or autopilot not in _NAMES or self._clock.now_ns() - self._heartbeat_ns > _GONE_NS:
            return
        self._tell_alert()
        if estimate is None:
            return
        if not is_sound(estimate):
            self.out_of_range += 1
            return
        self._inputs.flow_range.note_estimate(estimate)
        time_usec = estimate.t_ns // _US_NS
        if self._config.odometry and self._pace.due(estimate.t_ns):
            self.sent_odometry += self._tell(self._odometry(estimate, time_usec, autopilot))
        if self._fix_waits:
            self._fix_waits = False
            self._tell_fix(estimate, time_usec)

    def close(self) -> None:
        """Stop listening."""
        self._stopping = True
        if self._thread:
            self._thread.join()
        with self._sending:
            self._endpoint.close()

    def report(self) -> dict[str, Any]:
        """For the status."""
        offset, now_ns = self._boot.offset, self._clock.now_ns()
        known = offset.ahead_ns is not None
        return {
            "state": self._endpoint.state,
            "autopilot": _NAMES.get(self._autopilot or -1, "unknown"),
            "heard_s": f"{(now_ns - self._heartbeat_ns) * 1e-9:.1f}" if self._heartbeat_ns > 0 else "never",
            "clock_ahead_s": f"{(offset.ahead_ns or 0) * 1e-9:.6f}" if known else "unknown",
            "clock_bound_ms": f"{offset.bound_ns * 1e-6:.3f}",
            "timesync_answers": self._boot.answers,
            "clock_steps": offset.steps,
            "reboots": self._boot.reboots,
            "implausible_stamps": self._boot.implausible + self.implausible_companions,
            **self._inputs.report(),
            **self._ekf.report(),
            "ekf_origin": self._local.report(self._map_origin, self._geoid_m, from_ours=self._autopilot == codec.PX4),
            "odometry": self.sent_odometry,
            "quality": "none sent" if self._quality is None else self._quality,
            "fixes": self.sent_fixes,
            "unsent": self.unsent,
            "out_of_range": self.out_of_range,
            "impossible_dates": self.impossible_dates,
            "refused": self.refused,
            **({"refusal": self._refusal} if self._refusal else {}),
            "damaged": self._in.damaged,
            "passed_over": self._in.passed_over,
            "refused_signatures": self._in.refused,
            "strangers": self.strangers,
            "commands_refused": self.commands_refused,
            "defects": self.defects,
            **({"defect": self._defect} if self._defect else {}),
        }

    def _odometry(self, estimate: Estimate, time_usec: int, autopilot: int) -> Any:
        is_ardupilot = autopilot == codec.ARDUPILOT
        self._map_origin = estimate.origin
        ours = vec3(estimate.nav[X.P]), so3.normalise(estimate.nav[X.Q])
        pose = self._local.pose(estimate, self._geoid_m, is_px4=not is_ardupilot)
        has_none = self._local.place is None and self._clock.now_ns() - self._since_ns > _NO_ORIGIN_NS
        if has_none:
            self._give_origin(estimate, is_ardupilot=is_ardupilot)
            pose = None if is_ardupilot else ours  # PX4's local frame is where odometry has it
        quality, usable = self._policy.quality(estimate, one_source_at_a_time=is_ardupilot) if pose else (-1, False)
        self._announce(estimate, quality, usable=usable, knows_frame=pose is not None)
        (p, q), self._quality = pose or ours, quality
        self._usable_since_ns = (self._usable_since_ns or estimate.t_ns) if usable else 0
        counter = self._policy.reset_counter(estimate, p, usable=usable)
        return codec.odometry(estimate, (p if usable or quality < 0 else None, q), time_usec, counter, quality, autopilot)

    def _give_origin(self, estimate: Estimate, *, is_ardupilot: bool) -> None:
        """Once in 5 s: its place to ArduPilot; to PX4, whose frame is ours by now, our origin at its height, its barometer's."""
        origin, now_ns = Origin.of(estimate.origin), self._clock.now_ns()
        settled = is_ardupilot or 0 < self._usable_since_ns <= estimate.t_ns - _SETTLED_NS
        if origin is None or not settled or not self._policy.starts_without_gnss or now_ns - self._given_ns <= _NO_ORIGIN_NS:
            return
        self._given_ns = now_ns
        here = origin.to_geodetic(estimate.nav[X.P])
        at = here if is_ardupilot else (origin.lat_deg, origin.lon_deg, here[2])
        self._tell(codec.set_origin(codec.place(at, self._geoid_m), self._config.system))

    def _tell_alert(self) -> None:
        now = self._policy.integrity
        if now is None or now.state is self._alerted:
            return
        self._alerts = self._alerts % 0xFFFF + 1
        if all(self._tell(part) for part in codec.alert(now, self._alerts)):
            self._alerted = now.state

    def _announce(self, estimate: Estimate, quality: int, *, usable: bool, knows_frame: bool) -> None:
        radius_m = float(horizontal_radius(estimate.covariance[None, :2, :2])[0])
        if quality >= 0:
            line = "odometry may be used" if usable else "of odometry the velocity may be used, not the position"
        elif self._policy.is_alarmed:  # the reason, with its numbers, has a line of its own
            line = "odometry is not to be used: so says integrity"
        elif not knows_frame and self._local.place is not None and self._map_origin is not None:
            return  # it has come meanwhile: the next message is in its frame
        elif not knows_frame:
            ekf, where = _EKFS.get(self._autopilot or -1, "its EKF"), self._local.report(self._map_origin, self._geoid_m)
            line = f"odometry is not to be used: the origin of {ekf} is {where}"
        elif radius_m < self._policy.most_radius_m:
            line = f"odometry is not to be used: the mode is {estimate.mode.value}"
        else:
            line = f"odometry is not to be used: its 95 % radius is above {self._policy.most_radius_m:g} m"
        if line != self._said and estimate.t_ns - self._said_ns >= SECOND_NS:
            self._said, self._said_ns = line, estimate.t_ns
            self._say(f"{_NAMES.get(self._autopilot or -1, 'autopilot')}: {line}")

    def _tell_fix(self, estimate: Estimate, time_usec: int) -> None:
        origin = Origin.of(estimate.origin)
        if origin is None or not self._config.fixes or not self._policy.is_fix(estimate):
            return
        estimate = self._policy.widened(estimate)
        at = codec.place(origin.to_geodetic(estimate.nav[X.P]), self._geoid_m)
        if self._autopilot == codec.PX4:
            message = codec.global_position(estimate, at, time_usec, self._config.slot, self._config.system)
        else:
            utc_ns = None if self._unix_ahead_ns is None else estimate.t_ns + self._unix_ahead_ns
            message = codec.gps_input(estimate, at, time_usec, self._config.slot, utc_ns)
        self.sent_fixes += self._tell(message)

    def _tell(self, message: Any) -> bool:
        with self._sending:
            if self._stopping:
                return False
            signing = self._out.signing
            signing.timestamp = max(signing.timestamp, self._in.signing.timestamp)
            frame = self._out.packed(message)
            went = frame is not None and self._endpoint.send(frame, self._peer)
        self.out_of_range += frame is None
        self.unsent += frame is not None and not went
        return went

    def _run(self, inbox: Inbox) -> None:
        while not self._stopping:
            try:
                self._turn(inbox)
            except Exception as error:  # a defect of ours costs what was just read, not the link
                self.defects, self._defect = self.defects + 1, f"{type(error).__name__}: {error}"

    def _turn(self, inbox: Inbox) -> None:
        heard = self._endpoint.receive(_TURN_S)
        now_ns = self._clock.now_ns()
        if heard is not None:
            for message in self._in.messages(heard.data, whole=self._endpoint.whole):
                if self._is_peer(heard.sender, now_ns):
                    self._judge(message, now_ns, inbox)
        self._speak(now_ns)

    def _judge(self, message: Any, now_ns: int, inbox: Inbox) -> None:
        try:
            self._take(message, now_ns, inbox)
        except Exception as error:  # a peer's bytes may raise what no check covers
            self.refused, self._refusal = self.refused + 1, f"{message.get_type()}: {str(error) or type(error).__name__}"

    def _is_peer(self, sender: Any, now_ns: int) -> bool:
        if sender != self._peer and now_ns - self._peer_ns <= _GONE_NS:
            self.strangers += 1
            return False
        self._peer, self._peer_ns = sender, now_ns
        return True

    def _take(self, message: Any, now_ns: int, inbox: Inbox) -> None:
        if message.get_srcComponent() in self._inputs.companions:
            self._take_odometry(message, now_ns, inbox)
            return
        kind = message.get_type()
        self._inputs.hear(message, now_ns)
        if kind == "HEARTBEAT":
            self._hear_heartbeat(message, now_ns)
        elif kind == "TIMESYNC":
            self._hear_timesync(message, now_ns)
        elif kind == "SYSTEM_TIME":
            self._hear_system_time(message, now_ns)
        elif kind == "GPS_GLOBAL_ORIGIN":
            self._local.hear(message.latitude * _DEGREES, message.longitude * _DEGREES, message.altitude * _METRES)
        elif kind == "COMMAND_ACK":
            asked = message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            refused = asked and message.result not in _IN_PROGRESS
            self.commands_refused += refused
            if refused:
                self._inputs.deny()
        elif message.get_msgId() in ekf_sources.WANTED:
            self._ekf.hear(message)
        elif kind == "GNSS_INTEGRITY":
            self._inputs.note_integrity(message, now_ns)
        elif kind == "EXTENDED_SYS_STATE":
            for measurement in self._inputs.landed(message, now_ns) if not self._is_boat else ():
                inbox.put(measurement)
        else:
            before = self._boot.reboots
            t_ns = self._boot.t_ns(codec.stamp_ns(message), now_ns) if codec.is_of_now(message) else now_ns
            if self._boot.reboots != before:
                self._ask_again()
            if t_ns is not None:
                for measurement in self._inputs.measured(message, t_ns, now_ns, self._autopilot):
                    inbox.put(measurement)

    def _take_odometry(self, message: Any, now_ns: int, inbox: Inbox) -> None:
        stamp_ns = codec.stamp_ns(message)
        for t_ns in (stamp_ns, self._boot.offset.ours(stamp_ns)):
            if t_ns is not None and abs(t_ns - now_ns) <= _IMPLAUSIBLE_NS:
                for measurement in self._inputs.odometry(message, t_ns):
                    inbox.put(measurement)
                return
        self.implausible_companions += message.get_type() in _ODOMETRIES

    def _ask_again(self) -> None:
        self._inputs.ask_again()
        self._local.forget()
        self._ekf = ekf_sources.EkfSources()
        self._since_ns = self._clock.now_ns()

    def _hear_heartbeat(self, message: Any, now_ns: int) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return
        if now_ns - self._heartbeat_ns > _GONE_NS:
            self._ask_again()
        self._heartbeat_ns, self._is_boat = now_ns, message.type == mavlink.MAV_TYPE_SURFACE_BOAT
        if self._config.autopilot == "auto":
            self._autopilot = message.autopilot

    def _hear_timesync(self, message: Any, now_ns: int) -> None:
        if message.tc1 == 0:
            self._tell(mavlink.MAVLink_timesync_message(now_ns, message.ts1))
        else:
            self._boot.answer(message.ts1, message.tc1, now_ns)

    def _hear_system_time(self, message: Any, now_ns: int) -> None:
        before = self._boot.reboots
        self._boot.hear(codec.stamp_ns(message), now_ns)
        if self._boot.reboots != before:
            self._ask_again()
        unix_ns = message.time_unix_usec * _US_NS
        dated = codec.is_date(unix_ns)
        self.impossible_dates += unix_ns > 0 and not dated
        self._unix_ahead_ns = unix_ns - now_ns if dated else None

    def _speak(self, now_ns: int) -> None:
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + _HEARTBEAT_NS
            kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self._tell(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))
        if now_ns - self._heartbeat_ns > _GONE_NS:
            return
        if now_ns >= self._next_timesync_ns:
            self._next_timesync_ns = now_ns + _TIMESYNC_NS
            asked_ns = self._boot.ask(self._clock.now_ns())
            self._tell(mavlink.MAVLink_timesync_message(0, asked_ns))
        for number, period_us in self._inputs.requests(now_ns, self._autopilot):
            self._tell(_request(self._config.system, number, period_us))
            if number == mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN and self._autopilot == codec.PX4:
                self._tell(_request_once(self._config.system, number))


def _request(system: int, number: int, period_us: int) -> Any:
    command, autopilot = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_COMP_ID_AUTOPILOT1
    return mavlink.MAVLink_command_long_message(system, autopilot, command, 0, number, period_us, 0, 0, 0, 0, 0)


def _request_once(system: int, number: int) -> Any:
    """Ask PX4 for its origin, which it sends only when it changes."""
    command, autopilot = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_COMP_ID_AUTOPILOT1
    return mavlink.MAVLink_command_long_message(system, autopilot, command, 0, number, 0, 0, 0, 0, 0, 0)
