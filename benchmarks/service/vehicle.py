"""A simulated vehicle as a process of its own: sensors over Zenoh in real time.

    python -m benchmarks.service.vehicle --seconds 60 [--connect tcp/127.0.0.1:7447] [--imu-hz 400] [--pictures turn.mcap]

It flies a level circle at constant speed, so that every run, however long, is the same work. Stamps are the wall clock's. At the
end one JSON object says how many messages were sent.
"""

import argparse
import json
import math
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from estimator.service.zenoh import keys as zenoh_keys
from logs.store.reader import LogReader
from logs.wire import schemas
from logs.wire.codec import Encoded, encode_input, type_hash
from logs.wire.schemas import STORE
from logs.wire.stamps import restamped, stamp_of
from models import so3
from models.frames import Origin
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, PoseFix, vec3

ORIGIN = Origin(47.3977, 8.5456, 488.0)
RADIUS_M, HEIGHT_M = 30.0, 40.0
PERIOD_NS = 30_000_000_000  # of a turn
RATE = 2.0 * math.pi / (PERIOD_NS * 1e-9)
SPEED_M_S = RATE * RADIUS_M
IMU_SIGMA = np.repeat([2e-3, 3e-2], 3)  # rad/s, m/s^2: white, at 400 Hz
_VGA = (480, 640)
_IMAGES = (schemas.IMAGE, schemas.COMPRESSED_IMAGE)


def truth(t_ns: int) -> tuple[Array, Array, Array]:
    """p_n, v_n and R_nb on the circle: clockwise, nose forward, level."""
    a = RATE * (t_ns % PERIOD_NS) * 1e-9
    p = np.array([RADIUS_M * math.cos(a), RADIUS_M * math.sin(a), -HEIGHT_M])
    v = SPEED_M_S * np.array([-math.sin(a), math.cos(a), 0.0])
    return p, v, so3.matrix(so3.from_euler(0.0, 0.0, a + math.pi / 2))


def imu(t_ns: int, rng: np.random.Generator) -> ImuSample:
    """What the IMU says: the turn, the Earth's rotation, centripetal force, gravity."""
    gyro_b = np.array([0.0, 0.0, RATE]) + ORIGIN.earth_rate_n @ truth(t_ns)[2]
    y = np.concatenate([gyro_b, [0.0, SPEED_M_S * RATE, -ORIGIN.gravity]]) + IMU_SIGMA * rng.standard_normal(6)
    return ImuSample(t_ns, t_ns, vec3(y[:3]), vec3(y[3:]))


def gnss(t_ns: int, rng: np.random.Generator) -> list[Input]:
    """Position and velocity of a receiver."""
    p, v, _ = truth(t_ns)
    lla = ORIGIN.to_geodetic(p + rng.normal(0.0, 0.7, 3))
    velocity = vec3(v + rng.normal(0.0, 0.1, 3))
    return [GnssFix(t_ns, t_ns, *lla, np.eye(3) * 0.49), GnssVelocity(t_ns, t_ns, velocity, np.eye(3) * 0.01)]


def pose_fix(t_ns: int, rng: np.random.Generator) -> PoseFix:
    """A fix from outside, 0.1 m and 1 degree."""
    p, _, R_nb = truth(t_ns)
    q = so3.multiply(so3.quat_exp(rng.normal(0.0, 0.017, 3)), so3.from_matrix(R_nb))
    covariance = np.diag(np.repeat([0.01, 0.017**2], 3))
    return PoseFix(t_ns, t_ns, vec3(p + rng.normal(0.0, 0.1, 3)), (q[0], q[1], q[2], q[3]), covariance)


