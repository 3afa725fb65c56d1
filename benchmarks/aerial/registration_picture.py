"""Draws the image of docs/vision_orthophoto.md, rendered ground in another season:
python -m benchmarks.aerial.registration_picture
"""

from itertools import islice
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.aerial.registration_sets import flights
from vision.ground.image import pyramid
from vision.ground.registration import Registered, register
from vision.ground.search import structure
from vision.ground.view import camera_view, make_grid, map_view

OUT = Path(__file__).parents[2] / "docs/images/vision_pictures.jpg"
_POINTS, _REACH = 256, 48


def main() -> None:
    """What the search compares, and what it finds; the prior is off by what is seen between middle and peak."""
    (flight,) = islice((f for f in flights("rendered", Path(), 0, Path()) if "season" in f.group), 1)
    (shot,) = islice(flight.shots(), 1)
    image, prior = flight.known.image, shot.prior
    camera = (flight.rig.left, *flight.rig.camera_pose(prior.p_n, prior.R_nb))
    grid = make_grid(camera, image, _POINTS)
    found = register(flight.rig, shot.image, prior, image)
    assert grid is not None
    assert isinstance(found, Registered)
    view, seen = camera_view(pyramid(shot.image), camera, grid, image)
    known = map_view(image, grid, _REACH)
    a, b = structure(view), structure(known)
    scores = cv2.matchTemplate(b, a, cv2.TM_CCOEFF_NORMED, mask=seen.astype(np.float32))
    figure, axes = plt.subplots(2, 3, figsize=(12.0, 6.6), layout="constrained")
    _show(axes[0, 0], shot.image[..., ::-1], "camera: another season, hazy, overcast")
    _show(axes[0, 1], view, "seen from above, by the prior")
    _show(axes[0, 2], known, "the map about there")
    _show(axes[1, 1], a, "its structure")
    _show(axes[1, 2], b, "the map's structure")
    reach = _REACH * grid.q
    surface = axes[1, 0].imshow(np.asarray(scores), extent=(-reach, reach, reach, -reach), cmap="viridis")
    axes[1, 0].set_title("their correlation, over the shift [m] along the image's axes", fontsize=10)
    axes[1, 0].plot(0.0, 0.0, "+", color="white", markersize=12)
    figure.colorbar(surface, ax=axes[1, 0])
    figure.savefig(OUT, dpi=80, facecolor="white", pil_kwargs={"quality": 85, "optimize": True})


def _show(ax: Axes, image: np.typing.NDArray[np.generic], title: str) -> None:
    ax.imshow(image, cmap="gray")
    ax.set_title(title, fontsize=10)
    ax.axis("off")


if __name__ == "__main__":
    main()
