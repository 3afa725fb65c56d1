"""Vision behind a door of messages: a request and its pictures in, report and fix out."""

import cv2
import msgspec
import numpy as np

from estimator.overlay_board import LandmarkBoard
from estimator.vision_requests import Shot
from logs.codec import Encoded, encode, encode_input
from logs.pictures import Picture, PictureError, decode_picture
from models.camera import StereoRig
from models.landmarks import LandmarkMap
from models.messages import VisionReport, VisionRequest
from vision.identify import Prior
from vision.pipeline import LandmarkPipeline, PipelineConfig


class Sight:
    """Vision, from request and pictures to messages. Each run of requests has a pipeline of its own: its memory begins anew."""

    def __init__(self, rig: StereoRig, landmarks: LandmarkMap, config: PipelineConfig | None = None) -> None:
        cv2.setNumThreads(1)  # the other core flies
        self._rig, self._landmarks, self._config = rig, landmarks, config
        self._run: int | None = None
        self._pipeline = LandmarkPipeline(rig, landmarks, config)
        self._board = LandmarkBoard(landmarks)

    @property
    def time_offset_ns(self) -> int:
        """Exposure minus stamp."""
        return round(self._rig.time_offset_s * 1e9)

    def look(self, request: VisionRequest, pictures: tuple[Shot | None, Shot | None]) -> list[Encoded]:
        """What the pictures show: the report, the fix if there is one, and for viewers the landmarks where that is news.

        Never raises.
        """
        if request.run != self._run:
            self._run = request.run
            self._pipeline = LandmarkPipeline(self._rig, self._landmarks, self._config)
            self._board = LandmarkBoard(self._landmarks)
        left, right = (_decoded(shot) for shot in pictures)
        prior = Prior(np.array(request.p_n), np.array(request.q_nb_wxyz), request.covariance)
        result = self._pipeline.process(
            left if not isinstance(left, str) else None, right if not isinstance(right, str) else None, request.t_ns, prior
        )
        unread = "".join(f"; {flaw}" for flaw in (left, right) if isinstance(flaw, str))
        report: VisionReport = msgspec.structs.replace(result.report, detail=result.report.detail + unread)
        used = frozenset(result.fix.landmarks if result.fix else ())
        news = self._board.news(request.t_ns, prior.p_n, used)
        return [*encode(report), *([encode_input(result.fix)] if result.fix else []), *news]


def _decoded(shot: Shot | None) -> Picture | str | None:
    """The picture, or why it cannot be read."""
    if shot is None:
        return None
    try:
        return decode_picture(shot.schema, shot.data)
    except PictureError as error:
        return f"{shot.topic}: {error}"
