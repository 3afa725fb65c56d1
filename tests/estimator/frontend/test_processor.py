"""Images through the front-end's door."""

from typing import Any

import cv2
import numpy as np
import pytest

from estimator.frontend.processor import Processor
from estimator.frontend.requests import Shot
from logs.wire.codec import Encoded
from logs.wire.images import Pixels, encode_image
from logs.wire.schemas import STORE
from models import so3
from models.messages import VisionRequest, vec3
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import WorldSpec, make_world

P_N, R_NB = np.array([0.0, 0.0, -80.0]), so3.matrix(so3.from_euler(0.04, -0.03, 0.7))


def shot(image: Pixels) -> Shot:
    message = encode_image(0, image, "/left/image", jpeg_quality=None)
    return Shot("/left/image", message.schema, message.data, 0, 0, 0)


def said(message: Encoded) -> Any:
    return STORE.deserialize_cdr(message.data, message.schema)


@pytest.mark.parametrize(("size", "outcome"), [((640, 480), "fixed"), ((1280, 960), "fixed"), ((640, 360), "no_image")])
def test_images_of_another_size_are_scaled_where_the_aspect_ratio_fits(size: tuple[int, int], outcome: str) -> None:
    """With the camera of 640 x 480 that was calibrated."""
    scene = make_world(2, WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1))
    left, _ = render_pair(scene.world, scene.rig, P_N, R_NB, Conditions(), np.random.default_rng(1))
    w, x, y, z = so3.from_matrix(R_NB).tolist()
    covariance = np.diag(np.array([3.0, 3.0, 2.0, 0.01, 0.01, 0.02]) ** 2)
    request = VisionRequest(0, 0, vec3(P_N), (w, x, y, z), covariance, None, None)
    seen = np.asarray(cv2.resize(left, size, interpolation=cv2.INTER_CUBIC), np.uint8)
    messages = Processor(scene.rig_calibrated, scene.map).process(request, (shot(seen), None))
    assert said(messages[0]).outcome == outcome
    if outcome == "fixed":
        position = said(messages[1]).pose.pose.position
        north_east_down = np.array([position.y, position.x, -position.z])
        assert np.linalg.norm(north_east_down - P_N) < 1.5
