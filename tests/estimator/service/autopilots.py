"""The other end of the MAVLink link: an autopilot made of pymavlink, on a UDP socket or a pseudo terminal, and its flight."""

import os
import pty
import select
import socket
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from hashlib import sha256
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.service.vehicle import gnss, imu, pose_fix, truth
from estimator.service.daemon import Daemon
from models import so3
from models.messages import GnssFix, GnssVelocity

PASSPHRASE = "a secret of two"
PX4, ARDUPILOT = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA


class Autopilot(ABC):
    """Sends on request, keeps what it hears, counts its time from its boot."""

    def __init__(self, kind: int = PX4, *, passphrase: str = "", component: int = 1) -> None:
        self.kind, self.booted_ns = kind, time.monotonic_ns() - 500_000_000_000
        self.heard: list[Any] = []
        self.codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=component)
        self.codec.robust_parsing = True
        if passphrase:
            self.codec.signing.secret_key = sha256(passphrase.encode()).digest()
            self.codec.signing.sign_outgoing = True
            self.codec.signing.timestamp = (time.time_ns() - 1_420_070_400_000_000_000) // 10_000
        self.answers_timesync = True
        self.origin: Any = None  # GPS_GLOBAL_ORIGIN, for who requests it

    def boot_us(self) -> int:
        return (time.monotonic_ns() - self.booted_ns) // 1000

    def pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return data

    def say(self, message: Any) -> bytes:
        data = self.pack(message)
        self.write(data)
        return data

    def heartbeat(self) -> bytes:
        return self.say(mavlink.MAVLink_heartbeat_message(2, self.kind, 0, 0, 4, 3))

    def imu(self, *, z: float = -9.8, boot_us: int | None = None, fields: int = 63) -> bytes:
        stamp = self.boot_us() if boot_us is None else boot_us
        rest = 0, 0, 0, 950.0, 0, 0, 20.0, fields
        return self.say(mavlink.MAVLink_highres_imu_message(stamp, 0.1, 0.2, z, 0.01, 0.02, 0.03, *rest))

    def listen(self, seconds: float = 0.0) -> list[Any]:
        """What has come, TIMESYNC answered on the way."""
        new: list[Any] = []
        end = time.monotonic() + seconds
        while (data := self.read(max(0.0, end - time.monotonic()))) or time.monotonic() < end:
            for message in self.codec.parse_buffer(data) or []:
                if message.get_type() == "TIMESYNC" and message.tc1 == 0 and self.answers_timesync:
                    self.say(mavlink.MAVLink_timesync_message(self.boot_us() * 1000, message.ts1))
                asked = message.get_type() == "COMMAND_LONG" and (message.command, message.param1) == (512, 49)
                if asked and self.origin is not None:
                    self.say(self.origin)
                new.append(message)
        self.heard += new
        return new

    def until(self, condition: Callable[[], object], what: str, *, beats: bool = True) -> None:
        """Live on until something is so."""
        end, next_beat = time.monotonic() + 60.0, 0.0
        while not condition():
            assert time.monotonic() < end, f"waited 60 s for: {what}"
            if beats and time.monotonic() > next_beat:
                next_beat = time.monotonic() + 0.2
                self.heartbeat()
            self.listen(0.02)

    def of(self, name: str) -> list[Any]:
        return [m for m in self.heard if m.get_type() == name]

    @abstractmethod
    def write(self, data: bytes) -> None:
        """To the link."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes:
        """What the link has sent, nothing after that time."""

    @abstractmethod
    def close(self) -> None:
        """Give up the socket or terminal."""


class UdpAutopilot(Autopilot):
    """Listens where a link with udpout begins; to: the port of a link with udpin."""

    def __init__(self, kind: int = PX4, *, to: int | None = None, passphrase: str = "", component: int = 1) -> None:
        super().__init__(kind, passphrase=passphrase, component=component)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._to: Any = None if to is None else ("127.0.0.1", to)
        self.port = self._socket.getsockname()[1]

    def write(self, data: bytes) -> None:
        if self._to is not None:
            self._socket.sendto(data, self._to)

    def read(self, timeout_s: float) -> bytes:
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return b""
        data, self._to = self._socket.recvfrom(65536)
        return data

    def close(self) -> None:
        self._socket.close()


class SerialAutopilot(Autopilot):
    """On the far end of a pseudo terminal; path: what the link opens."""

    def __init__(self, kind: int = PX4) -> None:
        super().__init__(kind)
        self._fd, self._near = pty.openpty()
        tty.setraw(self._near)
        os.set_blocking(self._fd, False)
        self.path = os.ttyname(self._near)

    def write(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                time.sleep(0.001)

    def read(self, timeout_s: float) -> bytes:
        try:
            return os.read(self._fd, 65536) if select.select([self._fd], [], [], timeout_s)[0] else b""
        except OSError:  # nobody has it open
            return b""

    def close(self) -> None:
        os.close(self._fd)
        os.close(self._near)


class Flight:
    """The benchmark's vehicle in real time: IMU at 100 Hz, GNSS and fixes from elsewhere at 5 Hz, 80 ms late."""

    def __init__(self, autopilot: Autopilot, daemon: Daemon, rng: np.random.Generator) -> None:
        self.autopilot, self._daemon, self._rng = autopilot, daemon, rng
        self.samples, self.has_gnss = 0, True

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Until something is so."""
        end = time.monotonic() + 180.0
        while not condition():
            assert time.monotonic() < end, f"flown for 180 s without: {what}"
            self._step()

    def _step(self) -> None:
        began, autopilot = time.monotonic_ns(), self.autopilot
        t_ns = began + self._daemon._clock.anchor_ns
        boot_ns = t_ns - (began - autopilot.booted_ns)
        sample, rest = imu(t_ns, self._rng), (0.2, 0, 0.4, 0, 0, 0, 0, 511)
        autopilot.say(mavlink.MAVLink_highres_imu_message((t_ns - boot_ns) // 1000, *sample.accel_b, *sample.gyro_b, *rest))
        if self.samples % 20 == 0:
            autopilot.heartbeat()
            rpy = so3.to_euler(so3.from_matrix(truth(t_ns)[2]))
            autopilot.say(mavlink.MAVLink_attitude_message((t_ns - boot_ns) // 1_000_000, *rpy, 0, 0, 0))
            self._daemon.mailbox.put(pose_fix(t_ns - 80_000_000, self._rng))
            if self.has_gnss:
                autopilot.say(_gps_raw_int(t_ns - 80_000_000, boot_ns, self._rng))
        self.samples += 1
        autopilot.listen(max(0.0, 0.01 - (time.monotonic_ns() - began) * 1e-9))


def _gps_raw_int(t_ns: int, boot_ns: int, rng: np.random.Generator) -> Any:
    fix, velocity = gnss(t_ns, rng)
    assert isinstance(fix, GnssFix)
    assert isinstance(velocity, GnssVelocity)
    north, east, _ = velocity.v_n
    speed, course = np.hypot(north, east), np.degrees(np.arctan2(east, north)) % 360.0
    return mavlink.MAVLink_gps_raw_int_message(
        (t_ns - boot_ns) // 1000, 3, round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7), 0, 80, 120,
        round(speed * 100), round(course * 100), 12, round(fix.alt_m * 1e3), 700, 700, 100,
    )  # fmt: skip
