"""systemd's sd_notify(3): ready, alive, stopping."""

import contextlib
import os
import socket


class Notifier:
    """Sends to NOTIFY_SOCKET, if set, until stopping()."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket:
            self._socket.setblocking(False)

    def ready(self, text: str) -> None:
        """The daemon takes messages."""
        self._send(f"READY=1\nSTATUS={text}")

    def alive(self) -> None:
        """The loop turns; without this for WatchdogSec systemd restarts us."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """The daemon was asked to stop."""
        self._send("STOPPING=1")
        if self._socket:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
