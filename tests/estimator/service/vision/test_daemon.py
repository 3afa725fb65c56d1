"""Images through the whole daemon: its vision answers, is killed, answers again; and the log says the same again."""

import multiprocessing
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from estimator.config import Config, load
from estimator.frontend.files import load_processor
from estimator.frontend.repeat import Counts
from estimator.frontend.replay_images import ImageReplay
from estimator.replay.replay import replay
from estimator.service.daemon import Daemon
from logs.store.reader import LogReader
from logs.wire.codec import decode_odometry, decode_vision_request
from logs.wire.stamps import restamped, stamp_of
from models.messages import ImuSample
from tests.estimator.scenes import SECOND, pose_fix
from tests.estimator.service.flying import assert_sound, in_thread, logs_of, until
from tests.estimator.sights import PLACE, village, write_flight

FIXES = 3  # before vision is killed, and after
PATIENT = "[vision]\ntimeout_s = 60.0\n"  # a busy machine is no hang
_PATIENCE_S = 300.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, int]:
    """At rest above the village, in real time, aligned by fixes from outside, then with images alone.

    Vision is killed on the way. Log, configuration, when it was killed.
    """
    folder = tmp_path_factory.mktemp("flown")
    _, config_file = write_flight(folder)
    text = config_file.read_text()
    config_file.write_text(f'{text}\n[zenoh]\nenabled = false\n[log]\nfolder = "{folder}/logs"\nleast_free_mb = 0.0\n{PATIENT}')
    config = load(config_file)
    with in_thread(config, folder) as daemon:
        _hover(daemon, _fixes_of(daemon, FIXES), aligning=True)
        (vision,) = [p for p in multiprocessing.active_children() if p.name == "landfix-vision"]
        vision.kill()
        killed_ns = daemon._clock.now_ns()
        _hover(daemon, _fixes_of(daemon, 2 * FIXES))
        until(lambda: len(daemon.mailbox) == 0, "all is handled")
    (log,) = logs_of(folder)
    return log, config_file, killed_ns


def _fixes_of(daemon: Daemon, count: int) -> Callable[[], bool]:
    """Whether vision has made so many."""
    return lambda: daemon.mailbox.see.__self__.report()["fixes"] >= count  # type: ignore[attr-defined]


def _hover(daemon: Daemon, enough: Callable[[], bool], aligning: bool = False) -> None:
    """IMU and a pair of images twice a second until it is enough; aligning: fixes from outside until vision sees."""
    clock, mailbox = daemon._clock, daemon.mailbox
    began_ns = next_fix_ns = next_image_ns = clock.now_ns()
    while not enough():
        now_ns = clock.now_ns()
        assert now_ns - began_ns < _PATIENCE_S * SECOND, "vision makes no fixes"
        mailbox.put(ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
        if aligning and now_ns >= next_fix_ns and not _fixes_of(daemon, 1)():
            mailbox.put(pose_fix(now_ns, PLACE))
            next_fix_ns += SECOND // 2
        if now_ns >= next_image_ns:
            for image in village().pairs[0]:
                mailbox.put_bytes(image.topic, image.schema, restamped(image.data, now_ns))
            next_image_ns += SECOND // 2
        time.sleep(0.01)


def _records(path: Path, topic: str) -> list[tuple[int, bytes]]:
    with LogReader(path) as reader:
        return [(r.log_time_ns, r.data) for r in reader if r.topic == topic]


def _again(log: Path, out: Path, config_file: Path, config: Config) -> Counts:
    assert config.rig.file is not None
    assert config.map.landmarks is not None
    processor = load_processor(config_file.parent / config.rig.file, config_file.parent / config.map.landmarks, config.map.origin)
    images = ImageReplay(processor, config.vision, config.inputs.left_image, config.inputs.right_image, log)
    replay(log, out, config, processor=images)
    return images.counts


@pytest.mark.long
def test_images_carry_the_estimate_past_the_death_of_vision(flown: tuple[Path, Path, int]) -> None:
    log, _, killed_ns = flown
    fixes = [stamp_of(data) or 0 for _, data in _records(log, "/landfix/fix")]
    assert sum(t < killed_ns for t in fixes) >= FIXES
    assert sum(t > killed_ns for t in fixes) >= FIXES
    assert len(_records(log, "/landfix/vision")) >= len(fixes)
    runs = [decode_vision_request(data, 0).run for _, data in _records(log, "/landfix/vision_request")]
    assert (runs[0], runs[-1]) == (0, 1)
    last = decode_odometry(_records(log, "/landfix/odometry")[-1][1])
    assert np.linalg.norm(np.subtract(last.p_n, PLACE)) < 1.5


@pytest.mark.long
def test_each_sample_has_its_estimate_and_nothing_is_lost_meanwhile(flown: tuple[Path, Path, int]) -> None:
    log, _, killed_ns = flown
    samples = [stamp_of(data) or 0 for _, data in _records(log, "/imu")]
    heard = [stamp_of(data) or 0 for _, data in _records(log, "/landfix/odometry")]
    assert heard[0] < killed_ns < heard[-1]
    assert set(heard) >= {t for t in samples if t > heard[0]}
    assert all(a < b for a, b in pairwise(heard))
    assert_sound(log)


@pytest.mark.long
def test_its_log_replayed_from_images_gives_the_same_fixes_and_estimates(flown: tuple[Path, Path, int], tmp_path: Path) -> None:
    log, config_file, _ = flown
    config = load(config_file)
    counts = _again(log, tmp_path / "again.mcap", config_file, config)
    assert counts.same >= 2 * FIXES
    assert (counts.different, counts.missing) == (0, 0)
    for topic in ("/landfix/fix", "/landfix/vision", "/landfix/odometry"):
        assert _records(tmp_path / "again.mcap", topic) == _records(log, topic)


@pytest.mark.long
def test_its_log_replayed_from_fixes_gives_the_same_estimates(flown: tuple[Path, Path, int], tmp_path: Path) -> None:
    log, config_file, _ = flown
    replay(log, tmp_path / "again.mcap", load(config_file))
    assert _records(tmp_path / "again.mcap", "/landfix/odometry") == _records(log, "/landfix/odometry")
