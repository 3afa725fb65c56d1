"""Draws docs/images/recognition_samples.jpg: what the four experiments show. Run: python -m docs.draw_recognition."""

from pathlib import Path

import cv2
import numpy as np

from benchmarks.recognition.experiments import TITLES
from benchmarks.recognition.views import EXPERIMENTS, ROOFS, Sample, draw
from vision.image.rectify import Image

OUT = Path(__file__).parent / "images" / "recognition_samples.jpg"
SIZE = 400, 300
NUMBER = {"accuracy": 2, "size": 0, "partial": 3, "description": 3}


def main() -> None:
    """A column for each experiment, a row for each kind of roof."""
    rows = [[titled(shown(draw(e, r, 0, NUMBER[e])), f"{TITLES[e]}, {r}") for e in EXPERIMENTS] for r in ROOFS]
    cv2.imwrite(str(OUT), np.vstack([np.hstack(row) for row in rows]), [cv2.IMWRITE_JPEG_QUALITY, 74])


def shown(sample: Sample) -> Image:
    """The left image, the roof that is asked for outlined, its reference image in the corner."""
    p_nc, R_nc = sample.scene.rig.camera_pose(sample.p_n, sample.R_nb)
    mark = next(m for m in sample.scene.world.landmarks if m.id == sample.target)
    roof = np.column_stack([mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)])
    px = sample.scene.rig.left.project((roof - p_nc) @ R_nc)
    image = cv2.polylines(sample.left.copy(), [px.round().astype(np.int32)], True, (255, 255, 255), 2, cv2.LINE_AA)
    image = np.asarray(cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA))
    if sample.reference is not None:
        small = cv2.resize(sample.reference.image, (84, 84), interpolation=cv2.INTER_AREA)
        image[-90:, -90:] = 255
        image[-87:-3, -87:-3] = small
    return image


def titled(image: Image, title: str) -> Image:
    """A line of text above."""
    strip = np.full((24, image.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, title, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.48, (40, 40, 40), 1, cv2.LINE_AA)
    return np.vstack([strip, image])


if __name__ == "__main__":
    main()
