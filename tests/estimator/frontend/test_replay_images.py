"""A log of images gives fixes; a log of fixes and images gives the same fixes again, bit for bit."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from estimator.config import ConfigError, load
from estimator.frontend.files import load_processor
from estimator.frontend.repeat import Counts
from estimator.frontend.replay_images import ImageReplay
from estimator.replay.replay import replay
from logs.store.reader import LogReader, Record
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder
from logs.wire.schemas import STORE
from models import so3
from models.messages import LandmarkFix
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND
from tests.estimator.sights import PLACE, SEEN_S, village, write_flight


def _again(source: Path, out: Path, config_file: Path) -> Counts:
    """Replay from images."""
    config = load(config_file)
    assert config.rig.file is not None
    assert config.map.landmarks is not None
    processor = load_processor(config_file.parent / config.rig.file, config_file.parent / config.map.landmarks, config.map.origin)
    images = ImageReplay(processor, config.vision, config.inputs.left_image, config.inputs.right_image, source)
    replay(source, out, config, processor=images)
    return images.counts


def _records(path: Path, *topics: str) -> list[Record]:
    with LogReader(path) as reader:
        return [record for record in reader if not topics or record.topic in topics]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_flight(tmp_path_factory.mktemp("sight"))


@pytest.fixture(scope="module")
def seen(flight: tuple[Path, Path]) -> Path:
    source, config = flight
    out = source.with_name("seen.mcap")
    counts = _again(source, out, config)
    assert (counts.asked, counts.missing, counts.same, counts.different) == (4, 0, 0, 0)
    assert counts.measured >= 3
    return out


def test_fixes_come_from_images_where_the_vehicle_is(seen: Path) -> None:
    fixes = [Decoder().decode(r.topic, r.schema, r.data, r.log_time_ns) for r in _records(seen, "/landfix/fix")]
    assert len(fixes) >= 3
    for fix in fixes:
        assert isinstance(fix, LandmarkFix)
        total = fix.covariance + (0.0 if fix.covariance_common is None else fix.covariance_common)
        off = np.subtract(fix.p_n, PLACE)
        assert np.linalg.norm(off) < 2.0
        assert off @ np.linalg.solve(total[:3, :3], off) < 21.1  # 99.99 % of three degrees of freedom
        assert (fix.t_ns - EPOCH_NS) / SECOND in SEEN_S
        assert fix.arrived_ns - fix.t_ns == pytest.approx(0.07 * SECOND)


def test_each_pair_has_its_request_and_its_report(seen: Path) -> None:
    for topic in ("/landfix/vision_request", "/landfix/vision"):
        assert len(_records(seen, topic)) == len(SEEN_S)


def test_viewers_get_the_landmarks_at_the_first_image_and_those_in_use(seen: Path) -> None:
    looks = _records(seen, "/landfix/vision", "/landfix/fix", "/landfix/landmarks")
    assert "/landfix/landmarks" in {r.topic for r in looks[1:3]}, "behind the first report and fix"
    sent = [r for r in looks if r.topic == "/landfix/landmarks"]
    assert 1 <= len(sent) <= 2, "four images within 1.5 s"
    fixes = [Decoder().decode(r.topic, r.schema, r.data, r.log_time_ns) for r in looks if r.topic == "/landfix/fix"]
    markers = STORE.deserialize_cdr(sent[0].data, sent[0].schema).markers  # type: ignore[attr-defined]
    green = {m.text for m in markers if m.text and m.color.g > m.color.r}
    assert green in [set(fix.landmarks) if isinstance(fix, LandmarkFix) else set() for fix in fixes] + [set()]
    assert len({m.text for m in markers if m.text}) > 5


def test_a_viewer_puts_landmarks_where_the_image_shows_them(seen: Path) -> None:
    """Transforms and cameras as rosbags reads them from the log, against our own projection; the vehicle is level, nose north."""
    said: dict[str, Any] = {}
    with AnyReader([seen]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic not in said:
                said[connection.topic] = reader.deserialize(data, connection.msgtype)
    rig, mark = village().rig, village().map.near(*PLACE[:2], 50.0)[0]
    roof = np.array([*mark.centre_n, mark.roof_d])
    of_base_link = np.diag([1.0, -1.0, -1.0]) @ (roof - PLACE)
    cameras = [
        ("left", rig.left, rig.camera_pose(np.array(PLACE), np.eye(3))),
        ("right", rig.right, rig.right_camera_pose(np.array(PLACE), np.eye(3))),
    ]
    for transform, (side, camera, (p_nk, R_nk)) in zip(said["/tf_static"].transforms, cameras, strict=True):
        info, t, q = said[f"/landfix/{side}/camera_info"], transform.transform.translation, transform.transform.rotation
        assert (transform.header.frame_id, transform.child_frame_id, info.header.frame_id) == (
            "base_link",
            *2 * [f"{side}_camera"],
        )
        x_k = so3.matrix(np.array([q.w, q.x, q.y, q.z])).T @ (of_base_link - [t.x, t.y, t.z])
        seen_by_viewer = cv2.projectPoints(x_k, np.zeros(3), np.zeros(3), info.k.reshape(3, 3), info.d)[0].ravel()
        assert np.allclose(seen_by_viewer, camera.project(((roof - p_nk) @ R_nk)[None])[0], atol=1e-6)
        assert (info.width, info.height) == (camera.width, camera.height)
        assert np.allclose(info.p.reshape(3, 4)[:, :3], info.k.reshape(3, 3))


def test_the_same_again_to_the_bit(seen: Path, flight: tuple[Path, Path], tmp_path: Path) -> None:
    counts = _again(seen, tmp_path / "again.mcap", flight[1])
    assert counts.same == counts.measured >= 3
    assert (counts.different, counts.missing) == (0, 0)
    assert (tmp_path / "again.mcap").read_bytes() == seen.read_bytes()


def test_a_replay_from_fixes_gives_the_same_too(seen: Path, flight: tuple[Path, Path], tmp_path: Path) -> None:
    replay(seen, tmp_path / "fixes.mcap", load(flight[1]))
    assert (tmp_path / "fixes.mcap").read_bytes() == seen.read_bytes()


def test_a_fix_that_is_not_what_the_images_show_is_found_out(seen: Path, flight: tuple[Path, Path], tmp_path: Path) -> None:
    forged, first = tmp_path / "forged.mcap", _records(seen, "/landfix/fix")[0]
    with Recorder(forged) as recorder:
        for r in _records(seen):
            data = r.data[:-8] + bytes([r.data[-8] ^ 1]) + r.data[-7:] if r.data == first.data else r.data
            recorder.write(r.topic, r.schema, data, r.log_time_ns)
    counts = _again(forged, tmp_path / "again.mcap", flight[1])
    assert (counts.same, counts.different) == (counts.measured - 1, 1)


def test_images_that_are_not_in_the_log_are_counted(seen: Path, flight: tuple[Path, Path], tmp_path: Path) -> None:
    less = tmp_path / "less.mcap"
    lost = _records(seen, "/right/image")[1]
    with Recorder(less) as recorder:
        for r in _records(seen):
            if (r.topic, r.data) != (lost.topic, lost.data):
                recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
    assert _again(less, tmp_path / "again.mcap", flight[1]).missing == 1


def test_broken_images_give_a_reason_and_no_fix(flight: tuple[Path, Path], tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    with Recorder(broken) as recorder:
        for r in _records(flight[0]):
            data = r.data[: len(r.data) // 3] if "image" in r.topic else r.data
            recorder.write(r.topic, r.schema, data, r.log_time_ns)
    counts = _again(broken, tmp_path / "out.mcap", flight[1])
    assert (counts.asked, counts.measured) == (len(SEEN_S), 0)
    assert len(_records(tmp_path / "out.mcap", "/landfix/vision")) == len(SEEN_S)


def test_files_that_are_not_there_are_named(tmp_path: Path, flight: tuple[Path, Path]) -> None:
    rig, landmarks = flight[0].with_name("rig.yaml"), flight[0].with_name("map.geojson")
    with pytest.raises(ConfigError, match="nowhere"):
        load_processor(rig, tmp_path / "nowhere.geojson", None)
    with pytest.raises(ConfigError, match="nowhere"):
        load_processor(tmp_path / "nowhere.yaml", landmarks, None)
