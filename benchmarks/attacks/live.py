"""What is done to a daemon: to its state file before it starts; over Zenoh and MAVLink while a vehicle flies."""

import os
import signal
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from mmap import mmap
from pathlib import Path
from threading import Timer
from typing import Any, Final

import msgspec
import numpy as np
import zenoh
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.attacks import limited
from benchmarks.attacks.cell import Row
from benchmarks.service.autopilot import highres_imu
from benchmarks.service.vehicle import ORIGIN, Vehicle, connected, gnss, image, imu, pose_fix, truth
from estimator.service.log.state_file import SavedState, boot_id
from estimator.service.zenoh import keys
from logs.store.reader import LogReader
from logs.wire import schemas
from logs.wire.codec import Encoded, decode_odometry, encode_input, type_hash
from models.messages import ImuSample, Input

PORT, MAVLINK_PORT = 17461, 17462
_START_S, _FLOWN_S, _HZ = 120.0, 1.0, 100.0
_LATE_S, _OFF_M, _OFF_SIGMA, _SURE_M, _TRIES, _SETTLE_S = 0.5, 5.0, 5.0, 1.0, 3, 0.3
_RATE_HZ: Final = 100_000
_KILLS, _FLIGHT_S, _MOST_LOST_S, _OTHERS, _BURST = 10, 4.0, 0.1, 10, 3000


