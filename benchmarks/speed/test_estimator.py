"""What the estimator costs, as ratios to the plain filter: both run in the same rounds, one after the other.

Nothing is asserted about time. `make bench` prints the table and keeps it in out/bench/. Times are of the processor, so that
other work on the machine counts less.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.flights.naive_filter import NaiveFilter
from benchmarks.speed import scripts
from benchmarks.speed import table as speed_table
from benchmarks.speed.flight import NOISE, PERIOD_NS, imu_samples, pose_fixes
from benchmarks.speed.scripts import Round
from benchmarks.speed.table import Result
from estimator.config import Config, load
from estimator.filter.eskf import Eskf
from estimator.filter.imu_buffer import ImuBuffer
from estimator.fusion import Fusion
from estimator.replay.replay import replay
from logs.store.recorder import Recorder
from logs.wire.codec import encode, encode_input
from models import imu
from models.messages import Input
from models.state import E, X

pytestmark = pytest.mark.benchmark(timer=time.process_time)

NAIVE_SAMPLES = 50  # of the plain filter before each round
CHECKPOINT_SAMPLES = 32


class Naive:
    """The plain filter in steady flight, a slice at a time."""

    def __init__(self) -> None:
        self._filter = NaiveFilter(NOISE)
        self._filter.handle(pose_fixes(1.0, 1.0)[0])
        self._samples = [s for s in imu_samples(300.0) if s.t_ns > PERIOD_NS]
        self._next = 0

    def seconds(self) -> float:
        """What an IMU sample took, over the next few."""
        begin = self._next
        self._next = (begin + NAIVE_SAMPLES) % (len(self._samples) - NAIVE_SAMPLES)
        chunk = self._samples[begin : begin + NAIVE_SAMPLES]
        start = time.process_time()
        for sample in chunk:
            self._filter.handle(sample)
        return (time.process_time() - start) / NAIVE_SAMPLES


@pytest.fixture(scope="session")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    path: Path = tmp_path_factory.mktemp("bench") / "vehicle.toml"
    path.write_text("[imu]\n" + "\n".join(f"{f} = {getattr(NOISE, f)}" for f in NOISE.__struct_fields__))
    loaded = load(path)
    feed(Fusion(loaded.fusion()), scripts.messages(12.0, 2.0))  # compiles, before anything is timed
    return loaded


def feed(fusion: Fusion, messages: list[Input]) -> None:
    for message in messages:
        fusion.handle(message)


def feed_and_encode(fusion: Fusion, messages: list[Input]) -> None:
    for message in messages:
        for output in fusion.handle(message):
            encode(output)


def feed_and_work_in(fusion: Fusion, messages: list[Input]) -> None:
    """What came late all at once, as where the IMU is missing; in flight it is spread over the samples that follow."""
    feed(fusion, messages)
    history = fusion._history
    while history.advance(history.samples.newest_ns, coast=True) is not history.tracker:  # a slice at a time
        pass


def measure(
    benchmark: BenchmarkFixture, prepare: Callable[[], tuple[object, ...]], work: Callable[..., object], rounds: int, units: int
) -> tuple[list[float], list[float]]:
    """Seconds per unit of work, and of the plain filter's IMU sample before it, in each round.

    The plain filter goes first: what is timed comes after what comes before it in flight, with the caches as that leaves them.
    """
    naive, naive_s = Naive(), []
    naive.seconds()

    def setup() -> tuple[tuple[object, ...], dict[str, object]]:
        naive_s.append(naive.seconds())
        return prepare(), {}

    benchmark.pedantic(work, setup=setup, rounds=rounds)  # type: ignore[no-untyped-call]
    assert benchmark.stats is not None
    return [s / units for s in benchmark.stats.stats.data], naive_s[-rounds:]


def measure_script(
    benchmark: BenchmarkFixture, config: Config, script: list[Round], units: int = 1, work: Callable[..., None] = feed
) -> tuple[list[float], list[float]]:
    """A Fusion through all rounds of a script."""
    fusion, rounds = Fusion(config.fusion()), iter(script)

    def prepare() -> tuple[object, ...]:
        before, timed = next(rounds)
        feed(fusion, before)
        return fusion, timed

    return measure(benchmark, prepare, work, len(script), units)


def test_batch(benchmark: BenchmarkFixture) -> None:
    samples, count = ImuBuffer(), 3200
    for sample in imu_samples((count + 1) / 200):
        samples.insert(sample)
    x = np.zeros(X.SIZE)
    x[X.Q] = 1.0, 0.0, 0.0, 0.0
    constants = imu.constants(NOISE, imu.Coast(), None)

    def prepare() -> tuple[Eskf]:
        return (Eskf(0, x.copy(), 0.01 * np.eye(E.SIZE), constants),)

    def work(eskf: Eskf) -> None:
        checkpoints = []
        for k in range(0, count, CHECKPOINT_SAMPLES):
            eskf.propagate(samples, k + 1, (k + CHECKPOINT_SAMPLES) * PERIOD_NS)
            checkpoints.append(eskf.copy())

    work(*prepare())
    seconds, naive_s = measure(benchmark, prepare, work, 100, count)
    speed_table.RESULTS.append(Result("IMU sample in a batch, checkpoints included", "sample", seconds, naive_s, 0.6))


def test_handle(benchmark: BenchmarkFixture, config: Config) -> None:
    script = scripts.imu_only(200)
    measured = measure_script(benchmark, config, script, len(script[0][1]))
    speed_table.RESULTS.append(Result("IMU sample through Fusion.handle", "sample", *measured))


def test_handle_without_output(benchmark: BenchmarkFixture, config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything but the making of estimate, reports and health."""
    monkeypatch.setattr(Fusion, "_publish", lambda *_: [])
    script = scripts.imu_only(200)
    measured = measure_script(benchmark, config, script, len(script[0][1]))
    speed_table.RESULTS.append(Result("the same, but for making the output", "sample", *measured, 5.0))


