"""/landfix/overlay over a real Zenoh session: drawn while somebody subscribes, and only then."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh

from estimator.config import Config, load
from estimator.publish import OVERLAY_TOPIC
from estimator.service.daemon import Daemon
from estimator.service.zenoh.keys import plain_key, rmw_key
from logs.wire import schemas
from logs.wire.cameras import LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC
from logs.wire.images import Pixels, decode_image
from logs.wire.stamps import restamped, stamp_of
from models.messages import ImuSample
from tests.estimator.scenes import SECOND, pose_fix
from tests.estimator.service.flying import client, free_port, in_thread, logs_of, records, status, until
from tests.estimator.sights import PLACE, village, write_flight

OVERLAY_HZ = 2.0
CAMERAS = {LEFT_TOPIC: schemas.CAMERA_INFO, RIGHT_TOPIC: schemas.CAMERA_INFO, STATIC_TOPIC: schemas.TF}


@contextmanager
def _hovering(daemon: Daemon) -> Iterator[None]:
    """At rest above the village, in real time, four pairs a second, as long as the context lasts."""
    landed = threading.Event()

    def fly() -> None:
        clock, mailbox = daemon._clock, daemon.mailbox
        next_ns = clock.now_ns()
        while not landed.wait(0.01):
            now_ns = clock.now_ns()
            mailbox.put(ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
            if now_ns >= next_ns:
                mailbox.put(pose_fix(now_ns, PLACE))
                for image in village().pairs[0]:
                    mailbox.put_bytes(image.topic, image.schema, restamped(image.data, now_ns))
                next_ns = now_ns + SECOND // 4

    pilot = threading.Thread(target=fly)
    pilot.start()
    try:
        yield
    finally:
        landed.set()
        pilot.join()


def _configuration(folder: Path, port: int, output: str = "") -> Config:
    _, file = write_flight(folder)
    file.write_text(
        f'{file.read_text()}\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\nros2dds = true\n'
        f'[log]\nfolder = "{folder}/logs"\nleast_free_mb = 0.0\n[output]\n{output}\n[vision]\ntimeout_s = 60.0\n'
    )
    return load(file)


def _counts(session: zenoh.Session) -> Callable[[str], int]:
    """What the daemon says of its vision now, by name."""

    return lambda name: int(status(session).get(f"vision {name}", "0"))


@pytest.mark.long
def test_drawn_while_somebody_subscribes_and_only_then(tmp_path: Path) -> None:
    port = free_port()
    config = _configuration(tmp_path, port, f"overlay_hz = {OVERLAY_HZ}")
    got: list[bytes] = []
    key = rmw_key(0, OVERLAY_TOPIC, schemas.COMPRESSED_IMAGE)
    with in_thread(config, tmp_path) as daemon, client(port) as session, _hovering(daemon):
        count = _counts(session)
        cameras: dict[str, bytes] = {}

        def keep(topic: str) -> Callable[[zenoh.Sample], None]:
            return lambda sample: cameras.update({topic: sample.payload.to_bytes()})

        for topic, schema in CAMERAS.items():
            _ = session.declare_subscriber(rmw_key(0, topic, schema), keep(topic))
        until(lambda: count("answers") >= 4 and len(cameras) == len(CAMERAS), "vision sees, and the cameras are announced")
        assert count("overlays") == 0, "nobody has subscribed"
        watcher = session.declare_subscriber(key, lambda sample: got.append(sample.payload.to_bytes()))
        until(lambda: len(got) >= 3, "overlays come")
        watcher.undeclare()  # type: ignore[no-untyped-call]

        def undrawn() -> bool:
            drawn, answers = count("overlays"), count("answers")
            until(lambda: count("answers") >= answers + 4, "vision goes on seeing")
            return count("overlays") == drawn >= 3

        until(undrawn, "nobody subscribes any more")
        plain: list[bytes] = []
        _ = session.declare_subscriber(plain_key(OVERLAY_TOPIC), lambda sample: plain.append(sample.payload.to_bytes()))
        until(lambda: plain, "overlays come on the key of ros2dds too")
        assert count("restarts") == 0
    _check(got)
    (log,) = logs_of(tmp_path)
    for topic, data in cameras.items():
        assert data in {r.data for r in records(log, topic)}, f"{topic}: in the log what was sent"
    assert records(log, OVERLAY_TOPIC) == [], "an image of an image is not kept"


def _check(got: list[bytes]) -> None:
    """JPEG images of the village with the map drawn in and a strip below, no more often than allowed."""
    raw: Pixels = decode_image(village().pairs[0][0].schema, village().pairs[0][0].data)
    height, width = raw.shape[:2]
    for data in got:
        image = decode_image(schemas.COMPRESSED_IMAGE, data)
        assert image.shape[1] == width
        assert 1.02 * height < image.shape[0] < 1.15 * height
        difference = np.abs(image[:height].astype(int) - raw).max(axis=2)
        assert 0.005 < np.mean(difference > 60) < 0.2, "outlines, names and strokes"
        assert np.median(difference) < 8, "and elsewhere the image"
    stamps = [stamp_of(data) or 0 for data in got]
    periods = [round(t * OVERLAY_HZ) // SECOND for t in stamps]
    assert len(set(periods)) == len(periods)


def test_it_can_be_switched_off(tmp_path: Path) -> None:
    port = free_port()
    config = _configuration(tmp_path, port, "overlay_hz = 0.0")
    got: list[bytes] = []
    with in_thread(config, tmp_path) as daemon, client(port) as session, _hovering(daemon):
        count = _counts(session)
        key = rmw_key(0, OVERLAY_TOPIC, schemas.COMPRESSED_IMAGE)
        _ = session.declare_subscriber(key, lambda sample: got.append(sample.payload.to_bytes()))
        until(lambda: count("answers") >= 4, "vision sees")
        assert count("overlays") == 0
    assert got == []
