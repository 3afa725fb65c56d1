"""Draws docs/images/vision_predict.jpg: a pair far from where the prior has it, found:  python -m docs.draw_predict"""

from pathlib import Path

import cv2
import numpy as np

from models.messages import Array
from tests.vision.predict.test_predict import MARKS, RIG, SIGMA, look_at, prior_off
from vision.image.rectify import Image
from vision.image.reduced import levels
from vision.pose.pose import Pose, PoseEstimate, estimate_pose
from vision.pose.sensitivity import eyes
from vision.predict.coarse_search import CoarseConfig, Search
from vision.predict.motion import motion

OUT = Path(__file__).parent / "images" / "vision_predict.jpg"
RED, BLUE, GREEN, WHITE = (40, 40, 220), (230, 140, 20), (60, 200, 60), (255, 255, 255)
EYE = eyes(RIG)[0]


def main() -> None:
    """Three panels: as predicted, the reduced image that is searched, and as found."""
    view = look_at(MARKS, np.array([4.5, -3.0, -34.0]))
    prior = prior_off(view, np.array([5.5, 4.0, 1.0, 0.005, -0.004, 0.05]), SIGMA)
    moves = motion(EYE, MARKS, prior)
    assert moves is not None
    places = Search(EYE, MARKS, moves, CoarseConfig()).candidates(view.left)
    fit = estimate_pose(RIG, (view.left, view.right), MARKS, places[0].pose, prior, shift_m=places[0].shift_m)
    assert isinstance(fit, PoseEstimate)
    first, second, third = view.left.copy(), _strength(view.left), view.left.copy()
    _outlines(first, (np.asarray(prior.p_n), prior.R_nb), np.zeros((3, 2)), RED)
    _outlines(second, places[1].pose, places[1].shift_m, BLUE)
    _outlines(second, places[0].pose, places[0].shift_m, GREEN)
    _outlines(third, (fit.joint_p_n, fit.joint_R_nb), fit.shift_m, GREEN)
    _write(first, "predicted by the prior")
    _write(second, f"gradients, 1/8: best place {places[0].score:.0f}, next {places[1].score:.0f}")
    _write(third, f"fitted: {np.linalg.norm(fit.joint_p_n - view.p_n):.2f} m off")
    sheet = cv2.resize(np.hstack((first, second, third)), None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(OUT), sheet, [cv2.IMWRITE_JPEG_QUALITY, 85])


def _strength(image: Image) -> Image:
    (level,) = levels(image, RIG.left, (8,))
    strength = np.clip(level.whole()[:, :, 6] * 6.0, 0.0, 255.0).astype(np.uint8)
    large = cv2.resize(strength, (RIG.left.width, RIG.left.height), interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(np.repeat(large[:, :, None], 3, axis=2))


def _outlines(image: Image, pose: Pose, shift_m: Array, colour: tuple[int, int, int]) -> None:
    p_nk, R_nk = EYE.pose(*pose)
    for mark, shift in zip(MARKS, shift_m, strict=True):
        roof = np.column_stack((mark.outline_n + shift[:2], np.full(len(mark.outline_n), mark.roof_d)))
        px = np.rint(EYE.camera.project((roof - p_nk) @ R_nk) * 16.0).astype(np.int32)
        cv2.polylines(image, [px], isClosed=True, color=colour, thickness=2, lineType=cv2.LINE_AA, shift=4)


def _write(image: Image, text: str) -> None:
    cv2.rectangle(image, (0, 0), (640, 26), (30, 30, 30), -1)
    cv2.putText(image, text, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.55, WHITE, 1, cv2.LINE_AA)


if __name__ == "__main__":
    main()
