"""Visual odometry from images in a log to increments, and the same again."""

from pathlib import Path

import numpy as np
import pytest

from estimator.config import Config, load
from estimator.frontend.files import load_odometry
from estimator.frontend.key_frames import KeyFrames, VisualOdometryConfig
from estimator.frontend.odometry import ODOMETRY_REPORT_TOPIC, OdometryProcessor
from estimator.frontend.repeat import Counts
from estimator.frontend.replay_odometry import OdometryReplay
from estimator.frontend.requests import Pair, Shot, Track
from estimator.replay.replay import replay
from logs.store.reader import LogReader, Record
from logs.wire.codec import Decoder, decode_odometry_request, encode
from logs.wire.images import encode_image
from models import so3
from models.messages import ODOMETRY_DELTA_TOPIC, Estimate, Mode, OdometryDelta, OdometryRequest
from models.state import E, X
from tests.estimator.sights import PLACE, write_flight
from tests.vision.odometry import scene

SECOND = 1_000_000_000
T0_NS, T1_NS = 10 * SECOND, 10 * SECOND + SECOND // 2


def _pair(k: int, t_ns: int) -> Pair:
    shots = []
    for topic, image in zip(("/left", "/right"), scene.pair(k), strict=True):
        _, schema, data = encode_image(t_ns, image, topic)
        shots.append(Shot(topic, schema, data, t_ns, t_ns, t_ns))
    return Pair(*shots)


def _track(speed: float, jump_m: float = 0.0) -> Track:
    """Level flight to the north at 100 Hz, turning right by 0.2 rad/s; the position jumps in the middle."""
    track = Track()
    for k in range(100):
        t_ns = T0_NS - SECOND // 5 + k * 10_000_000
        dt = (t_ns - T0_NS) * 1e-9
        nav = np.zeros(X.SIZE)
        nav[X.P] = (speed * dt + (jump_m if dt > 0.25 else 0.0), 0.0, -20.0)
        nav[X.V], nav[X.Q] = (speed, 0.0, 0.0), so3.from_euler(0.0, 0.0, 0.2 * dt)
        covariance = np.diag(np.full(E.SIZE, 1e-4))
        track.note([Estimate(t_ns, t_ns, nav, covariance, (0.0, 0.0, 0.2), Mode.AIDED, 0, t_ns)])
    return track


@pytest.mark.parametrize("jump_m", [0.0, 3.0])
def test_the_prediction_is_the_motion_between_the_pairs(jump_m: float) -> None:
    """A fix between the pairs moves the estimate by 3 m: no motion."""
    keys = KeyFrames(VisualOdometryConfig(ground_m=0.0, ground_sigma_m=1.0))
    first, second = Pair(Shot("/l", "", b"", T0_NS, T0_NS, 0), None), Pair(Shot("/l", "", b"", T1_NS, T1_NS, 0), None)
    track = _track(2.0, jump_m)
    assert keys.request(first, track, 0) is None
    asked = keys.request(second, track, T1_NS)
    assert asked is not None
    request, before = asked
    assert before is first
    np.testing.assert_allclose(request.dp_b, (1.0, 0.0, 0.0), atol=0.03)
    np.testing.assert_allclose(so3.quat_log(np.array(request.dq_wxyz)), (0.0, 0.0, 0.1), atol=1e-6)
    np.testing.assert_allclose(request.down_b, (0.0, 0.0, 1.0), atol=1e-9)
    assert request.height_m == pytest.approx(20.0, abs=0.1)
    assert request.height_sigma_m == pytest.approx(1.0, abs=0.01)
    assert np.linalg.eigvalsh(request.covariance)[0] > 0.0


def test_key_frames_follow_each_other() -> None:
    """Pairs at 10 Hz: a request each half second, from the later pair of the one before; none over a gap or back in time."""
    keys, track = KeyFrames(VisualOdometryConfig(longest_s=0.6)), _track(2.0)
    asked = []
    for tenth in (0, 1, 2, 3, 4, 5, 6, 7, 20):
        t_ns = T0_NS + tenth * SECOND // 10
        if request := keys.request(Pair(Shot("/l", "", b"", t_ns, t_ns, 0), None), track, t_ns):
            asked.append(request[0])
    assert [(r.t0_ns, r.t_ns) for r in asked] == [(T0_NS, T1_NS)]


