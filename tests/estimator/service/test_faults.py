"""What may happen to the links of a vehicle in the air, through the whole daemon.

The estimate goes on or comes back, what was sent is in the log, no estimate is ever not a number, and a replay says the same.
"""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zenoh
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.service.vehicle import Vehicle
from estimator.config import parse
from estimator.service.daemon import Daemon
from estimator.service.mavlink.link import MavlinkLink
from estimator.service.zenoh.bus import ZenohBus
from logs.wire import schemas
from logs.wire.codec import Encoded, Odometry
from logs.wire.stamps import stamp_of
from models.messages import Estimate, Mode, Output
from tests.estimator.service.autopilots import PX4, Autopilot, Flight, SerialAutopilot, UdpAutopilot
from tests.estimator.service.flying import (
    ODOMETRY,
    assert_replay_says_the_same,
    assert_sound,
    client,
    environment,
    errors_in_sigma,
    fly,
    free_port,
    in_thread,
    logs_of,
    odometry,
    records,
    toml,
    until,
)

SECOND = 1_000_000_000
BELIEVED_AT = 5  # stamps of a new clock in a row: docs/mavlink.md


class Ears:
    """An Outbox that remembers the newest estimate."""

    def __init__(self) -> None:
        self.newest: Estimate | None = None

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:  # noqa: ARG002  (an Outbox is given both)
        self.newest = next((o for o in reversed(outputs) if isinstance(o, Estimate)), self.newest)

    def close(self) -> None:
        pass

    def hears(self, mode: Mode, after_ns: int = 0) -> bool:
        return self.newest is not None and self.newest.mode is mode and self.newest.t_ns > after_ns


@contextmanager
def _over_mavlink(folder: Path, endpoint: str) -> Iterator[tuple[Daemon, MavlinkLink, Ears, str]]:
    more = f'[mavlink]\nendpoint = "{endpoint}"\nattitude_sigma_deg = [1.0, 3.0]\n[inputs]\nattitude = "/attitude"\n'
    text, ears = toml(folder, 1, more=more, zenoh_keys="enabled = false"), Ears()
    with in_thread(parse(text), folder) as daemon:
        assert isinstance(daemon._outboxes, list)
        (link,) = daemon._outboxes
        daemon._outboxes.append(ears)
        yield daemon, link, ears, text
        until(lambda: len(daemon.mailbox) == 0, "all is handled")


NEEDED = {105.0, 24.0, 30.0, 2.0}  # IMU, GNSS, attitude, system time; a coarse IMU where a busy machine makes the first one late


def _asked(autopilot: Autopilot) -> set[float]:
    """The messages that were asked for."""
    return {m.param1 for m in autopilot.of("COMMAND_LONG")}


def _in_step(autopilot: Autopilot, link: MavlinkLink) -> None:
    autopilot.until(lambda: link.report()["timesync_answers"] >= 3, "clocks are in step")


def _assert_consistent(log: Path, text: str) -> list[Odometry]:
    """All of the flight is within five of its own sigmas, dead reckoning and coasting included; its estimates."""
    estimates = odometry(log)
    assert errors_in_sigma(estimates).max() < 5.0
    assert_sound(log)
    assert_replay_says_the_same(log, text)
    return estimates


def test_an_autopilot_that_reboots_is_understood_from_its_fifth_message_on(tmp_path: Path) -> None:
    with (
        closing(UdpAutopilot()) as autopilot,
        _over_mavlink(tmp_path, f"udpout:127.0.0.1:{autopilot.port}") as (daemon, link, ears, text),
    ):
        _in_step(autopilot, link)
        flight = Flight(autopilot, daemon, np.random.default_rng(3))
        flight.until(lambda: ears.hears(Mode.AIDED), "it flies")
        autopilot.listen(0.5)  # it boots, and says nothing
        autopilot.booted_ns, booted_ns = time.monotonic_ns() - SECOND, daemon._clock.now_ns()
        assert _asked(autopilot) >= NEEDED
        autopilot.heard.clear()
        flight.until(lambda: ears.hears(Mode.AIDED, booted_ns), "it flies on")
        flight.until(lambda: _asked(autopilot) >= NEEDED, "all is asked for again")
        flight.until(lambda: autopilot.of("ODOMETRY"), "it is sent again")
        dropped, reboots = _dropped(link), link.report()["reboots"]
    (log,) = logs_of(tmp_path)
    assert reboots == 1
    assert len(records(log, "/imu")) >= flight.samples - (BELIEVED_AT - 1) - dropped
    assert _assert_consistent(log, text)[-1].t_ns > booted_ns


