"""The images of a request that can be used."""

from dataclasses import dataclass

import numpy as np

from models.camera import StereoRig
from vision.describe.survey import to_8_bit
from vision.image.check import image_flaw, pair_flaw
from vision.image.rectify import Image


@dataclass(frozen=True, slots=True)
class Images:
    """Raw images, 8 bit, None where unusable; remark: what is wrong with the other."""

    left: Image | None
    right: Image | None
    remark: str

    @property
    def only_right(self) -> bool:
        """Whether the one good image is the right one."""
        return self.left is None

    @property
    def one_channel(self) -> bool:
        """Whether the images have no colour."""
        return any(image is not None and image.ndim == 2 for image in (self.left, self.right))


def usable(left: Image | None, right: Image | None, rig: StereoRig) -> Images | str:
    """Usable images, or the reason for none."""
    flaws = [
        "missing" if image is None else image_flaw(image, camera) for image, camera in ((left, rig.left), (right, rig.right))
    ]
    if all(flaws):
        return str(flaws[0]) if rig.one_camera else f"left: {flaws[0]}; right: {flaws[1]}"
    if not any(flaws) and left is not None and right is not None and (flaw := pair_flaw(left, right)):
        flaws[1] = flaw
    sides = ("left",) if rig.one_camera else ("left", "right")
    remark = "".join(f"{name} camera not used: {flaw}; " for name, flaw in zip(sides, flaws, strict=False) if flaw)
    first, second = (
        None if image is None or flaw else np.require(to_8_bit(image), np.uint8, ["C", "W"])  # as the kernels are compiled
        for image, flaw in zip((left, right), flaws, strict=True)
    )
    return Images(first, second, remark)