def test_without_estimates_there_is_no_request() -> None:
    keys = KeyFrames(VisualOdometryConfig())
    for t_ns in (T0_NS, T1_NS):
        assert keys.request(Pair(Shot("/l", "", b"", t_ns, t_ns, 0), None), Track(), t_ns) is None


def _request() -> OdometryRequest:
    predicted = scene.prediction()
    first, second = _pair(0, T0_NS), _pair(1, T1_NS)
    assert first.left is not None
    assert first.right is not None
    assert second.left is not None
    assert second.right is not None
    w, x, y, z = predicted.q.tolist()
    a, b, c = predicted.p.tolist()
    return OdometryRequest(
        T1_NS, T1_NS, T0_NS, (a, b, c), (w, x, y, z), predicted.covariance, (first.left.name, first.right.name),
        (second.left.name, second.right.name), (0.0, 0.0, 1.0),
    )  # fmt: skip


def test_a_request_gives_an_increment_and_a_report() -> None:
    processor, decoder = OdometryProcessor(scene.RIG), Decoder()
    report, said = processor.process(_request(), _pair(0, T0_NS), _pair(1, T1_NS))
    delta = decoder.decode(*said, T1_NS)
    assert report.topic == ODOMETRY_REPORT_TOPIC
    assert isinstance(delta, OdometryDelta)
    assert (delta.t0_ns, delta.t_ns) == (T0_NS, T1_NS)
    assert delta.systematic is not None
    total = delta.covariance[:3, :3] + (delta.systematic @ delta.systematic.T)[:3, :3]
    off = delta.dp_b - scene.truth()[0]
    assert off @ np.linalg.solve(total, off) < 16.3
    assert OdometryProcessor(scene.RIG).process(_request(), _pair(0, T0_NS), _pair(1, T1_NS))[1].data == said.data  # no memory


def test_an_image_that_cannot_be_read_is_a_reason() -> None:
    torn = _pair(1, T1_NS)
    assert torn.left is not None
    (report,) = OdometryProcessor(scene.RIG).process(
        _request(), _pair(0, T0_NS), torn._replace(left=torn.left._replace(data=b"\0\1"))
    )
    assert report.topic == ODOMETRY_REPORT_TOPIC


def test_a_request_is_the_same_behind_the_wire() -> None:
    (message,) = encode(_request())
    (again,) = encode(decode_odometry_request(message.data, 0))
    assert again.data == message.data
    with pytest.raises(ValueError, match=r".+"):
        decode_odometry_request(message.data[:60], 0)


def _records(path: Path, topic: str) -> list[Record]:
    with LogReader(path) as reader:
        return [record for record in reader if record.topic == topic]


def _again(source: Path, out: Path, config: Config) -> Counts:
    assert config.rig.file is not None
    processor = load_odometry(source.parent / config.rig.file)
    topics = config.inputs.left_image, config.inputs.right_image
    again = OdometryReplay(processor, config.visual_odometry, config.vision, topics, source)
    replay(source, out, config, processor=again)
    return again.counts


def test_a_replay_of_the_images_gives_the_same_increments(tmp_path: Path) -> None:
    """A vehicle at rest, four pairs: three steps of nothing, fused; from their requests the same bytes again."""
    source, file = write_flight(tmp_path)
    file.write_text(file.read_text() + "[visual_odometry]\nenabled = true\nground_m = 0.0\n")
    config = load(file)
    counts = _again(source, tmp_path / "first.mcap", config)
    assert (counts.asked, counts.measured, counts.missing) == (3, 3, 0)
    deltas = [
        Decoder().decode(r.topic, r.schema, r.data, r.log_time_ns)
        for r in _records(tmp_path / "first.mcap", ODOMETRY_DELTA_TOPIC)
    ]
    for delta in deltas:
        assert isinstance(delta, OdometryDelta)
        assert np.linalg.norm(delta.dp_b) < 0.01 * -PLACE[2]
    counts = _again(tmp_path / "first.mcap", tmp_path / "second.mcap", config)
    assert (counts.asked, counts.same, counts.different) == (3, 3, 0)
    for topic in (ODOMETRY_DELTA_TOPIC, ODOMETRY_REPORT_TOPIC, "/landfix/odometry"):
        first, second = (_records(tmp_path / name, topic) for name in ("first.mcap", "second.mcap"))
        assert [r.data for r in first] == [r.data for r in second]
        assert first