def test_while_a_serial_line_is_unplugged_the_estimate_coasts_and_then_it_is_aided_again(tmp_path: Path) -> None:
    device, autopilot = tmp_path / "ttyAutopilot", SerialAutopilot()
    device.symlink_to(autopilot.path)
    with _over_mavlink(tmp_path, str(device)) as (daemon, link, ears, text):
        _in_step(autopilot, link)
        flight = Flight(autopilot, daemon, np.random.default_rng(4))
        flight.until(lambda: ears.hears(Mode.AIDED), "it flies")
        autopilot.close()
        until(lambda: ears.hears(Mode.COASTING), "the estimate goes on without an IMU")
        assert link.report()["state"] != "open"
        again = SerialAutopilot()
        device.unlink()
        device.symlink_to(again.path)
        plugged_ns, again.booted_ns, flight.autopilot = daemon._clock.now_ns(), autopilot.booted_ns, again
        flight.until(lambda: ears.hears(Mode.AIDED, plugged_ns), "it flies on")
        again.close()
    (log,) = logs_of(tmp_path)
    assert len(records(log, "/imu")) >= flight.samples - 300  # but for what was said to a line that nobody had open
    _assert_consistent(log, text)


@pytest.mark.long
def test_during_a_flood_on_one_topic_estimates_stay_in_time_and_the_log_replays_to_the_same_bytes(tmp_path: Path) -> None:
    """As fast as a thread can put, for three seconds: each message is another one, so none is dropped as a repetition."""
    port = free_port()
    text = toml(tmp_path, port)
    with in_thread(parse(text), tmp_path) as daemon, client(port) as session:
        fly(session, 3.0)
        flooding = threading.Event()

        def flood() -> None:
            number = 0
            while not flooding.is_set():
                for _ in range(100):
                    daemon.mailbox.put_bytes("/gnss", schemas.NAV_SAT_FIX, number.to_bytes(8, "little"))
                    number += 1
                time.sleep(0.001)  # Python's lock is shared with the loop; messages from a network leave it more time

        thread = threading.Thread(target=flood)
        thread.start()
        during = fly(session, 3.0)
        flooding.set()
        thread.join()
        after = fly(session, 1.0)
        report = daemon.mailbox.report()
    (log,) = logs_of(tmp_path)
    assert report["dropped /gnss"] == report["lost_inputs"] > 10_000
    assert len(during.latency_ns) > 300
    assert max(during.latency_ns) < SECOND
    assert after.heard_ns >= after.flown_ns
    assert_replay_says_the_same(log, text)


@pytest.mark.long
def test_a_thousand_malformed_frames_a_second_cost_nothing(tmp_path: Path) -> None:
    with (
        closing(UdpAutopilot()) as autopilot,
        _over_mavlink(tmp_path, f"udpout:127.0.0.1:{autopilot.port}") as (daemon, link, ears, text),
    ):
        _in_step(autopilot, link)
        flight = Flight(autopilot, daemon, np.random.default_rng(5))
        flight.until(lambda: ears.hears(Mode.AIDED), "it flies")
        noise = threading.Thread(target=_make_noise, args=(autopilot,))
        noise.start()
        flight.until(lambda: not noise.is_alive(), "the noise is over")
        ended_ns = daemon._clock.now_ns()
        flight.until(lambda: ears.hears(Mode.AIDED, ended_ns), "it flies on")
        dropped, report = _dropped(link), link.report()
    (log,) = logs_of(tmp_path)
    assert report["damaged"] >= NOISE * 3 // 4 - dropped
    assert (report["defects"], report["implausible_stamps"]) == (0, 0)
    assert flight.samples + NOISE // 4 - dropped <= len(records(log, "/imu")) <= flight.samples + NOISE // 4
    stamps = [e.t_ns for e in _assert_consistent(log, text)]
    assert max(b - a for a, b in pairwise(stamps)) < SECOND  # the IMU was never taken for gone


NOISE = 3000  # in three seconds


def _make_noise(autopilot: UdpAutopilot) -> None:
    """Random bytes, a frame with a bit turned over, one that claims to be longer, and a whole one that says nonsense."""
    rng, codec = np.random.default_rng(7), mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    good, rest = bytes(mavlink.MAVLink_heartbeat_message(2, PX4, 0, 0, 4, 3).pack(codec)), (0, 0, 0, 0, 0, 0, 0, 63)
    began = time.monotonic()
    for k in range(NOISE):
        time.sleep(max(0.0, began + 1e-3 * k - time.monotonic()))
        turned = bytearray(good)
        turned[int(rng.integers(len(turned)))] ^= 1 << int(rng.integers(8))
        nan = mavlink.MAVLink_highres_imu_message(autopilot.boot_us(), *[np.nan] * 3, *[np.inf] * 3, *rest)
        frames = rng.bytes(60), bytes(turned), b"\xfd\xff" + rng.bytes(40), bytes(nan.pack(codec))
        autopilot.write(frames[k % 4])


