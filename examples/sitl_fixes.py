"""Landmark fixes for a simulator that draws no images: its own truth with noise, once a second, as /pose_fix over Zenoh.

    python examples/sitl_fixes.py -c sitl.toml --from udpin:127.0.0.1:14030

Listens on a second MAVLink port of PX4 SITL (HIL_STATE_QUATERNION) or ArduPilot SITL (SIM_STATE), next to that of landfix.
"""

import argparse
import contextlib
import secrets
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from pymavlink import mavutil

from estimator.config import Config, load
from estimator.service.zenoh import keys as zenoh_keys
from logs.wire.codec import encode_input, type_hash
from models import so3
from models.frames import Origin
from models.messages import PoseFix, vec3

TRUTHS = {12: ("HIL_STATE_QUATERNION", 115), 3: ("SIM_STATE", 108)}  # by autopilot: PX4, ArduPilot
SET_MESSAGE_INTERVAL, ACCEPTED, IN_PROGRESS = 511, 0, 5
ASK_EVERY_S = 5.0
SIGMA = np.repeat([0.3, np.deg2rad(1.0)], 3)  # m, rad: of the fixes that are made


def place_of(message: Any) -> tuple[float, float, float, tuple[float, ...]]:
    """Latitude and longitude in degrees, height above the sea in m, and q_nb (w, x, y, z) from a simulator."""
    if message.get_type() == "HIL_STATE_QUATERNION":
        return message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3, tuple(message.attitude_quaternion)
    return message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt, (message.q1, message.q2, message.q3, message.q4)


def fix(message: Any, config: Config, t_ns: int, rng: np.random.Generator) -> PoseFix:
    """The pose with noise, about the origin of the configuration."""
    assert config.map.origin is not None
    lat_deg, lon_deg, alt_m, q_nb = place_of(message)
    noise = SIGMA * rng.standard_normal(6)
    p_n = np.array(Origin(*config.map.origin).to_ned(lat_deg, lon_deg, alt_m + config.map.geoid_m)) + noise[:3]
    q = so3.multiply(so3.quat_exp(noise[3:]), so3.normalise(np.array(q_nb)))
    return PoseFix(t_ns, t_ns, vec3(p_n), (q[0], q[1], q[2], q[3]), np.diag(SIGMA**2))


class Truth:
    """What the simulator knows: asked for once we know which one it is, again while it does not come, never after a refusal."""

    def __init__(self, endpoint: str) -> None:
        self._link = mavutil.mavlink_connection(endpoint)
        self._wanted: tuple[str, int] | None = None
        self._asked_s = -ASK_EVERY_S

    def next(self) -> Any:
        """The next message with it; None: nothing yet. Raises SystemExit where the simulator refuses to send it."""
        message = self._link.recv_match(blocking=True, timeout=0.1)
        kind = "" if message is None else message.get_type()
        if kind == "HEARTBEAT" and message.autopilot in TRUTHS:
            self._wanted = TRUTHS[message.autopilot]
        if self._wanted is None:
            return None
        name, number = self._wanted
        if kind == "COMMAND_ACK" and message.command == SET_MESSAGE_INTERVAL and message.result not in {ACCEPTED, IN_PROGRESS}:
            raise SystemExit(f"the simulator does not send {name} ({number}): MAV_RESULT {message.result}")
        now_s = time.monotonic()
        if kind == name:
            self._asked_s = now_s
            return message
        if now_s - self._asked_s >= ASK_EVERY_S:
            self._asked_s = now_s
            command = SET_MESSAGE_INTERVAL
            self._link.mav.command_long_send(self._link.target_system, 1, command, 0, number, 100_000, 0, 0, 0, 0, 0)
        return None


def session_with(endpoint: str) -> zenoh.Session:
    """A session with landfix; waits until it listens, because it loads for seconds."""
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
    said = False
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError:
            if not said:
                print(f"waiting for landfix run at {endpoint}", flush=True)
            said = True
            time.sleep(1.0)


def main() -> None:
    """Send fixes until somebody presses Ctrl-C."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("-c", "--config", type=Path, required=True, help="that of landfix run; it must have [map] origin")
    parser.add_argument("--from", dest="endpoint", required=True, help="where the simulator sends, such as udpin:127.0.0.1:14030")
    parser.add_argument("--every", type=float, default=1.0, metavar="SECONDS", help="between fixes")
    parser.add_argument("--late", type=float, default=0.0, metavar="SECONDS", help="from a fix's stamp to when it is sent")
    given = parser.parse_args()
    config, rng = load(given.config), np.random.default_rng()
    if config.map.origin is None:
        parser.error(f"{given.config}: [map] origin is missing")
    truth = Truth(given.endpoint)
    with session_with(config.zenoh.listen[0]) as session:
        schema, gid, sent = "geometry_msgs/msg/PoseWithCovarianceStamped", secrets.token_bytes(16), 0
        publisher = session.declare_publisher(zenoh_keys.rmw_key(config.zenoh.domain, "/pose_fix", schema, type_hash(schema)))
        print(f"fixes go to {config.zenoh.listen[0]}, one every {given.every:g} s", flush=True)
        last, waiting = 0.0, deque[tuple[float, bytes]]()
        while True:
            message, now = truth.next(), time.monotonic()
            if message is not None and now - last >= given.every:
                last = now
                waiting.append((now + given.late, encode_input(fix(message, config, time.time_ns(), rng)).data))
            while waiting and waiting[0][0] <= now:
                sent += 1
                publisher.put(waiting.popleft()[1], attachment=zenoh_keys.attachment(sent, time.time_ns(), gid))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
