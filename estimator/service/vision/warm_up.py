"""Run each vision path once on drawn images."""

from collections.abc import Sequence
from itertools import product
from typing import Final

import cv2
import numpy as np

from estimator.frontend.odometry import OdometryProcessor
from estimator.frontend.processor import Processor
from estimator.frontend.requests import Pair, Shot
from logs.wire.images import Pixels, encode_image
from models.camera import CameraModel
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array, OdometryRequest, VisionRequest
from vision.predict.joint_score import joint_score
from vision.synthetic.rigs import make_rig

_PLACE: Final = (0.0, 0.0, -60.0)
_LEVEL: Final = (1.0, 0.0, 0.0, 0.0)
_ORIGIN: Final = (47.0, 8.0, 400.0)
PRIORS_M: Final = (0.3, 5.0, 60.0)  # seen at once, by a search, by segmentation
_PERIOD_NS: Final = 100_000_000
_ROOFS: Final = (  # north, east of the corners [m]: large, small, L-shaped, cut by the border, too small for edges; colour
    (((0.0, -22.0), (2.0, -4.0), (-17.0, -2.0), (-19.0, -20.0)), (40, 40, 205)),
    (((15.0, -9.0), (18.0, -4.0), (14.0, -1.5), (11.0, -6.5)), (205, 110, 25)),
    (((2.0, 8.0), (0.0, 22.0), (-10.0, 20.6), (-9.0, 13.6), (-4.0, 14.3), (-3.0, 7.3)), (30, 190, 225)),
    (((11.0, 10.0), (27.0, 12.3), (25.5, 22.3), (9.5, 20.0)), (70, 165, 35)),
    (((6.0, -16.0), (6.0, -15.2), (5.3, -15.2), (5.3, -16.0)), (215, 200, 205)),
    (((-14.0, 10.0), (-14.0, 10.8), (-14.7, 10.8), (-14.7, 10.0)), (215, 200, 205)),
)
_GROUND, _GRAIN = 110.0, 8.0


def warm_up(priors_m: Sequence[float] = PRIORS_M) -> None:
    """All kinds of images and priors; the overlay."""
    rig, p_n = make_rig(), np.array(_PLACE)
    marks = [
        Landmark.of(str(k), outline, height_m=4.0, colour_bgr=bgr, sigma_m=0.1, height_sigma_m=0.1, outline_sigma_m=0.05)
        for k, (outline, bgr) in enumerate(_ROOFS)
    ]
    left = _drawn(marks, rig.left, *rig.camera_pose(p_n, np.eye(3)))
    right = _drawn(marks, rig.right, *rig.right_camera_pose(p_n, np.eye(3)))
    processor = Processor(rig, LandmarkMap.from_landmarks(_ORIGIN, marks))
    for k, (sigma_m, (is_stereo, is_grey, is_jpeg)) in enumerate(product(priors_m, product((True, False), repeat=3))):
        t_ns = (k + 1) * _PERIOD_NS
        covariance = np.diag(np.repeat([sigma_m, 0.02], 3) ** 2)
        shots = [_shot(t_ns, p[:, :, 1] if is_grey else p, is_jpeg) for p in (left, right)]
        processor.process(
            VisionRequest(t_ns, t_ns, _PLACE, _LEVEL, covariance, None, None), (shots[0], shots[1] if is_stereo else None)
        )
    _score_a_pattern()
    processor.draw("aided")


def _score_a_pattern() -> None:
    field, shifts = np.zeros((4, 4, 7), np.float32), np.zeros(1)
    joint_score(field, np.ones(4), np.ones((1, 11)), 1.0, shifts, shifts)


def warm_up_odometry() -> None:
    """A step between pairs of the same scene, with height and without."""
    rig = make_rig()
    marks = [Landmark.of(str(k), outline, height_m=4.0, colour_bgr=bgr) for k, (outline, bgr) in enumerate(_ROOFS)]
    odometry = OdometryProcessor(rig)
    pairs = []
    for k in (1, 2):
        p_n = np.array((0.2 * k, *_PLACE[1:]))
        left = _drawn(marks, rig.left, *rig.camera_pose(p_n, np.eye(3)))
        right = _drawn(marks, rig.right, *rig.right_camera_pose(p_n, np.eye(3)))
        pairs.append(Pair(*(_shot(k * _PERIOD_NS, image, False) for image in (left, right))))
    names = tuple(tuple(shot.name if shot else None for shot in pair) for pair in pairs)
    for sigma_m in (0.0, 1.0):
        request = OdometryRequest(
            2 * _PERIOD_NS, 2 * _PERIOD_NS, _PERIOD_NS, (0.2, 0.0, 0.0), _LEVEL, np.eye(6) * 1e-3,
            (names[0][0], names[0][1]), (names[1][0], names[1][1]), (0.0, 0.0, 1.0), -_PLACE[2], sigma_m,
        )  # fmt: skip
        odometry.process(request, *pairs)


def _drawn(marks: list[Landmark], camera: CameraModel, p_nc: Array, R_nc: Array) -> Pixels:
    grain = np.random.default_rng(0).normal(_GROUND, _GRAIN, (camera.height, camera.width, 3))
    image = np.clip(grain, 0.0, 255.0).astype(np.uint8)
    for mark in marks:
        corners_n = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        px = camera.project((corners_n - p_nc) @ R_nc)
        cv2.fillPoly(image, [np.round(px).astype(np.int32)], mark.colour_bgr or (0, 0, 0))
    return cv2.GaussianBlur(image, (3, 3), 0).astype(np.uint8)


def _shot(t_ns: int, image: Pixels, is_jpeg: bool) -> Shot:
    _, schema, data = encode_image(t_ns, image, "", jpeg_quality=90 if is_jpeg else None)
    return Shot("", schema, data, t_ns, t_ns, t_ns)
