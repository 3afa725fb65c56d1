"""Fixes of a log on one sheet."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from logs.store.reader import LogReader
from logs.wire.codec import VISION_REQUEST_TOPIC, Decoder, decode_vision_request
from logs.wire.images import ImageError, Pixels, decode_image
from logs.wire.stamps import stamp_of
from models import so3
from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import ImageName, LandmarkFix, VisionRequest
from vision.describe.survey import to_8_bit
from vision.show.overlay import Canvas, draw_overlay, outline_residuals

_FIX = "/landfix/fix"
_REACH_M = 200.0
_COLUMNS = 2

T = TypeVar("T")


class Shown(NamedTuple):
    """A fix and its left image."""

    fix: LandmarkFix
    image: ImageName


def write_sheet(log: Path, out: Path, rig: StereoRig, landmarks: LandmarkMap, count: int = 4) -> int:
    """Draw `count` fixes into the PNG `out`; returns how many exist."""
    shown = spread(_fixes(log), count)
    if shown:
        images, start_ns = find_images(log, {s.image for s in shown})
        drawn = [_draw(s.fix, images[s.image], rig, landmarks, start_ns) for s in shown if s.image in images]
        whole = len(drawn) - len(drawn) % _COLUMNS
        rows: list[Canvas] = [np.hstack(drawn[k : k + _COLUMNS]) for k in range(0, whole, _COLUMNS)]
        cv2.imwrite(str(out), np.vstack(rows) if rows else drawn[0])
    return len(shown)


def _fixes(log: Path) -> list[Shown]:
    asked: dict[int, ImageName] = {}
    found: list[Shown] = []
    with LogReader(log) as reader:
        for record in reader:
            if record.topic == VISION_REQUEST_TOPIC:
                request = decode_vision_request(record.data, record.log_time_ns)
                if request.left is not None:
                    asked[request.t_ns] = request.left
            elif record.topic == _FIX:
                fix = Decoder().decode(record.topic, record.schema, record.data, record.log_time_ns)
                if isinstance(fix, LandmarkFix) and fix.t_ns in asked:
                    found.append(Shown(fix, asked[fix.t_ns]))
    return found


def spread(rows: Sequence[T], count: int) -> list[T]:
    """As many as are asked for, evenly."""
    chosen = np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(int)
    return [rows[row] for row in np.unique(chosen).tolist()]


def find_images(log: Path, wanted: set[ImageName]) -> tuple[dict[ImageName, Pixels], int]:
    """The images, and when the log begins."""
    images: dict[ImageName, Pixels] = {}
    missing = set(wanted)
    start_ns = 0
    with LogReader(log) as reader:
        for record in reader:
            start_ns = start_ns or record.log_time_ns
            name = ImageName(record.topic, stamp_of(record.data) or 0)
            if name in missing:
                missing.remove(name)
                with suppress(ImageError):
                    images[name] = decode_image(record.schema, record.data)
            if not missing:
                break
    return images, start_ns


def _draw(fix: LandmarkFix, image: Pixels, rig: StereoRig, landmarks: LandmarkMap, start_ns: int) -> Canvas:
    many = "landmark" if len(fix.landmarks) == 1 else "landmarks"
    caption = [f"{(fix.t_ns - start_ns) * 1e-9:.1f} s: {len(fix.landmarks)} {many}, fit {fix.residual_px:.2f} px"]
    return draw_from(fix, image, rig, landmarks, fix.landmarks, caption)


def draw_from(
    pose: LandmarkFix | VisionRequest,
    image: Pixels,
    rig: StereoRig,
    landmarks: LandmarkMap,
    identified: Collection[str] = (),
    caption: Sequence[str] = (),
) -> Canvas:
    """The left image with the map drawn from a pose."""
    canvas = np.asarray(to_8_bit(image), np.uint8)
    p_nc, R_nc = rig.camera_pose(np.array(pose.p_n), so3.matrix(so3.normalise(np.array(pose.q_nb_wxyz))))
    near = landmarks.near(p_nc[0], p_nc[1], _REACH_M)
    residuals = outline_residuals(canvas, rig.left, p_nc, R_nc, [mark for mark in near if mark.id in identified])
    return draw_overlay(canvas, rig.left, p_nc, R_nc, near, identified, residuals, caption)
