"""The left image, each region with its measurements."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.describe.measure import Measured, Unmeasured
from vision.image.rectify import Image

_MEASURED, _NOT, _INK, _PAPER = (60, 255, 255), (150, 150, 150), (255, 255, 255), (40, 30, 20)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4  # OpenCV draws in sixteenths of a pixel


def annotate(image: Image, measured: Sequence[Measured], unmeasured: Sequence[Unmeasured] = ()) -> NDArray[np.uint8]:
    """BGR image, enlarged if small."""
    scale = 1 if image.shape[1] > 1000 else 2
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    for refused in unmeasured:
        _outline(canvas, refused.region.outline, scale, _NOT)
    for one in measured:
        _outline(canvas, one.region.outline, scale, _MEASURED)
    taken: list[tuple[int, int, int, int]] = []
    for number, one in enumerate(measured, 1):
        lines = (f"{number}: {one.width_m:.2f} x {one.length_m:.2f} m", f"at {one.distance_m:.1f} m")
        middle = (one.region.outline.mean(axis=0) + 0.5) * scale
        _label(canvas, lines, (int(middle[0]), int(middle[1])), taken)
    return np.asarray(canvas, dtype=np.uint8)


def _outline(canvas: Image, outline: Array, scale: int, colour: tuple[int, int, int]) -> None:
    points = np.rint(((outline + 0.5) * scale - 0.5) * 2**_SHIFT).astype(np.int32)
    cv2.polylines(canvas, [points], True, colour, 1, cv2.LINE_AA, _SHIFT)


def _label(canvas: Image, lines: Sequence[str], middle: tuple[int, int], taken: list[tuple[int, int, int, int]]) -> None:
    size, pad, height = 0.42, 3, 14
    width = max(cv2.getTextSize(line, _FONT, size, 1)[0][0] for line in lines) + 2 * pad
    tall = height * len(lines) + 2 * pad
    left = min(max(middle[0] - width // 2, 0), max(canvas.shape[1] - width, 0))
    top = min(max(middle[1] - tall // 2, 0), max(canvas.shape[0] - tall, 0))
    while any(left < a + w and a < left + width and top < b + h and b < top + tall for a, b, w, h in taken):
        top += 4
    if top + tall > canvas.shape[0]:
        return
    taken.append((left, top, width, tall))
    box = canvas[top : top + tall, left : left + width]
    box[:] = (0.35 * box + 0.65 * np.array(_PAPER)).astype(np.uint8)
    for k, line in enumerate(lines):
        cv2.putText(canvas, line, (left + pad, top + pad + height * (k + 1) - 4), _FONT, size, _INK, 1, cv2.LINE_AA)
