"""The vehicle of benchmarks.service.vehicle with an autopilot: IMU and GNSS over MAVLink UDP, the rest over Zenoh.

    python -m benchmarks.service.autopilot --to 127.0.0.1:14540 --seconds 60 [--connect tcp/127.0.0.1:7447] [--imu-hz 400]

It behaves as PX4 does: stamps count from its boot, it says HEARTBEAT and SYSTEM_TIME, asks and answers TIMESYNC, hears ODOMETRY.
Measurements are counted under the topics on which the daemon logs them. At the end one JSON object: what was sent, what was
heard, and how late ODOMETRY came, from its own stamp to its arrival here.
"""

import math
import socket
import threading
import time
from contextlib import suppress
from typing import Any, Final

import zenoh
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.service.vehicle import Vehicle, arguments, connected, fly
from models.messages import GnssFix, GnssVelocity, ImuSample, Input

_BOOTED_NS: Final = time.time_ns() - 500_000_000_000
_BEAT_S, _ASK_S, _PATIENCE_S = 1.0, 0.1, 60.0
_ACCEL_GYRO_MAG: Final = 0b111111111
_SHARES: Final = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


class Autopilot(Vehicle):
    """Sends by MAVLink what an autopilot measures itself; a thread listens and answers."""

    def __init__(self, session: zenoh.Session, seed: int, cameras: zenoh.Session, to: tuple[str, int]) -> None:
        super().__init__(session, seed, cameras)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(to)
        self._socket.settimeout(0.02)
        self._in, self._out = (
            mavlink.MAVLink(None, srcSystem=1, srcComponent=1),
            mavlink.MAVLink(None, srcSystem=1, srcComponent=1),
        )
        self._packing, self._landed = threading.Lock(), threading.Event()
        self._fix: GnssFix | None = None
        self.heard: dict[str, int] = {}
        self.odometry_ns: list[int] = []
        self._round_trips_ns: list[int] = []
        threading.Thread(target=self._listen, daemon=True).start()
        self._wait_for_company()

    def measure(self, message: Input) -> None:
        """By MAVLink what an autopilot has: a position waits for its velocity, for they are one message."""
        match message:
            case ImuSample():
                self._say(highres_imu(message, _boot_ns(message.t_ns) // 1000))
                self._count(message.topic)
            case GnssFix():
                self._fix = message
            case GnssVelocity() if self._fix:
                self._say(gps_raw_int(self._fix, message, _boot_ns(self._fix.t_ns) // 1000))
                self._count(self._fix.topic, message.topic)
            case _:
                super().measure(message)

    def report(self) -> dict[str, Any]:
        """What was sent, and what came back over MAVLink."""
        late_ms = sorted(ns * 1e-6 for ns in self.odometry_ns) or [math.nan]
        return super().report() | {
            "mavlink_heard": self.heard,
            "mavlink_odometry_ms": {name: round(late_ms[math.ceil(q * len(late_ms)) - 1], 3) for name, q in _SHARES.items()},
            "timesync_round_trip_ms": round(1e-6 * min(self._round_trips_ns, default=0), 3),
        }

    def land(self) -> None:
        """Say no more."""
        self._landed.set()

    def _count(self, *topics: str) -> None:
        for topic in topics:
            self.sent[topic] = self.sent.get(topic, 0) + 1

    def _say(self, message: Any) -> None:
        with self._packing:
            data = message.pack(self._out)
            self._out.seq = (self._out.seq + 1) % 256
            with suppress(ConnectionRefusedError):  # nobody listens yet
                self._socket.send(data)

    def _wait_for_company(self) -> None:
        """Until the other end has said who it is, and its clock is known."""
        end = time.monotonic() + _PATIENCE_S
        while not (self.heard.get("HEARTBEAT") and len(self._round_trips_ns) > 3):
            if time.monotonic() > end:
                raise SystemExit("nobody answers over MAVLink")
            time.sleep(0.02)

    def _listen(self) -> None:
        """The thread."""
        beat_s = ask_s = 0.0
        while not self._landed.is_set():
            now_s = time.monotonic()
            if now_s >= beat_s:
                beat_s = now_s + _BEAT_S
                self._say(mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3))
                self._say(mavlink.MAVLink_system_time_message(time.time_ns() // 1000, _boot_ns() // 1_000_000))
            if now_s >= ask_s:
                ask_s = now_s + _ASK_S
                self._say(mavlink.MAVLink_timesync_message(0, _boot_ns()))
            try:
                data = self._socket.recv(65536)
            except (TimeoutError, ConnectionRefusedError):
                continue
            for message in self._in.parse_buffer(data) or []:
                self._hear(message)

    def _hear(self, message: Any) -> None:
        kind = message.get_type()
        self.heard[kind] = self.heard.get(kind, 0) + 1
        if kind == "TIMESYNC" and message.tc1 == 0:
            self._say(mavlink.MAVLink_timesync_message(_boot_ns(), message.ts1))
        elif kind == "TIMESYNC":
            self._round_trips_ns.append(_boot_ns() - message.ts1)
        elif kind == "ODOMETRY":
            self.odometry_ns.append(time.time_ns() - message.time_usec * 1000)


def _boot_ns(t_ns: int | None = None) -> int:
    """Time since boot, now or at t_ns."""
    return (time.time_ns() if t_ns is None else t_ns) - _BOOTED_NS


def highres_imu(s: ImuSample, boot_us: int) -> Any:
    """An IMU sample; boot_us: its stamp since boot."""
    rest = 0.2, 0.0, 0.4, 0.0, 0.0, 0.0, 20.0, _ACCEL_GYRO_MAG
    return mavlink.MAVLink_highres_imu_message(boot_us, *s.accel_b, *s.gyro_b, *rest)


def gps_raw_int(fix: GnssFix, velocity: GnssVelocity, boot_us: int) -> Any:
    """A position and its velocity, likewise."""
    north, east, _ = velocity.v_n
    speed, course = math.hypot(north, east), math.degrees(math.atan2(east, north)) % 360.0
    place = round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7), round((fix.alt_m - 47.5) * 1e3)
    accuracy = {"alt_ellipsoid": round(fix.alt_m * 1e3), "h_acc": 700, "v_acc": 700, "vel_acc": 100}
    return mavlink.MAVLink_gps_raw_int_message(
        boot_us, 3, *place, 80, 120, round(speed * 100), round(course * 100) % 36000, 14, **accuracy
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--to", required=True, metavar="HOST:PORT", help="where the daemon listens: [mavlink] endpoint")
    given = parser.parse_args()
    host, _, port = given.to.rpartition(":")
    session, cameras = connected(given.connect), connected(given.connect)
    autopilot = Autopilot(session, given.seed, cameras, (host, int(port)))
    fly(autopilot, given)
    autopilot.land()
    for opened in (session, cameras):
        opened.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
