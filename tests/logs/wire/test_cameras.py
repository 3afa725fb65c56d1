"""Cameras for viewers, as rosbags reads them. That they project as ours do: tests/estimator/frontend/test_replay_images.py."""

from typing import Any

import numpy as np
import pytest

from logs.wire import schemas
from logs.wire.cameras import LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC, encode_cameras, is_own_static
from logs.wire.encoding import packed
from logs.wire.schemas import STORE
from models import so3
from models.camera import CameraModel, StereoRig

DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # looks down, the image's upper edge forward
P_BC = np.array([0.1, -0.05, 0.2])


def _camera(*distortion: float) -> CameraModel:
    return CameraModel(640, 480, 600.0, 601.0, 320.0, 240.0, distortion)


def _said(rig: StereoRig) -> dict[str, Any]:
    return {topic: STORE.deserialize_cdr(data, schema) for topic, schema, data in encode_cameras(1_500_000_000, rig)}


def test_the_right_camera_is_a_base_line_beside_the_left_one() -> None:
    """Nose north, 12 cm apart: the left camera's x axis points to the right of the vehicle, which is -y of base_link."""
    said = _said(StereoRig(_camera(), _camera(), np.eye(3), np.array([-0.12, 0.0, 0.0]), DOWN, P_BC))
    assert set(said) == {LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC}
    left, right = said[STATIC_TOPIC].transforms
    assert [t.child_frame_id for t in (left, right)] == ["left_camera", "right_camera"]
    places = [(t.transform.translation.x, t.transform.translation.y, t.transform.translation.z) for t in (left, right)]
    assert np.allclose(places, [(0.1, 0.05, -0.2), (0.1, 0.05 - 0.12, -0.2)])
    q = left.transform.rotation
    looks = so3.matrix(np.array([q.w, q.x, q.y, q.z])) @ [0.0, 0.0, 1.0]
    assert np.allclose(looks, [0.0, 0.0, -1.0]), "down, in base_link, whose z is up"
    assert (left.header.stamp.sec, left.header.stamp.nanosec) == (1, 500_000_000)


@pytest.mark.parametrize(
    ("distortion", "model", "d"),
    [
        ((), "plumb_bob", [0.0] * 5),
        ((0.1, 0.2, 0.3, 0.4), "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.0]),
        (tuple(np.arange(1.0, 9.0) / 100.0), "rational_polynomial", np.arange(1.0, 9.0) / 100.0),
    ],
)
def test_one_camera_is_announced_alone(distortion: tuple[float, ...], model: str, d: Any) -> None:
    said = _said(StereoRig.of_one(_camera(*distortion), DOWN, P_BC, None))
    assert set(said) == {LEFT_TOPIC, STATIC_TOPIC}
    assert [t.child_frame_id for t in said[STATIC_TOPIC].transforms] == ["left_camera"]
    info = said[LEFT_TOPIC]
    assert info.distortion_model == model
    assert np.allclose(info.d, d)
    assert np.allclose(info.k, [600.0, 0.0, 320.0, 0.0, 601.0, 240.0, 0.0, 0.0, 1.0])
    assert np.allclose(info.p.reshape(3, 4)[:, 3], 0.0)


def test_what_another_program_sends_on_tf_static_is_its_own() -> None:
    *_, static = encode_cameras(7, StereoRig.of_one(_camera(), DOWN, P_BC, None))
    assert is_own_static(static.data)
    message: Any = STORE.deserialize_cdr(static.data, schemas.TF)
    message.transforms[0].child_frame_id = "gripper"
    assert not is_own_static(packed(STATIC_TOPIC, schemas.TF, transforms=message.transforms).data)
    assert not is_own_static(packed(STATIC_TOPIC, schemas.TF, transforms=[]).data)
    assert not is_own_static(b"no message")
