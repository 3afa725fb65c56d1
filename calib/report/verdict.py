"""Verdict on a calibration: figures with limits and advice."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from calib.cameras.bundle import Solution
from calib.cameras.mono import HeldOut, Mono
from calib.cameras.selection import coverage
from calib.cameras.stereo import Stereo
from models.camera import CameraModel


class Grade(IntEnum):
    """Of one figure, and of the calibration: its worst."""

    GOOD = 0
    USABLE = 1
    REDO = 2

    @property
    def word(self) -> str:
        """As a person reads it."""
        return self.name.lower()


class Figure(msgspec.Struct, frozen=True):
    """Good up to `good`, usable up to `usable`."""

    name: str
    value: float
    unit: str
    good: float
    usable: float
    advice: str

    @property
    def grade(self) -> Grade:
        """NaN (no figure) is usable at best."""
        if np.isnan(self.value):
            return Grade.USABLE
        return Grade.GOOD if self.value <= self.good else Grade.USABLE if self.value <= self.usable else Grade.REDO


class Verdict(msgspec.Struct, frozen=True):
    """Verdict on a calibration."""

    figures: tuple[Figure, ...]

    @property
    def grade(self) -> Grade:
        """The worst figure's."""
        return max(f.grade for f in self.figures)

    @property
    def advice(self) -> list[str]:
        """Advice, the worst first, without repetition."""
        worst = sorted((f for f in self.figures if f.grade > Grade.GOOD), key=lambda f: -f.grade)
        return list(dict.fromkeys(f.advice for f in worst))

    @property
    def text(self) -> str:
        """One line."""
        return self.grade.word + (": " + "; ".join(self.advice) if self.advice else "")


_STILL: Final = "hold board and camera still, in good light, and see that the board is flat"
_TILT: Final = "tilt the board 20-45 degrees, about both axes, and come near enough to fill a third of the image"
_SPREAD: Final = "move the board into the image's corners and along its borders"
_FLAT: Final = "the board is bowed: glue it to glass or aluminium, and do it again"
_MORE: Final = "take more images (20 that differ)"
_LENS: Final = "take a lens model of fewer coefficients (--lens), or move the board into the corners"


def of_mono(result: Mono) -> Verdict:
    """The verdict on one camera."""
    return Verdict(
        (
            *_common(result.solution.rms, len(result.views)),
            Figure("residual of views left out", result.held_out.rms, "px", 0.6, 1.2, _MORE),
            _beyond(result.held_out),
            _flat(result.solution),
            *_camera(result.camera, result.solution),
            _covered(coverage(result.views), 40.0, 70.0),
        )
    )


def of_stereo(result: Stereo) -> Verdict:
    """The verdict on a rig."""
    C = result.rig.covariance_rc
    assert C is not None
    baseline = float(np.sqrt(C[0, 0])) / result.rig.baseline_m
    tilt = float(np.rad2deg(np.sqrt(np.diagonal(C)[3:].max())))
    covered = np.minimum(coverage([p.left for p in result.pairs]), coverage([p.right for p in result.pairs]))
    return Verdict((
        *_common(result.solution.rms, len(result.pairs)),
        _flat(result.solution),
        Figure("rectified row error", result.epipolar_after_px, "px", 0.35, 0.7, _STILL),
        Figure("the same, pairs left out", result.held_out.rms, "px", 0.4, 0.8, _MORE),
        _beyond(result.held_out),
        *_camera(result.rig.left, result.solution, "left: "), *_camera(result.rig.right, result.solution, "right: "),
        Figure("sigma of the baseline", 100.0 * baseline, "%", 0.3, 1.0, _better(result.solution)),
        Figure("sigma of the rotation between the cameras", tilt, "deg", 0.15, 0.5, _SPREAD),
        _covered(covered, 60.0, 80.0),  # the other camera sees less of it
    ))  # fmt: skip


def _common(rms: float, views: int) -> tuple[Figure, Figure]:
    return (
        Figure("residual", rms, "px", 0.5, 1.0, _STILL),
        Figure("views short of 20", max(20.0 - views, 0.0), "", 10.0, 15.0, _MORE),
    )


def _beyond(held_out: HeldOut) -> Figure:
    return Figure("of those, beyond the lens model of the others", 100.0 * held_out.beyond, "%", 0.0, 25.0, _LENS)


def _flat(solution: Solution) -> Figure:
    return Figure("bow of the board over its length", 100.0 * solution.bow, "%", 0.3, 1.0, _FLAT)


def _better(solution: Solution) -> str:
    return _FLAT if solution.bow > 0.0 else _TILT


def _camera(camera: CameraModel, solution: Solution, side: str = "") -> tuple[Figure, ...]:
    assert camera.covariance is not None
    sigma = np.sqrt(np.diagonal(camera.covariance))
    focal = 100.0 * float(max(sigma[0] / camera.fx, sigma[1] / camera.fy))
    return (
        Figure(f"{side}sigma of the focal length", focal, "%", 0.3, 1.0, _better(solution)),
        Figure(f"{side}image that the lens model cannot have made", uncovered(camera), "%", 0.0, 3.0, _LENS),
        Figure(f"{side}sigma of the principal point", float(max(sigma[2:4])), "px", 3.0, 8.0, _better(solution)),
    )


def _covered(counts: NDArray[np.int64], good: float, usable: float) -> Figure:
    return Figure("image without a corner", 100.0 * float(np.mean(counts == 0)), "%", good, usable, _SPREAD)


def uncovered(camera: CameraModel) -> float:
    """Percent of pixels beyond the lens model's fold."""
    u, v = np.meshgrid(np.linspace(0.0, camera.width - 1.0, 40), np.linspace(0.0, camera.height - 1.0, 30))
    plane = camera.undistort(np.column_stack((u.ravel(), v.ravel())))
    return 100.0 * float(np.mean(np.isnan(plane[:, 0])))


def table(rows: Sequence[Figure]) -> list[tuple[str, str, str, str]]:
    """Name, value, limits, grade."""
    values = ["not known" if np.isnan(f.value) else f"{f.value:.3g} {f.unit}".strip() for f in rows]
    return [(f.name, value, f"<= {f.good:g} / {f.usable:g}", f.grade.word) for f, value in zip(rows, values, strict=True)]