class Daemon:
    """A forked `landfix run` in a folder of its own; the parent must not have used Zenoh before."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        text = f'[map]\norigin = {[*ORIGIN.lla]}\n[zenoh]\nlisten = ["tcp/127.0.0.1:{PORT}"]\n[log]\nfolder = "logs"\n'
        (folder / "run.toml").write_text(f'{text}[mavlink]\nendpoint = "udpin:127.0.0.1:{MAVLINK_PORT}"\n')
        (folder / "logs").mkdir(exist_ok=True)

    def start(self) -> bool:
        """Whether it waits for samples within the time."""
        (self.folder / ".stderr").write_text("")
        self.pid = limited.forked(["run", "-c", "run.toml"], self.folder)
        end_s = time.monotonic() + _START_S
        while "waiting for: IMU" not in (self.folder / ".stderr").read_text():
            if time.monotonic() > end_s or not self.alive():
                return False
            time.sleep(0.05)
        return True

    def alive(self) -> bool:
        """Whether the process is still there."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None

    def stop(self) -> limited.Ended:
        """It is asked to end, and waited for."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)
        return limited.ended(self.pid, self.folder)


def flood(session: zenoh.Session, message: Encoded, seconds: float) -> None:
    """One message over and over, at most _RATE_HZ."""
    topic, schema, data = message
    publisher = session.declare_publisher(keys.rmw_key(0, topic, schema, type_hash(schema)))
    attachment, began, sent = keys.attachment(1, time.time_ns(), bytes(16)), time.monotonic(), 0
    while (elapsed := time.monotonic() - began) < seconds:
        for _ in range(min(200, max(0, round(elapsed * _RATE_HZ) - sent))):
            publisher.put(data, attachment=attachment)
            sent += 1
    publisher.undeclare()  # type: ignore[no-untyped-call]


def state_files(folder: Path) -> Iterator[Row]:
    """A state file of each kind: the daemon starts, says why in a line where it is none of its own, and ends when asked to."""
    for name, place in _STATES.items():
        there = folder / f"state {name}"
        there.mkdir()
        daemon = Daemon(there)
        place(there / "logs" / "landfix.state")
        listens = daemon.start()
        done = daemon.stop()
        said = [line for line in done.stderr.splitlines() if "landfix.state" in line]
        why = ""
        if not listens or done.code or done.signal:
            why = f"ended with {done.code}, signal {done.signal}"
        elif len(said) != (name not in _SILENT):
            why = f"{len(said)} lines on it"
        yield Row("state file", name, "failed" if why else "held", why, done.code, done.cpu_s, said[-1] if said else "")


def _packed(**changes: Any) -> Callable[[Path], object]:
    now_ns = time.time_ns()
    anchor_ns = now_ns - time.monotonic_ns()
    saved = SavedState(1, boot_id(), anchor_ns, now_ns - 10**9, "another configuration", b"no checkpoint")
    data = msgspec.msgpack.encode(msgspec.structs.replace(saved, **changes))
    return lambda path: path.write_bytes(data)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**36)


_SILENT: Final = frozenset({"absent", "of another configuration", "an old one"})
_STATES: Final[dict[str, Callable[[Path], object]]] = {
    "absent": lambda _: None,
    "empty": lambda path: path.write_bytes(b""),
    "noise": lambda path: path.write_bytes(os.urandom(5000)),
    "deep": lambda path: path.write_bytes(b"\x91" * 100_000),
    "64 GiB": _sparse,
    "a folder": lambda path: path.mkdir(),
    "a link": lambda path: path.symlink_to("/etc/passwd"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a pipe": os.mkfifo,
    "of another version": _packed(format=7),
    "of another configuration": _packed(),
    "an old one": _packed(boot="", t_ns=10**18),
    "of 2099": _packed(boot="", t_ns=4_070_908_800 * 10**9),
    "before 1970": _packed(boot="", t_ns=-1),
    "of 2^62 ns": _packed(t_ns=2**62),
    "with the clock of tomorrow": _packed(anchor_ns=time.time_ns() + 2 * 86_400 * 10**9),
    "from before the boot": _packed(t_ns=1_000_000_000_000),
}  # fmt: skip


def kills(folder: Path) -> Iterator[Row]:
    """SIGKILL in flight, ten times in one folder: what was sent and is not in the log, what was underway included.

    At every second one ten other processes compute as well, at the usual priority.
    """
    there = folder / "kills"
    there.mkdir()
    for k in range(_KILLS):
        daemon = Daemon(there)
        known = set((there / "logs").glob("*.mcap"))
        if not daemon.start():
            yield Row("kill -9", f"{k + 1}", "failed", "the daemon did not start", daemon.stop().code, 0.0, "")
            continue
        shared = mmap(-1, 16)
        others = [_computing() for _ in range(_OTHERS * (k % 2))]
        vehicle = _vehicle(shared)
        time.sleep(_FLIGHT_S)
        os.kill(daemon.pid, signal.SIGKILL)
        last_ns, busy_ns = struct.unpack("<qq", shared)
        for child in (vehicle, *others):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        limited.ended(daemon.pid, there)
        (log,) = set((there / "logs").glob("*.mcap")) - known
        with LogReader(log) as reader:
            logged_ns = max((r.log_time_ns for r in reader if r.topic == "/imu"), default=0)
        lost_s, busy_s = (last_ns - logged_ns) * 1e-9, busy_ns * 1e-9
        verdict = "held" if lost_s <= _MOST_LOST_S else "degraded" if lost_s <= _MOST_LOST_S + busy_s else "failed"
        why = f"{lost_s:.3f} s of the log lost, on a machine on which estimates came up to {busy_s:.3f} s late"
        name = f"{k + 1}, beside {len(others)} computations"
        yield Row("kill -9", name, verdict, why, 0, 0.0, f"{log.stat().st_size} bytes")


def _computing() -> int:
    """A process that does nothing else until it is killed, or we are."""
    ours = os.getpid()
    if child := os.fork():
        return child
    while os.getppid() == ours:
        pass
    os._exit(0)


def _vehicle(shared: mmap) -> int:
    """A process that flies until it is killed; shared: stamp of its last IMU sample, lateness of the last estimates [ns]."""
    if child := os.fork():
        return child
    with connected(f"tcp/127.0.0.1:{PORT}") as session:
        vehicle = Vehicle(session, seed=1)
        send = vehicle.measure

        def noted(message: Input) -> None:
            send(message)
            if isinstance(message, ImuSample):
                shared[:] = struct.pack("<qq", message.t_ns, max(vehicle.latency_ns[-50:], default=0))

        vehicle.measure = noted  # type: ignore[method-assign]
        vehicle.fly(10.0 * _FLIGHT_S, _HZ, gnss_hz=5.0, fix_hz=5.0)
    os._exit(0)


def messages(folder: Path) -> Iterator[Row]:
    """Hostile messages to one daemon, each followed by a second of flight, in which estimates must come, in time and right."""
    there = folder / "live"
    there.mkdir()
    daemon = Daemon(there)
    if not daemon.start():
        yield Row("zenoh", "start", "failed", "the daemon did not start", daemon.stop().code, 0.0, "")
        return
    with connected(f"tcp/127.0.0.1:{PORT}") as session, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.connect(("127.0.0.1", MAVLINK_PORT))
        witness = _Witness(session)
        witness.fly(3.0)
        for area, cells in (("zenoh", _over_zenoh(session)), ("mavlink", _over_mavlink(line))):
            for name, act in cells.items():
                with suppress(OSError):  # nobody may listen on the line
                    act()
                yield Row(area, name, *witness.judged(daemon))
        for name, act in _bursts(session).items():
            yield Row("burst", name, *witness.judged(daemon, act))
    done = daemon.stop()
    why = "" if done.code == 0 and "internal" not in done.stderr else f"ended with {done.code}: {done.stderr[-200:]}"
    lines, verdict = f"{len(done.stderr.splitlines())} lines on stderr", "failed" if why else "held"
    yield Row("zenoh", "it ends when asked to", verdict, why, done.code, done.cpu_s, lines)


class _Witness:
    """A vehicle, and what it hears of itself."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._heard = session, list[tuple[int, bytes]]()
        self._vehicle = Vehicle(session, seed=1)
        key = keys.rmw_key(0, "/landfix/odometry", schemas.ODOMETRY)
        self._subscriber = session.declare_subscriber(
            key, lambda sample: self._heard.append((time.time_ns(), sample.payload.to_bytes()))
        )

    def fly(self, seconds: float) -> None:
        """In real time, with GNSS and fixes."""
        self._vehicle.fly(seconds, _HZ, gnss_hz=5.0, fix_hz=5.0)
        time.sleep(0.2)

    def judged(self, daemon: Daemon, during: Callable[[], object] | None = None) -> tuple[str, str, int, float, str]:
        """Verdict, reason, code, CPU and what was measured, after a second of flight, or three on a busy machine.

        during: an attack in flight, where the latest estimate counts instead of the median.
        """
        time.sleep(_SETTLE_S)  # what the attacker sent under our key is heard too
        self._heard.clear()
        if during:
            Timer(0.3 * _FLOWN_S, during).start()
        self.fly(_FLOWN_S)
        tries = 1
        while len(self._heard) < 0.5 * _FLOWN_S * _HZ and tries < _TRIES:
            self.fly(_FLOWN_S)
            tries += 1
        heard = [(arrived_ns, decode_odometry(data)) for arrived_ns, data in self._heard]
        if not daemon.alive():
            return "failed", "the daemon has ended", 0, 0.0, ""
        if len(heard) < 0.5 * _FLOWN_S * _HZ:
            return "failed", f"{len(heard)} estimates in {_TRIES * _FLOWN_S:g} s", 0, 0.0, ""
        late = [1e-9 * (arrived_ns - e.t_ns) for arrived_ns, e in heard]
        late_s = max(late) if during else float(np.median(late))
        off_m = np.array([np.abs(np.subtract(e.p_n, truth(e.t_ns)[0])) for _, e in heard])
        sigma_m = np.array([np.sqrt(np.diag(e.pose_covariance)[:3]) for _, e in heard])
        said = f"at most {np.max(off_m):.2f} m off and {np.max(off_m / sigma_m):.1f} sigma, {late_s:.3f} s late"
        if np.any(off_m > np.maximum(_SURE_M, _OFF_SIGMA * sigma_m)):
            return "failed", f"wrong and sure: {said}", 0, 0.0, said
        if np.any(off_m > _OFF_M):
            return "degraded", f"far off, and says so: {said}", 0, 0.0, said
        if late_s > _LATE_S or tries > 1:
            return "degraded", f"{late_s:.2f} s late, {tries} s until they came", 0, 0.0, said
        return "held", "", 0, 0.0, said


