"""Vision in its own process: it answers, and when it is killed, hangs or cannot start, that is all that happens."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
import pytest

from estimator.frontend.requests import Track, VisionConfig
from estimator.service.base.clock import Clock, ClockConfig, Stamps
from estimator.service.base.ports import Arrival
from estimator.service.vision import worker as vision_worker
from estimator.service.vision.worker import VisionWorker
from logs.wire.codec import Encoded, decode_vision_request
from logs.wire.stamps import restamped
from models.messages import Estimate, Mode
from models.state import E, X
from tests.estimator.service.flying import environment
from tests.estimator.service.vision import slow_vision
from tests.estimator.sights import PLACE, village, write_flight

SIDES = {"/left/image": "left", "/right/image": "right"}
PATIENT = VisionConfig(timeout_s=60.0)  # a busy machine is no hang


class Heard:
    """What the worker sends."""

    def __init__(self) -> None:
        self.messages: list[Encoded] = []
        self._more = threading.Condition()

    def tell(self, message: Encoded) -> None:
        with self._more:
            self.messages.append(message)
            self._more.notify_all()

    def forget(self) -> None:
        self.messages.clear()

    def of(self, topic: str) -> list[Encoded]:
        return [m for m in self.messages if m.topic == topic]

    def wait(self, topic: str, count: int, timeout_s: float = 180.0) -> None:
        with self._more:
            assert self._more.wait_for(lambda: len(self.of(topic)) >= count, timeout_s), f"{topic}: {len(self.of(topic))}"


def _until(true: Callable[[], bool], timeout_s: float = 180.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.02)


Seeing = tuple[VisionWorker, Heard, Callable[[], None]]


@contextmanager
def _worker(files: Path, config: VisionConfig | None = None) -> Iterator[Seeing]:
    """A worker that is seeing, what it sends, and take(): two images are taken now."""
    clock, track, heard = Clock(), Track(), Heard()
    worker = VisionWorker(
        (files / "rig.yaml", files / "map.geojson", None, None), config or PATIENT, SIDES, clock,
        Stamps(clock, ClockConfig()), track, heard.tell,
    )  # fmt: skip

    def take() -> None:
        time.sleep(1.0 / PATIENT.most_hz)  # sooner after the last ones they would be passed over
        t_ns = clock.now_ns()
        nav = np.zeros(X.SIZE)
        nav[X.P], nav[X.Q] = PLACE, (1.0, 0.0, 0.0, 0.0)
        sigma = np.zeros(E.SIZE)
        sigma[E.P], sigma[E.V], sigma[E.THETA], sigma[E.BG], sigma[E.BA] = 0.2, 0.1, 0.01, 1e-3, 1e-2
        track.note([Estimate(t_ns, t_ns, nav, np.diag(sigma**2), (0.0, 0.0, 0.0), Mode.AIDED, 0, t_ns)])
        for image in village().pairs[0]:
            worker.put(Arrival(image.topic, image.schema, restamped(image.data, t_ns), clock.now_ns()))

    try:
        _until(lambda: worker.report()["state"] != "starting")
        yield worker, heard, take
    finally:
        worker.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vision")
    write_flight(folder)
    return folder


@pytest.fixture(scope="module")
def shared(files: Path) -> Iterator[Seeing]:
    """One worker for the tests that leave it seeing: its process takes seconds to start."""
    with _worker(files) as seeing:
        yield seeing


@pytest.fixture
def seeing(shared: Seeing) -> Seeing:
    """The shared worker at rest, what it sent before forgotten."""
    worker, heard, take = shared
    _until(lambda: worker.report()["state"] in {"ready", "seeing", "waiting for images"})
    heard.forget()
    return worker, heard, take


def _process_id(worker: VisionWorker) -> int:
    process = worker._process
    assert process is not None
    assert process.pid is not None
    return process.pid


def test_a_pair_gives_a_request_a_report_and_a_fix_in_this_order(seeing: Seeing) -> None:
    worker, heard, take = seeing
    take()
    heard.wait("/tf_static", 1)
    said = [m.topic for m in heard.messages]
    assert said == [
        "/landfix/vision_request", "/landfix/vision", "/landfix/fix", "/landfix/landmarks",
        "/landfix/left/camera_info", "/landfix/right/camera_info", "/tf_static",
    ]  # fmt: skip
    assert decode_vision_request(heard.messages[0].data, 0).run == worker.report()["restarts"]
    assert worker.report()["state"] == "seeing"


def test_when_it_is_killed_another_takes_over_with_a_new_memory(seeing: Seeing) -> None:
    worker, heard, take = seeing
    run = worker.report()["restarts"]
    take()
    heard.wait("/landfix/fix", 1)
    killed = _process_id(worker)
    os.kill(killed, signal.SIGKILL)
    _until(lambda: worker.report()["restarts"] == run + 1 and worker.report()["state"] == "ready")  # no image has to come first
    assert _process_id(worker) != killed
    take()
    heard.wait("/landfix/fix", 2)
    assert decode_vision_request(heard.of("/landfix/vision_request")[-1].data, 0).run == run + 1


def test_when_it_hangs_it_is_started_anew(files: Path) -> None:
    with _worker(files, VisionConfig(timeout_s=3.0)) as (worker, heard, take):
        take()
        heard.wait("/landfix/vision", 1)
        os.kill(_process_id(worker), signal.SIGSTOP)
        take()
        _until(lambda: worker.report()["restarts"] == 1 and worker.report()["state"] == "ready")
        take()
        heard.wait("/landfix/vision", 2)


def test_a_kernel_that_is_compiled_in_flight_comes_to_its_end_and_is_reported(
    files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vision_worker, "serve", slow_vision.compiles_once)
    with _worker(files, VisionConfig(timeout_s=3.0)) as (worker, heard, take):
        take()
        _until(lambda: "slow_vision" in worker.report()["compiling"])
        heard.wait("/landfix/vision", 1)
        said = worker.report()
        assert said["restarts"] == 0
        assert said["compiled_in_flight"] == 1
        assert said["compiled_in_flight_s"] > slow_vision.SECONDS - 1.0
        _until(lambda: worker.report()["state"] == "seeing" and not worker.report()["compiling"])


def test_a_compiler_that_hangs_is_ended_as_well(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vision_worker, "serve", slow_vision.hangs_in_the_compiler)
    monkeypatch.setattr(vision_worker, "_COMPILE_S", 4.0)
    with _worker(files, VisionConfig(timeout_s=3.0)) as (worker, heard, take):
        take()
        _until(lambda: worker.report()["restarts"] == 1 and worker.report()["state"] == "ready")
        assert heard.of("/landfix/vision") == []


def test_an_answer_between_two_failures_does_not_shorten_the_patience_again(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vision_worker, "serve", slow_vision.every_other_look_is_slow)
    with _worker(files, VisionConfig(timeout_s=3.0)) as (worker, heard, take):
        for answers in range(1, 6):  # one more is cut off: then the patience is twice as long
            before = worker.report()["restarts"]
            take()
            _until(lambda n=answers, r=before: len(heard.of("/landfix/vision")) >= n or worker.report()["restarts"] > r)  # type: ignore[misc]
            if worker.report()["restarts"] > before:
                _until(lambda: worker.report()["state"] == "ready")
                take()
                heard.wait("/landfix/vision", answers)
        assert worker.report()["restarts"] == 1


def test_a_malformed_answer_costs_one_restart_and_is_counted(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vision_worker, "serve", slow_vision.answers_with_a_pickle)
    with _worker(files) as (worker, heard, take):
        take()
        _until(lambda: worker.report()["restarts"] == 1 and worker.report()["state"] == "ready")
        assert worker.report()["malformed_answers"] == 1
        assert [m.topic for m in heard.messages] == ["/landfix/vision_request"]


def test_it_is_not_seeing_while_it_waits(seeing: Seeing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vision_worker, "_QUIET_NS", 300_000_000)
    worker, heard, take = seeing
    take()
    heard.wait("/landfix/vision", 1)
    _until(lambda: worker.report()["state"] == "waiting for images")
    os.kill(_process_id(worker), signal.SIGSTOP)
    take()
    _until(lambda: worker.report()["state"] == "waiting for an answer")
    os.kill(_process_id(worker), signal.SIGCONT)
    heard.wait("/landfix/vision", 2)


def test_a_map_that_is_not_there_is_said_and_tried_again_ever_more_rarely(files: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_bytes((files / "rig.yaml").read_bytes())
    with _worker(tmp_path) as (worker, heard, take):
        _until(lambda: worker.report()["restarts"] >= 2)
        take()
        assert "map.geojson" in worker.report()["state"]
        assert heard.messages == []


def test_more_images_than_it_can_see_are_dropped_the_oldest_first(seeing: Seeing) -> None:
    worker, heard, take = seeing
    take()
    heard.wait("/landfix/vision", 1)
    dropped = worker.report()["dropped_images"]
    os.kill(_process_id(worker), signal.SIGSTOP)
    for _ in range(20):
        take()
        time.sleep(0.01)
    os.kill(_process_id(worker), signal.SIGCONT)
    _until(lambda: worker.report()["dropped_images"] > dropped)
    last = max(decode_vision_request(m.data, 0).t_ns for m in heard.of("/landfix/vision_request"))
    take()
    _until(lambda: decode_vision_request(heard.of("/landfix/vision_request")[-1].data, 0).t_ns > last)


def test_without_an_estimate_nothing_is_asked(files: Path) -> None:
    clock, heard = Clock(), Heard()
    worker = VisionWorker(
        (files / "rig.yaml", files / "map.geojson", None, None), VisionConfig(), SIDES, clock, Stamps(clock, ClockConfig()),
        Track(), heard.tell,
    )  # fmt: skip
    try:
        _until(lambda: worker.report()["state"] == "ready")
        for image in village().pairs[0]:
            worker.put(Arrival(image.topic, image.schema, restamped(image.data, clock.now_ns()), clock.now_ns()))
        _until(lambda: worker.report()["state"] == "waiting for an estimate")
        assert heard.messages == []
    finally:
        worker.close()


def test_it_can_be_closed_while_its_process_is_being_born(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    born, start, before = threading.Event(), SpawnProcess.start, set(multiprocessing.active_children())

    def slow(process: SpawnProcess) -> None:
        born.set()
        time.sleep(0.5)
        start(process)

    monkeypatch.setattr(SpawnProcess, "start", slow)
    clock = Clock()
    worker = VisionWorker(
        (files / "rig.yaml", None, None, None), PATIENT, SIDES, clock, Stamps(clock, ClockConfig()), Track(), lambda _: None
    )
    assert born.wait(60.0)
    worker.close()
    assert worker._process is None
    assert set(multiprocessing.active_children()) <= before


def test_it_goes_behind_the_daemon_and_never_is_real_time() -> None:
    code = (
        "import os; from estimator.service.vision.worker import _give_way\n"
        "try: os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(5))\n"
        "except PermissionError: raise SystemExit('not allowed')\n"
        "_give_way(); print(os.sched_getscheduler(0) == os.SCHED_OTHER, os.nice(0))"
    )
    process = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=False)
    if process.stderr == "not allowed\n":
        pytest.skip("only root may ask for real time")
    assert process.stdout.split() == ["True", str(os.nice(0) + 5)]


def test_a_defect_on_the_way_is_said_and_costs_one_restart(seeing: Seeing) -> None:
    worker, heard, take = seeing
    restarts = worker.report()["restarts"]
    take()
    heard.wait("/landfix/fix", 1)
    tell, worker._tell = worker._tell, lambda _: 1 / 0  # type: ignore[assignment]
    take()
    _until(lambda: worker.report()["restarts"] == restarts + 1)
    assert worker.report()["state"] in {"ZeroDivisionError: division by zero", "ready"}
    worker._tell = tell
    _until(lambda: worker.report()["state"] == "ready")
    take()
    heard.wait("/landfix/fix", 2)


_STOPPED = """
import subprocess, sys
from estimator.service.vision.worker import VisionWorker
worker = VisionWorker.__new__(VisionWorker)
worker._process = process = subprocess.Popen(["sleep", "60"])
worker._killed_in(1.0)
print("waiting", flush=True)
sys.stdin.readline()
print("alive" if process.poll() is None else "dead", flush=True)
print("killed" if process.wait(20.0) < 0 else "ended by itself", flush=True)
"""


def test_the_time_in_which_the_daemon_is_stopped_does_not_count_as_vision_s_silence() -> None:
    with subprocess.Popen([sys.executable, "-c", _STOPPED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdin is not None
        assert daemon.stdout is not None
        assert daemon.stdout.readline() == "waiting\n"
        daemon.send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        daemon.stdin.write("\n")
        daemon.stdin.flush()
        daemon.send_signal(signal.SIGCONT)
        assert daemon.stdout.readline() == "alive\n"
        assert daemon.stdout.readline() == "killed\n"