def _dropped(link: MavlinkLink) -> int:
    """Datagrams for which the kernel had no room, because the machine let the link's thread wait."""
    port = link._endpoint.port  # type: ignore[attr-defined]
    rows = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
    (dropped,) = (int(row[-1]) for row in rows if int(row[1].partition(":")[2], 16) == port)
    return dropped


@pytest.mark.long
def test_a_subscriber_that_stands_still_delays_no_other_and_receives_again_when_it_continues(tmp_path: Path) -> None:
    """Before the flight more is sent than all buffers on the way to it hold. Waiting for it would take Zenoh's 5 s."""
    port, heard = free_port(), tmp_path / "heard"
    text = toml(tmp_path, port)
    code = (
        "import time; from pathlib import Path\n"
        "from benchmarks.service.vehicle import connected; from logs.wire.stamps import stamp_of\n"
        f"session, newest = connected('tcp/127.0.0.1:{port}'), [0]\n"
        "kept = session.declare_subscriber('**', lambda s: newest.append(stamp_of(s.payload.to_bytes()) or 0))\n"
        "while True: Path(r'" + str(heard) + "').write_text(str(newest[-1])); time.sleep(0.05)\n"
    )
    with (
        in_thread(parse(text), tmp_path) as daemon,
        subprocess.Popen([sys.executable, "-c", code], env=environment()) as slow,
    ):
        try:
            (bus,) = daemon._outboxes
            assert isinstance(bus, ZenohBus)
            until(lambda: heard.exists() and len(bus.session.info.transports()) == 1, "it listens")
            slow.send_signal(signal.SIGSTOP)
            for _ in range(15_000):
                bus.send((), [Encoded(ODOMETRY, schemas.ODOMETRY, bytes(3000))])  # larger ones would go by shared memory
            with client(port) as session:
                vehicle = fly(session, 2.0)
                slow.send_signal(signal.SIGCONT)

                def heard_again() -> bool:
                    fly(session, 0.5)
                    return int(heard.read_text() or 0) > vehicle.flown_ns

                until(heard_again, "it hears again")
        finally:
            slow.kill()
    (log,) = logs_of(tmp_path)
    assert max(vehicle.latency_ns) < 4 * SECOND
    assert len(vehicle.latency_ns) > 200
    _assert_goes_on(log)
    _assert_consistent(log, text)


@pytest.mark.long
def test_while_a_zenoh_router_is_restarted_the_flight_goes_on_and_who_listens_there_hears_again(tmp_path: Path) -> None:
    """The sensors are on this computer, the listener is behind the router; then sensors behind the router, too, are heard."""
    port, routed = free_port(), free_port()
    text = toml(tmp_path, port, zenoh_keys=f'connect = ["tcp/127.0.0.1:{routed}"]')
    router = _router(routed)
    with in_thread(parse(text), tmp_path) as daemon, client(port) as session, client(routed) as ground:
        heard: list[int] = []
        kept = ground.declare_subscriber("*/landfix/odometry/**", lambda s: heard.append(stamp_of(s.payload.to_bytes()) or 0))
        vehicle, landed = Vehicle(session, seed=1), threading.Event()

        def flight() -> None:
            while not landed.is_set():
                vehicle.fly(1.0, 200.0, gnss_hz=5.0, fix_hz=5.0)

        pilot = threading.Thread(target=flight)
        pilot.start()
        try:
            until(lambda: len(heard) > 100, "the ground hears")
            router.close()  # type: ignore[no-untyped-call]
            flown_ns = vehicle.heard_ns
            until(lambda: vehicle.heard_ns > flown_ns + SECOND // 2, "it flies on without")
            router, before = _router(routed), len(heard)
            until(lambda: len(heard) > before + 100, "the ground hears again")
        finally:
            landed.set()
            pilot.join()
        with client(routed) as sensors:
            until(lambda: len(fly(sensors, 0.5).latency_ns) > 50, "sensors behind the router are heard")
        until(lambda: len(daemon.mailbox) == 0, "all is handled")
        kept.undeclare()  # type: ignore[no-untyped-call]
    router.close()  # type: ignore[no-untyped-call]
    (log,) = logs_of(tmp_path)
    assert len(records(log, "/imu")) >= vehicle.sent["/imu"]
    _assert_goes_on(log)
    _assert_consistent(log, text)


def _assert_goes_on(log: Path) -> None:
    """Estimates follow each other within a second, and what the machine let the loop wait."""
    silence_ns = np.diff([r.log_time_ns for r in records(log)]).max()
    assert np.diff([e.t_ns for e in odometry(log)]).max() < SECOND + silence_ns


def _router(port: int) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {
        "mode": '"router"',
        "listen/endpoints": f'["tcp/127.0.0.1:{port}"]',
        "scouting/multicast/enabled": "false",
    }.items():
        config.insert_json5(key, value)
    return zenoh.open(config)