def image(topic: str, t_ns: int, pixels: bytes) -> Encoded:
    """A raw grey VGA image."""
    make: Any = STORE.types
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    stamp = make["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    header = make[schemas.HEADER](stamp=stamp, frame_id="camera")
    height, width = _VGA
    data = np.frombuffer(pixels, np.uint8)
    message = make[schemas.IMAGE](
        header=header, height=height, width=width, encoding="mono8", is_bigendian=0, step=width, data=data
    )
    return Encoded(topic, schemas.IMAGE, bytes(STORE.serialize_cdr(message, schemas.IMAGE, little_endian=True)))


class Turn:
    """Images of one turn of the circle (benchmarks.service.images), over and over, each exactly when the vehicle is there."""

    def __init__(self, log: Path) -> None:
        with LogReader(log) as reader:
            messages = [Encoded(r.topic, r.schema, r.data) for r in reader]
        self._pairs = list(zip(messages[0::2], messages[1::2], strict=True))
        self._interval_ns = PERIOD_NS // len(self._pairs)
        self._last = time.time_ns() // self._interval_ns

    def due(self, now_ns: int) -> list[Encoded]:
        """The pair whose exposure has just passed."""
        place = now_ns // self._interval_ns
        if place == self._last:
            return []
        self._last = place
        pair = self._pairs[place % len(self._pairs)]
        return [message._replace(data=restamped(message.data, place * self._interval_ns)) for message in pair]


class Vehicle:
    """Publishers as rmw_zenoh would declare them, and a subscriber that times the estimates that come back."""

    def __init__(self, session: zenoh.Session, seed: int, cameras: zenoh.Session | None = None) -> None:
        """cameras: a session of their own, as a driver in a process of its own has it."""
        self._session, self._cameras, self._rng = session, cameras or session, np.random.default_rng(seed)
        self._publishers: dict[tuple[str, str], zenoh.Publisher] = {}
        self._sequence, self._gid = 0, secrets.token_bytes(16)
        self._pixels = self._rng.integers(0, 255, _VGA, np.uint8).tobytes()
        self.sent: dict[str, int] = {}
        self.latency_ns: list[int] = []
        self.flown_ns = self.heard_ns = 0  # stamps of the last sample sent, and of the last estimate
        key = zenoh_keys.rmw_key(0, "/landfix/odometry", schemas.ODOMETRY)
        self._subscriber = session.declare_subscriber(key, self._receive)

    def put(self, encoded: Encoded) -> None:
        """Send a message."""
        topic, schema, data = encoded
        self._sequence += 1
        attachment = zenoh_keys.attachment(self._sequence, time.time_ns(), self._gid)
        self._publisher(topic, schema).put(data, attachment=attachment)
        self.sent[topic] = self.sent.get(topic, 0) + 1

    def measure(self, message: Input) -> None:
        """Send a measurement."""
        self.put(encode_input(message))

    def report(self) -> dict[str, Any]:
        """What there is to say at the end."""
        return {"sent": self.sent}

    def _publisher(self, topic: str, schema: str) -> zenoh.Publisher:
        if (topic, schema) not in self._publishers:
            self._publishers[topic, schema] = self._declared(topic, schema)
        return self._publishers[topic, schema]

    def _declared(self, topic: str, schema: str) -> zenoh.Publisher:
        """Reliable for measurements, best effort for cameras of their own, as rmw_zenoh maps them."""
        key, control = zenoh_keys.rmw_key(0, topic, schema, type_hash(schema)), zenoh.CongestionControl
        if schema in _IMAGES and self._cameras is not self._session:
            return self._cameras.declare_publisher(key, congestion_control=control.DROP)
        return self._session.declare_publisher(key, congestion_control=control.BLOCK, express=True)

    def fly(
        self,
        seconds: float,
        imu_hz: float,
        *,
        gnss_hz: float,
        fix_hz: float,
        fix_s: float = math.inf,
        image_hz: float = 0.0,
        turn: Turn | None = None,
    ) -> None:
        """In real time. fix_s: pose fixes end then; image_hz: of raw noise; turn: what there is to see."""
        period_ns, t_ns = round(1e9 / imu_hz), time.time_ns()
        for message in (imu(t_ns, self._rng), *gnss(t_ns, self._rng), pose_fix(t_ns, self._rng)):
            self._publisher(*encode_input(message)[:2])  # kernels, tables, keys: the first sample is not to be late
        time.sleep(0.5)  # until the daemon is known
        for k, t_ns in enumerate(_paced(seconds, period_ns)):
            self.measure(imu(t_ns, self._rng))
            self.flown_ns = t_ns
            if _due(k, gnss_hz, imu_hz):
                for message in gnss(t_ns, self._rng):
                    self.measure(message)
            if _due(k, fix_hz, imu_hz) and k < fix_s * imu_hz:
                self.measure(pose_fix(t_ns, self._rng))
            if _due(k, image_hz, imu_hz):
                for topic in ("/left/image", "/right/image"):
                    self.put(image(topic, t_ns, self._pixels))
            for shot in turn.due(t_ns) if turn else ():
                self.put(shot)

    def _receive(self, sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        t_ns = stamp_of(sample.payload.to_bytes())
        if t_ns is not None:
            self.latency_ns.append(now_ns - t_ns)
            self.heard_ns = t_ns


def _paced(seconds: float, period_ns: int) -> Iterator[int]:
    """Wall clock stamps, each as soon as it is due."""
    start_ns = time.time_ns()
    for k in range(round(seconds * 1e9 / period_ns)):
        due_ns = start_ns + k * period_ns
        while (wait_ns := due_ns - time.time_ns()) > 0:
            time.sleep(wait_ns * 1e-9)
        yield time.time_ns()


def _due(k: int, rate_hz: float, imu_hz: float) -> bool:
    return rate_hz > 0 and k % max(1, round(imu_hz / rate_hz)) == 0


def connected(endpoint: str, **settings: object) -> zenoh.Session:
    """A client's session; settings: of zenoh's configuration, "__" for "/"."""
    config = zenoh.Config()
    client: dict[str, object] = {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}
    for name, value in (client | {key.replace("__", "/"): value for key, value in settings.items()}).items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Those of every vehicle."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--imu-hz", type=float, default=400.0)
    parser.add_argument("--gnss-hz", type=float, default=5.0)
    parser.add_argument("--fix-hz", type=float, default=0.0, help="pose fixes from elsewhere")
    parser.add_argument("--fix-s", type=float, default=math.inf, help="until then")
    parser.add_argument("--pictures", type=Path, help="turn.mcap of benchmarks.service.images")
    parser.add_argument("--seed", type=int, default=1)
    return parser


def fly(vehicle: Vehicle, given: argparse.Namespace) -> None:
    """As the arguments say; at the end one JSON object on stdout."""
    turn = Turn(given.pictures) if given.pictures else None
    vehicle.fly(given.seconds, given.imu_hz, gnss_hz=given.gnss_hz, fix_hz=given.fix_hz, fix_s=given.fix_s, turn=turn)
    time.sleep(0.5)
    print(json.dumps(vehicle.report()))


def main() -> None:
    given = arguments(__doc__).parse_args()
    session, cameras = connected(given.connect), connected(given.connect)
    fly(Vehicle(session, given.seed, cameras), given)
    for opened in (session, cameras):
        opened.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