def test_handle_and_encode(benchmark: BenchmarkFixture, config: Config) -> None:
    script = scripts.imu_only(200)
    measured = measure_script(benchmark, config, script, len(script[0][1]), feed_and_encode)
    speed_table.RESULTS.append(Result("IMU sample through Fusion.handle, output encoded", "sample", *measured))


def test_punctual_fix(benchmark: BenchmarkFixture, config: Config) -> None:
    measured = measure_script(benchmark, config, scripts.late_fixes(100, 0.0, 2.0))
    speed_table.RESULTS.append(Result("pose fix, punctual, and the next IMU sample", "fix", *measured))


def test_naive_fix(benchmark: BenchmarkFixture) -> None:
    naive = NaiveFilter(NOISE)
    fixes = pose_fixes(100.0, 2.0)
    naive.handle(fixes[0])
    rest = iter(fixes[1:])
    measured = measure(benchmark, lambda: (next(rest),), naive.fuse_pose, 100, 1)
    speed_table.RESULTS.append(Result("pose fix in the plain filter (propagates to it once)", "fix", *measured))


@pytest.mark.parametrize(
    ("late_s", "rate_hz", "target_us"), [(0.3, 2.0, 200.0), (0.3, 30.0, None), (5.0, 2.0, 1500.0), (5.0, 30.0, 12000.0)]
)
def test_late_fix(benchmark: BenchmarkFixture, config: Config, late_s: float, rate_hz: float, target_us: float | None) -> None:
    measured = measure_script(benchmark, config, scripts.late_fixes(60, late_s, rate_hz), work=feed_and_work_in)
    name = f"fix {late_s} s late among {rate_hz:.0f} Hz fixes, and the next IMU sample"
    speed_table.RESULTS.append(Result(name, "fix", *measured, target_us))


def test_estimate_after_a_late_fix(benchmark: BenchmarkFixture, config: Config) -> None:
    measured = measure_script(benchmark, config, scripts.late_fixes(60, 5.0, 30.0))
    speed_table.RESULTS.append(Result("the same until the next estimate is out: the rest is done behind it", "fix", *measured))


def test_burst(benchmark: BenchmarkFixture, config: Config) -> None:
    """100 fixes at once against one: the target is twice what one took."""
    one = next(r for r in speed_table.RESULTS if r.name.startswith("fix 5.0 s late among 30 Hz"))
    measured = measure_script(benchmark, config, scripts.late_fixes(15, 5.0, 30.0, count=100, every_s=6.0), work=feed_and_work_in)
    target_us = 2.0 * one.ratio * speed_table.NAIVE_TARGET_US
    speed_table.RESULTS.append(Result("burst of 100 late fixes (30 Hz, up to 5 s late)", "burst", *measured, target_us))


def test_replay(benchmark: BenchmarkFixture, config: Config, tmp_path: Path) -> None:
    source, seconds = tmp_path / "flight.mcap", 60.0
    with Recorder(source, metadata={}) as recorder:
        for message in scripts.messages(seconds, 2.0):
            recorder.write(*encode_input(message), message.arrived_ns)
    replay(source, tmp_path / "out.mcap", config)
    measured = measure(benchmark, lambda: (source, tmp_path / "out.mcap", config), replay, 7, round(seconds))
    result = Result("replay, MCAP read and written (200 Hz)", "s of flight", *measured, 1e6 / 150.0, real_time=True)
    speed_table.RESULTS.append(result)
