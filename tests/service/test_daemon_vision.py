"""Pictures through the whole daemon: its vision answers, and the log says the same again, from pictures and from fixes."""

import time
from pathlib import Path

import numpy as np
import pytest

from estimator.config import Config, load
from estimator.replay import replay
from estimator.sight_files import load_sight
from estimator.sight_replay import PictureTally, SightReplay
from logs.codec import decode_odometry
from logs.reader import LogReader
from logs.stamps import restamped
from models.messages import ImuSample
from tests.estimator.scenes import SECOND, pose_fix
from tests.estimator.sights import PLACE, village, write_flight
from tests.service.flying import in_thread, logs_of, until

ALIGNED_S, LAST_S = 4.0, 14.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """At rest above the village, in real time: fixes from outside for a while, then pictures alone. Log, configuration."""
    folder = tmp_path_factory.mktemp("flown")
    _, config_file = write_flight(folder)
    text = config_file.read_text()
    config_file.write_text(f'{text}\n[zenoh]\nenabled = false\n[log]\nfolder = "{folder}/logs"\n')
    config = load(config_file)
    with in_thread(config, folder) as daemon:
        clock, mailbox = daemon._clock, daemon.mailbox
        began_ns = next_fix_ns = next_picture_ns = clock.now_ns()
        while (now_ns := clock.now_ns()) - began_ns < LAST_S * SECOND:
            mailbox.put(ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
            if now_ns >= next_fix_ns and now_ns - began_ns < ALIGNED_S * SECOND:
                mailbox.put(pose_fix(now_ns, PLACE))
                next_fix_ns += SECOND // 2
            if now_ns >= next_picture_ns:
                for picture in village().pairs[0]:
                    mailbox.put_bytes(picture.topic, picture.schema, restamped(picture.data, now_ns))
                next_picture_ns += SECOND // 2
            time.sleep(0.01)
        until(lambda: len(mailbox) == 0, "all is handled")
    (log,) = logs_of(folder)
    return log, config_file


def _records(path: Path, topic: str) -> list[tuple[int, bytes]]:
    with LogReader(path) as reader:
        return [(r.log_time_ns, r.data) for r in reader if r.topic == topic]


def _again(log: Path, out: Path, config_file: Path, config: Config) -> PictureTally:
    assert config.rig.file is not None
    assert config.map.landmarks is not None
    sight = load_sight(config_file.parent / config.rig.file, config_file.parent / config.map.landmarks, config.map.origin)
    pictures = SightReplay(sight, config.vision, config.inputs.left_image, config.inputs.right_image, log)
    replay(log, out, config, sight=pictures)
    return pictures.tally


def test_pictures_carry_the_estimate(flown: tuple[Path, Path]) -> None:
    log, _ = flown
    fixes = _records(log, "/landfix/fix")
    assert len(fixes) >= 3
    assert len(_records(log, "/landfix/vision")) >= len(fixes)
    last = decode_odometry(_records(log, "/landfix/odometry")[-1][1])
    assert np.linalg.norm(np.subtract(last.p_n, PLACE)) < 1.5


def test_its_log_replayed_from_pictures_gives_the_same_fixes_and_estimates(flown: tuple[Path, Path], tmp_path: Path) -> None:
    log, config_file = flown
    config = load(config_file)
    tally = _again(log, tmp_path / "again.mcap", config_file, config)
    assert tally.same >= 3
    assert (tally.different, tally.missing) == (0, 0)
    for topic in ("/landfix/fix", "/landfix/vision", "/landfix/odometry"):
        assert _records(tmp_path / "again.mcap", topic) == _records(log, topic)


def test_its_log_replayed_from_fixes_gives_the_same_estimates(flown: tuple[Path, Path], tmp_path: Path) -> None:
    log, config_file = flown
    replay(log, tmp_path / "again.mcap", load(config_file))
    assert _records(tmp_path / "again.mcap", "/landfix/odometry") == _records(log, "/landfix/odometry")
