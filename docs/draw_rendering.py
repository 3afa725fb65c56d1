"""Draws docs/images/rendering.jpg: what the renderer makes, by height, tilt and condition. Run: python -m docs.draw_rendering."""

import math
from pathlib import Path

import cv2
import numpy as np

from models import so3
from models.messages import Array
from vision.synthetic import Conditions, Image, Scene, WorldSpec, landmark_views, make_world, render_pair

OUT = Path(__file__).parent / "images" / "rendering.jpg"
SIZE = 400, 300
CONDITIONS = {
    "haze, 60 m": Conditions(haze_per_m=0.012),
    "motion blur, 60 m": Conditions(blur_px=(9.0, 4.0)),
    "dusk, 60 m": Conditions(exposure=0.28, read_sigma=2.5, shot=0.08, cast_bgr=(1.15, 1.0, 0.85)),
}


def main() -> None:
    """One row nadir, one row tilted, one row of conditions."""
    scene = make_world(3, WorldSpec(unmapped=0.3, spacing_m=22.0))
    heights = (10.0, 30.0, 60.0, 120.0)
    rows = [[titled(shot(scene, h, tilt), f"{h:.0f} m, tilt {tilt:.0f} deg") for h in heights] for tilt in (0.0, 25.0)]
    rows.append([titled(shot(scene, 60.0, 12.0, c), name) for name, c in CONDITIONS.items()])
    rows[2].append(titled(with_truth(scene, shot(scene, 60.0, 12.0), 60.0, 12.0), "what of the map's landmarks is seen"))
    sheet = np.vstack([np.hstack(row) for row in rows])
    cv2.imwrite(str(OUT), sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])


def pose(height: float, tilt_deg: float) -> tuple[Array, Array]:
    """Body position and axes."""
    return np.array([4.0, 6.0, -height]), so3.matrix(so3.from_euler(0.0, math.radians(tilt_deg), 0.5))


def shot(scene: Scene, height: float, tilt_deg: float, conditions: Conditions | None = None) -> Image:
    """The left image."""
    return render_pair(scene.world, scene.rig, *pose(height, tilt_deg), conditions or Conditions(), np.random.default_rng(1))[0]


def with_truth(scene: Scene, image: Image, height: float, tilt_deg: float) -> Image:
    """Visible roof edges in white, visible corners in yellow."""
    p, R = scene.rig.camera_pose(*pose(height, tilt_deg))
    for landmark_view in landmark_views(scene.world, scene.rig.left, p, R):
        for stretch in landmark_view.stretches:
            cv2.polylines(image, [np.rint(stretch.px * 16).astype(np.int32)], False, (255, 255, 255), 2, cv2.LINE_AA, 4)
        for corner in landmark_view.corners_px[landmark_view.corners_visible]:
            u, v = np.rint(corner).astype(int).tolist()
            cv2.circle(image, (u, v), 5, (0, 255, 255), 2, cv2.LINE_AA)
    return image


def titled(image: Image, title: str) -> Image:
    """Made small, with its title."""
    small = np.asarray(cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    for place, colour in (((11, 25), (0, 0, 0)), ((10, 24), (255, 255, 255))):
        cv2.putText(small, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv2.LINE_AA)
    return small


if __name__ == "__main__":
    main()
