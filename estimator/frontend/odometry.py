"""Visual odometry: a request and its images in, an increment or a report out."""

from typing import Final

import cv2
import numpy as np

from estimator.frontend.key_frames import name_of
from estimator.frontend.requests import Pair
from logs.wire.codec import Encoded, encode, encode_input
from logs.wire.images import ImageError, Pixels, decode_image
from models import so3
from models.camera import StereoRig
from models.messages import Array, ImageName, OdometryDelta, OdometryRequest, VisionReport, vec3
from vision.odometry.step import Frame, Prediction, Step, StereoOdometry

ODOMETRY_REPORT_TOPIC: Final = "/landfix/odometry_report"
_KEPT_FRAMES: Final = 2


class OdometryProcessor:
    """Turns requests and images into messages; caches the rectified frames of the last step."""

    def __init__(self, rig: StereoRig) -> None:
        cv2.setNumThreads(1)
        self._odometry = StereoOdometry(rig)
        self._most_pixels = max(camera.width * camera.height for camera in (rig.left, rig.right))
        self._time_offset_ns = round(rig.time_offset_s * 1e9)
        self._frames: dict[tuple[ImageName | None, ...], Frame | str] = {}

    @property
    def time_offset_ns(self) -> int:
        """Exposure minus stamp."""
        return self._time_offset_ns

    def process(self, request: OdometryRequest, first: Pair, second: Pair) -> list[Encoded]:
        """The report, and the increment if any. Never raises."""
        frames = [self._frame(pair) for pair in (first, second)]
        flaws = [f"{name}: {frame}" for name, frame in zip(("first", "second"), frames, strict=True) if isinstance(frame, str)]
        a, b = frames
        if isinstance(a, str) or isinstance(b, str):
            step = Step("; ".join(flaws))
        else:
            step = self._odometry.step(a, b, prediction_of(request))
        inliers = 0 if step.inliers is None else int(step.inliers.sum())
        report = VisionReport(
            request.t_ns, request.t_ns, "lost" if step.reason else "measured", step.reason or step.remark, step.points, inliers,
            residual_px=step.residual_scale,
        )  # fmt: skip
        said = [encode(report)[0]._replace(topic=ODOMETRY_REPORT_TOPIC)]
        return said if step.reason else [*said, encode_input(delta_of(request, step))]

    def _frame(self, pair: Pair) -> Frame | str:
        names = name_of(pair.left), name_of(pair.right)
        if names not in self._frames:
            self._frames[names] = self._decoded(pair)
            while len(self._frames) > _KEPT_FRAMES:
                del self._frames[next(iter(self._frames))]
        return self._frames[names]

    def _decoded(self, pair: Pair) -> Frame | str:
        images: list[Pixels | None] = []
        for shot in pair:
            try:
                images.append(None if shot is None else decode_image(shot.schema, shot.data, self._most_pixels))
            except ImageError as error:
                return f"{shot.topic}: {error}" if shot else str(error)
        return self._odometry.frame(images[0], images[1])


def delta_of(request: OdometryRequest, step: Step) -> OdometryDelta:
    """The increment of a step."""
    w, x, y, z = step.q.tolist()
    return OdometryDelta(
        request.t_ns, request.t_ns, request.t0_ns, vec3(step.p), (w, x, y, z), step.covariance, systematic=step.systematic
    )  # fmt: skip


def prediction_of(request: OdometryRequest) -> Prediction:
    """Prediction of a request for a step."""
    p, q = np.array(request.dp_b), so3.normalise(np.array(request.dq_wxyz))
    if request.height_sigma_m <= 0.0:
        return Prediction(p, q, request.covariance)
    down: Array = np.array(request.down_b)
    return Prediction(p, q, request.covariance, down, request.height_m, request.height_sigma_m)
