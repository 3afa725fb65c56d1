"""Vision: a request and its images in, report and fix out."""

from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np

from estimator.frontend.markers import LandmarkBoard
from estimator.frontend.requests import Shot
from estimator.frontend.residuals import Overlay, View
from estimator.publish import OVERLAY_TOPIC, Pace
from logs.wire.cameras import LEFT_FRAME, RIGHT_FRAME, encode_cameras
from logs.wire.codec import Encoded, encode, encode_input
from logs.wire.images import ImageError, Pixels, decode_image, encode_image
from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import VisionReport, VisionRequest
from models.prior import Prior
from models.radius import horizontal_radius
from vision.image.scaled import scaled
from vision.recognisers import MapImage, RecogniserConfig, Recognisers

_JPEG_QUALITY: Final = 80
_MOST_TIMES: Final = 4  # the pixels of the rig's camera: an image of twice its width is scaled down, a larger one is not decoded
_CAMERAS_HZ: Final = 1.0  # again and again: who comes later, and a part of a rotated log, know them too


class _Look(NamedTuple):
    request: VisionRequest
    left: Pixels | None
    right: Pixels | None
    identified: frozenset[str]


class Processor:
    """Each run of requests starts with empty recognisers."""

    def __init__(
        self, rig: StereoRig, landmarks: LandmarkMap, known: MapImage | None = None, config: RecogniserConfig | None = None
    ) -> None:
        cv2.setNumThreads(1)  # the other core flies
        self._rig, self._landmarks, self._known, self._config = rig, landmarks, known, config
        self._run: int | None = None
        self._recognisers = Recognisers(rig, landmarks, known, config)
        self._board, self._cameras = LandmarkBoard(landmarks), Pace(_CAMERAS_HZ)
        self._used: set[str] = set()
        self._began_ns: int | None = None
        self._last: _Look | None = None

    @property
    def time_offset_ns(self) -> int:
        """Exposure minus stamp."""
        return round(self._rig.time_offset_s * 1e9)

    def process(self, request: VisionRequest, images: tuple[Shot | None, Shot | None]) -> list[Encoded]:
        """The report, the fix if any, messages for viewers. Never raises."""
        if request.run != self._run:
            self._run = request.run
            self._recognisers = Recognisers(self._rig, self._landmarks, self._known, self._config)
            self._board, self._cameras = LandmarkBoard(self._landmarks), Pace(_CAMERAS_HZ)
        decoded = [_decoded(shot, camera) for shot, camera in zip(images, (self._rig.left, self._rig.right), strict=True)]
        left, right = (image if not isinstance(image, str) else None for image in decoded)
        prior = Prior(np.array(request.p_n), np.array(request.q_nb_wxyz), request.covariance)
        result = self._recognisers.process(left, right, request.t_ns, prior)
        unread = "".join(f"; {flaw}" for flaw in decoded if isinstance(flaw, str))
        report: VisionReport = msgspec.structs.replace(result.report, detail=result.report.detail + unread)
        used = frozenset(result.fix.landmarks if result.fix else ())
        self._used |= used
        self._last = _Look(request, left, right, used)
        self._began_ns = self._began_ns or request.t_ns
        news = self._board.news(request.t_ns, prior.p_n, used)
        if self._cameras.due(request.t_ns):
            news += encode_cameras(request.t_ns, self._rig)
        return [*encode(report), *([encode_input(result.fix)] if result.fix else []), *news]

    def draw(self, mode: str) -> Encoded | None:
        """The last image with the map drawn, or None. Never raises."""
        if self._last is None or self._began_ns is None:
            return None
        request, left, right, identified = self._last
        image = left if left is not None else right
        try:
            R_nb = so3.matrix(so3.normalise(np.array(request.q_nb_wxyz)))
            radius_m = float(horizontal_radius(request.covariance[None, :2, :2])[0])
            view = View(request.t_ns, np.array(request.p_n), R_nb, request.covariance, radius_m, mode, identified)
            overlay = Overlay(self._rig, self._landmarks, self._began_ns, right=left is None)
            if image is None or image.shape[1::-1] != (overlay.camera.width, overlay.camera.height):
                return None
            canvas = overlay.frame(image, view, self._used).canvas
        except Exception:  # an image for people must not cost the next fix; `overlays` of the status stands still then
            return None
        frame = LEFT_FRAME if left is not None else RIGHT_FRAME
        return encode_image(request.t_ns, canvas, OVERLAY_TOPIC, jpeg_quality=_JPEG_QUALITY, frame=frame)


def _decoded(shot: Shot | None, camera: CameraModel) -> Pixels | str | None:
    if shot is None:
        return None
    try:
        return scaled(decode_image(shot.schema, shot.data, _MOST_TIMES * camera.width * camera.height), camera)
    except ImageError as error:
        return f"{shot.topic}: {error}"