def _bursts(session: zenoh.Session) -> dict[str, Callable[[], object]]:
    """3,000 malformed messages at once, in flight."""
    topics = {"/gnss": schemas.NAV_SAT_FIX, "/gnss/velocity": schemas.TWIST, "/pose_fix": schemas.POSE_FIX, "/imu": schemas.IMU}

    def burst(*names: str) -> Callable[[], object]:
        keyed = [keys.rmw_key(0, name, topics[name], type_hash(topics[name])) for name in names]
        return lambda: [session.put(key, os.urandom(20)) for _ in range(_BURST // len(keyed)) for key in keyed]

    return {f"{_BURST} malformed on {name}": burst(name) for name in topics} | {f"{_BURST} malformed on all": burst(*topics)}


def _over_zenoh(session: zenoh.Session) -> dict[str, Callable[[], object]]:
    rng = np.random.default_rng(1)
    now_ns = time.time_ns()
    whole = {m.topic: encode_input(m) for m in (imu(now_ns, rng), *gnss(now_ns, rng), pose_fix(now_ns, rng))}
    infinite = {topic: m._replace(data=m.data[:60] + struct.pack("<d", np.inf) * ((len(m.data) - 60) // 8))
                for topic, m in whole.items()}  # fmt: skip
    counted = {topic: m._replace(data=m.data[:12] + b"\xff" * 4 + m.data[16:]) for topic, m in whole.items()}
    late = [encode_input(pose_fix(now_ns + s * 10**9, rng)) for s in (-100_000, -20, -5, -1, 1, 20, 100_000)]
    jpeg = Encoded("/left/image", schemas.COMPRESSED_IMAGE, b"\0\1\0\0" + bytes(8) + b"\xff" * 4 + os.urandom(2000))

    def put(*encoded: Encoded, times: int = 20, key: str = "") -> Callable[[], object]:
        def act() -> None:
            for _ in range(times):
                for topic, schema, data in encoded:
                    session.put(key or keys.rmw_key(0, topic, schema, type_hash(schema)), data)

        return act

    return {
        **{f"{t}: {n} bytes": put(m._replace(data=m.data[:n])) for t, m in whole.items() for n in (0, 1, 4, 30)},
        **{f"{t}: infinite": put(m) for t, m in infinite.items()},
        **{f"{t}: a count of 2^32 - 1": put(m) for t, m in counted.items()},
        **{f"{t}: 60 kB of noise": put(m._replace(data=os.urandom(60_000))) for t, m in whole.items()},
        **{f"{t}: 300 kB": put(m._replace(data=m.data + bytes(300_000)), times=3) for t, m in whole.items()},
        "pose fixes of other times": put(*late),
        "an image of no size": put(image("/left/image", now_ns, b"")._replace(data=bytes(40))),
        "an image of noise": put(jpeg),
        "a state as an input": put(Encoded("/landfix/checkpoint", schemas.CHECKPOINT, bytes(500))),
        "a tick as an input": put(Encoded("/landfix/tick", schemas.HEADER, bytes(20))),
        "our own output": put(Encoded("/landfix/odometry", schemas.ODOMETRY, os.urandom(700))),
        "a key of a megabyte": put(whole["/imu"], times=1, key=f"0/imu/{'a' * 60_000}"),
        "a token of no ROS domain": lambda: session.liveliness().declare_token(f"@ros2_lv/x/{'9' * 99}/0/0/MP/%/%/a/%imu/a/b/c"),
        "queries of everything": lambda: [list(session.get("**", timeout=0.2)) for _ in range(5)],
        "a flood of empty IMU samples": lambda: flood(session, whole["/imu"]._replace(data=b""), 2.0),
        "a flood of one IMU sample": lambda: flood(session, whole["/imu"], 2.0),
    }


def _over_mavlink(line: socket.socket) -> dict[str, Callable[[], object]]:
    ours, other = (mavlink.MAVLink(None, srcSystem=s, srcComponent=1) for s in (1, 77))
    rng = np.random.default_rng(2)
    nan, far = float("nan"), 2**64 - 1
    sample = highres_imu(imu(time.time_ns(), rng), 1)
    whole: bytes = sample.pack(ours)

    def send(*datagrams: bytes, times: int = 20) -> Callable[[], object]:
        return lambda: [line.send(data) for _ in range(times) for data in datagrams]

    times = [(a, b) for a in (0, 2**62) for b in (0, -(2**62), 2**62)]
    pole = mavlink.MAVLink_gps_raw_int_message(5, 3, 2**31 - 1, -(2**31), 0, 0, 0, 0, 0, 0)
    orders = [mavlink.MAVLink_command_long_message(1, 197, n, 0, *[nan] * 7).pack(ours) for n in (176, 246, 511, 65535)]
    beats = [
        mavlink.MAVLink_heartbeat_message(2, kind, 0, 0, 4, 3).pack(link) for kind in (0, 3, 12, 255) for link in (ours, other)
    ]
    return {
        "nothing": send(b""),
        "noise": send(os.urandom(1500), times=200),
        "only the first byte": send(b"\xfd"),
        "half a frame": send(whole[: len(whole) // 2]),
        "a frame of a wrong checksum": send(whole[:-1] + bytes([whole[-1] ^ 1])),
        "a frame of version 1": send(sample.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)),
        "a frame that says it is signed": send(whole[:2] + b"\1" + whole[3:] + bytes(13)),
        "a frame of 255 bytes that has 20": send(b"\xfd\xff" + whole[2:20]),
        "frames of another vehicle": send(sample.pack(other)),
        "heartbeats of all kinds": send(*beats),
        "an IMU that is no number": send(mavlink.MAVLink_highres_imu_message(5, *[nan] * 13, 63).pack(ours)),
        "an IMU of 1e38": send(mavlink.MAVLink_highres_imu_message(5, *[1e38] * 13, 63).pack(ours)),
        "a clock of 2^64": send(mavlink.MAVLink_highres_imu_message(far, *[0.0] * 13, 63).pack(ours)),
        "times of no time": send(*(mavlink.MAVLink_timesync_message(a, b).pack(ours) for a, b in times)),
        "system times": send(*(mavlink.MAVLink_system_time_message(t, 2**32 - 1).pack(ours) for t in (0, 1, far))),
        "a receiver at the pole": send(pole.pack(ours)),
        "commands": send(*orders),
        "a flood of noise": lambda: [line.send(os.urandom(300)) for _ in range(10_000)],
        "a flood of whole frames of another vehicle": send(sample.pack(other), times=10_000),
    }  # fmt: skip
