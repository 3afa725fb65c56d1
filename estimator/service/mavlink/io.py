"""MAVLink bytes over a UDP socket or serial device; sending never blocks, excess is dropped."""

import os
import select
import socket
import termios
import time
import tty
from contextlib import ExitStack, suppress
from typing import Any, Final, NamedTuple, Protocol

from estimator.service.mavlink.config import BAUDS, Serial, Udp
from estimator.strict_toml import ConfigError

_MOST: Final = 65536  # bytes read at once
_BUFFER: Final = 1 << 20  # bytes that wait for us in the kernel, if it lets us have so much
_REOPEN_S: Final = 0.5


class Heard(NamedTuple):
    """Bytes, and sender (None: the wire's other end)."""

    data: bytes
    sender: Any


class Endpoint(Protocol):
    """An input and output; never raises once made."""

    @property
    def whole(self) -> bool:
        """Whether frames arrive whole."""
        ...

    @property
    def state(self) -> str:
        """For the status."""
        ...

    def receive(self, timeout_s: float) -> Heard | None:
        """Received bytes; None: time-out."""
        ...

    def send(self, data: bytes, receiver: Any) -> bool:
        """Whether it went out."""
        ...

    def close(self) -> None:
        """The end."""
        ...


def opened(address: Udp | Serial) -> Endpoint:
    """Raises ConfigError for an unavailable address; serial devices may come later."""
    return UdpEndpoint(address) if isinstance(address, Udp) else SerialEndpoint(address)


class UdpEndpoint:
    """Datagrams: a listening socket answers the given peer."""

    whole = True
    state = "open"

    def __init__(self, address: Udp) -> None:
        self._listens = address.listens
        try:
            ((family, kind, protocol, _, place), *_) = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
            with ExitStack() as until_it_works:
                self._socket = until_it_works.enter_context(socket.socket(family, kind, protocol))
                self._socket.setblocking(False)
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
                (self._socket.bind if self._listens else self._socket.connect)(place)
                until_it_works.pop_all()
        except OSError as error:
            reason = (error.strerror or "cannot be opened").lower()
            raise ConfigError(f"mavlink.endpoint = {address.host}:{address.port}: {reason}") from None

    @property
    def port(self) -> int:
        """Ours."""
        return int(self._socket.getsockname()[1])

    def receive(self, timeout_s: float) -> Heard | None:
        """One datagram."""
        try:
            if select.select([self._socket], [], [], timeout_s)[0]:
                return Heard(*self._socket.recvfrom(_MOST))
        except OSError:  # nobody there yet (ECONNREFUSED)
            time.sleep(min(timeout_s, 0.01))
        return None

    def send(self, data: bytes, receiver: Any) -> bool:
        """Send to the receiver, or the only peer."""
        if self._listens and receiver is None:
            return False
        try:
            sent = self._socket.sendto(data, receiver) if self._listens else self._socket.send(data)
        except OSError:
            return False
        return sent == len(data)

    def close(self) -> None:
        """The end."""
        self._socket.close()


class SerialEndpoint:
    """A serial device, opened again when it was unplugged."""

    whole = False

    def __init__(self, device: Serial) -> None:
        self._device, self._next_s = device, 0.0
        self._rest = b""  # of a frame that did not fit whole: a torn one would spoil the next
        self._fd: int | None = None
        self.state = "not open yet"
        self._open()

    def receive(self, timeout_s: float) -> Heard | None:
        """Received bytes of the device."""
        fd = self._fd
        if fd is None:
            time.sleep(timeout_s)
            self._open()
            return None
        try:
            if not select.select([fd], [], [], timeout_s)[0]:
                return None
            data = os.read(fd, _MOST)
        except BlockingIOError:
            return None
        except OSError as error:
            self._lose(fd, error.strerror or "lost")
            return None
        if not data:
            self._lose(fd, "hung up")
            return None
        return Heard(data, None)

    def send(self, data: bytes, receiver: Any) -> bool:  # noqa: ARG002  (there is only one)
        """Send all or nothing, but the rest of a frame begun."""
        fd = self._fd
        if fd is None:
            return False
        try:
            if self._rest:
                self._rest = self._rest[os.write(fd, self._rest) :]
            if self._rest:
                return False
            self._rest = data[os.write(fd, data) :]
        except OSError:  # full, or lost, which the reader notices
            return False
        return True

    def close(self) -> None:
        """The end."""
        fd, self._fd = self._fd, None
        if fd is not None:
            with suppress(OSError):
                os.close(fd)

    def _lose(self, fd: int, reason: str) -> None:
        self._fd, self._rest, self.state = None, b"", reason.lower()
        self._next_s = time.monotonic() + _REOPEN_S
        with suppress(OSError):
            os.close(fd)

    def _open(self) -> None:
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + _REOPEN_S
        try:
            fd = os.open(self._device.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            self.state = (error.strerror or "cannot be opened").lower()
            return
        try:
            tty.setraw(fd, termios.TCSANOW)
            settings = termios.tcgetattr(fd)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = BAUDS[self._device.baud]
            termios.tcsetattr(fd, termios.TCSANOW, settings)
        except termios.error:
            self.state = "not a serial device"
            os.close(fd)
            return
        self._fd, self.state = fd, "open"
