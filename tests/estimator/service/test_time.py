"""Clocks that step, are never set, or begin anew, seen through the whole daemon: driven message by message, so no time passes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.service.vehicle import gnss, imu, pose_fix, truth
from estimator.config import parse
from estimator.service.base.clock import Clock
from estimator.service.base.ports import Arrival
from estimator.service.daemon import REFUSED_PREFIX, Daemon
from estimator.service.run import assembled
from logs.wire.codec import encode_input
from logs.wire.stamps import restamped
from models.messages import Input
from tests import long
from tests.estimator.service.flying import assert_replay_says_the_same, assert_sound, logs_of, odometry, records, toml

SECOND = 1_000_000_000
MS = 1_000_000
HOUR = 3600 * SECOND
START_NS = 1_795_000_000 * SECOND


@dataclass
class World:
    """True time, and the clocks of those who stamp: ours on the wall, and the autopilot's since its boot."""

    now_ns: int = 0
    wall_step_ns: int = 0
    booted_ns: int = -500 * SECOND
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(5))

    def wall(self) -> int:
        return START_NS + self.now_ns + self.wall_step_ns

    def steady(self) -> int:
        return self.now_ns


@contextmanager
def _daemon(world: World, folder: Path) -> Iterator[tuple[Daemon, str]]:
    text = toml(folder, 1, zenoh_keys="enabled = false")
    with assembled(parse(text), folder, clock=Clock(wall=world.wall, steady=world.steady)) as daemon:
        yield daemon, text


def _fly(world: World, daemon: Daemon, seconds: float, stamp_ns: str = "wall") -> None:
    """IMU at 200 Hz, GNSS and fixes at 5 Hz, 2 ms and 80 ms on their way."""
    for k in range(round(seconds * 200)):
        world.now_ns += 5 * MS
        true_ns = START_NS + world.now_ns - 2 * MS
        messages: list[tuple[int, Input]] = [(2 * MS, imu(true_ns, world.rng))]
        if k % 40 == 0:
            late_ns = true_ns - 78 * MS
            messages += [(80 * MS, m) for m in (*gnss(late_ns, world.rng), pose_fix(late_ns, world.rng))]
        for age_ns, message in messages:
            theirs = world.wall() if stamp_ns == "wall" else world.now_ns - world.booted_ns
            topic, schema, data = encode_input(message)
            arrived_ns = START_NS + world.now_ns
            daemon.take(Arrival(topic, schema, restamped(data, theirs - age_ns), arrived_ns))


def _assert_flown(log: Path, seconds: float) -> None:
    """One estimate for each sample, none missing in between, and all of them right."""
    estimates = odometry(log)
    stamps = np.array([e.t_ns for e in estimates], dtype=np.int64)
    assert np.diff(stamps).max() < 6 * MS
    assert (stamps[-1] - stamps[0]) * 1e-9 > seconds
    errors = np.linalg.norm([np.subtract(e.p_n, truth(e.t_ns)[0]) for e in estimates[200:]], axis=1)
    assert 0.005 < errors.mean() < 0.4


@long.parametrize("step_ns", [HOUR, -HOUR, SECOND // 2, -SECOND // 2])
def test_a_wall_clock_that_steps_is_not_noticed(tmp_path: Path, step_ns: int) -> None:
    world = World()
    with _daemon(world, tmp_path) as (daemon, text):
        _fly(world, daemon, 3.0)
        world.wall_step_ns = step_ns
        _fly(world, daemon, 3.0)
        world.wall_step_ns = 0
        _fly(world, daemon, 2.0)
    (log,) = logs_of(tmp_path)
    assert [r for r in records(log) if r.topic.startswith(REFUSED_PREFIX)] == []
    _assert_flown(log, 6.9)  # of eight: the first second is levelled
    assert_sound(log)
    assert_replay_says_the_same(log, text)


def test_sensors_that_count_from_their_boot_are_understood_and_again_after_a_reboot(tmp_path: Path) -> None:
    world = World()
    with _daemon(world, tmp_path) as (daemon, text):
        _fly(world, daemon, 3.0, "boot")
        before_ns = START_NS + world.now_ns
        world.booted_ns = world.now_ns - 7 * SECOND
        _fly(world, daemon, 3.0, "boot")
    (log,) = logs_of(tmp_path)
    refused = [r.log_time_ns for r in records(log) if r.topic.startswith(REFUSED_PREFIX)]
    assert max(t for t in refused if t <= before_ns) - min(refused) < SECOND
    assert max(refused) - before_ns < SECOND
    estimates = odometry(log)
    late = [e for e in estimates if e.t_ns > before_ns + SECOND]
    errors = np.linalg.norm([np.subtract(e.p_n, truth(e.t_ns)[0]) for e in late], axis=1)
    assert len(late) > 350
    assert errors.mean() < 0.5
    assert_sound(log)
    assert_replay_says_the_same(log, text)
