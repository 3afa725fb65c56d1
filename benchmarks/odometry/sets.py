"""What odometry is measured on: recorded stereo pairs with truth, recorded tracks."""

import gzip
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from ruamel.yaml import YAML

from benchmarks.flights.tasks import data_folder
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.image.rectify import Image
from vision.odometry.step import Tracks

HANDHELD: Final = "euroc_mh01_handheld_stereo_imu"
KEY_FRAMES: Final = "euroc_v101_keyframes_stereo_imu"


class Pose(NamedTuple):
    """Of the body in the world: p (3,), R (3, 3)."""

    p: Array
    R: Array


class Frame(NamedTuple):
    """A pair, its time and true pose; number: in its recording."""

    t_s: float
    pose: Pose
    images: Callable[[], tuple[Image, Image]]
    number: int = 0


@dataclass(frozen=True)
class Sequence:
    """rig: as calibrated. tracks: of two frames, where there are no images.

    truth_sigma: error of a true step, m and share of its length.
    """

    name: str
    rig: StereoRig
    frames: list[Frame]
    lengths_m: tuple[float, ...]
    tracks: Callable[[int, int], Tracks] | None = None
    truth_sigma: tuple[float, float] = (0.0, 0.0)

    def every(self, n: int) -> "Sequence":
        """Each n-th frame."""
        return replace(self, name=f"{self.name} /{n}", frames=self.frames[::n])


def euroc(name: str, pairs: int | None = None) -> Sequence:
    """A set of euroc_*: raw images, factory calibration."""
    folder = data_folder() / "odometry" / name
    (left, T_l), (right, T_r) = (_euroc_camera(folder / f"{cam}_sensor.yaml") for cam in ("cam0", "cam1"))
    T = np.linalg.inv(T_r) @ T_l
    rig = StereoRig(left, right, _orthonormal(T[:3, :3]), T[:3, 3], _orthonormal(T_l[:3, :3]), T_l[:3, 3])
    with gzip.open(folder / "truth.csv.gz") as file:
        truth = np.loadtxt(file, delimiter=",", skiprows=1)
    rows = np.loadtxt(folder / "frames.csv", delimiter=",", skiprows=1)[:pairs]
    frames = [Frame(t, pose_at(truth, t), _reader(folder, f"{int(k):04d}.jpg")) for k, t in rows.tolist()]
    return Sequence(name.split("_stereo", maxsplit=1)[0], rig, frames, (1.0, 2.0, 4.0), None, (0.001, 0.0))


def kitti_pairs(folder: Path) -> Sequence:
    """Rectified pairs of a car, 10 Hz; body = left camera. calib.txt: P of both cameras (3, 4), poses.txt: (3, 4) a row."""
    left, right = np.loadtxt(folder / "calib.txt").reshape(2, 3, 4)
    sides = ("left", "right") if (folder / "left").is_dir() else ("image_l", "image_r")
    names = sorted(path.name for path in (folder / sides[0]).iterdir())
    read = [_reader(folder, name, sides) for name in names]
    height, width = read[0]()[0].shape
    camera = CameraModel(width, height, left[0, 0], left[1, 1], left[0, 2], left[1, 2])
    rig = StereoRig(camera, camera, np.eye(3), np.array([right[0, 3] / right[0, 0], 0.0, 0.0]), np.eye(3), np.zeros(3))
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    frames = [
        Frame(0.1 * k, Pose(T[:, 3], _orthonormal(T[:, :3])), images)
        for k, (T, images) in enumerate(zip(poses, read, strict=True))
    ]
    return Sequence(folder.name.removesuffix("_stereo"), rig, frames, (20.0, 40.0), None, (0.005, 0.005))


def kitti_tracks(path: Path) -> Sequence:
    """Tracks of a drive, rounded to 0.1 px; body = vehicle (x forward, y left, z up).

    Truth: 2 cm of a position, its stamps in steps of 10 ms, axes to 0.5 degrees.
    """
    data = np.load(path)
    f, fv, cx, cy, b = (float(data[k]) for k in ("fu", "fv", "cu", "cv", "b"))
    assert abs(f - fv) < 1e-6
    camera = CameraModel(1242, 375, f, f, cx, cy)
    R_bc = _orthonormal(data["C_c_v"]).T
    rig = StereoRig(camera, camera, np.eye(3), np.array([-b, 0.0, 0.0]), R_bc, data["rho_v_c_v"].ravel())
    frames = []
    for k, t in enumerate((data["t"] - data["t"][0]).tolist()):
        R = so3.matrix(so3.quat_exp(np.ascontiguousarray(data["theta"][k])))
        frames.append(Frame(t, Pose(data["r"][k], R), _no_images, k))
    later = ~np.isin(data["track"], data["track"][data["frame"] == 0])  # the disparities of those double after it
    px, frame, track = data["uL_vL_uR_vR"][later].astype(np.float64), data["frame"][later], data["track"][later]

    def tracks(i: int, j: int) -> Tracks:
        first, second = (np.flatnonzero((frame == k) & np.isfinite(px).all(axis=1) & (px[:, 0] > px[:, 2])) for k in (i, j))
        _, a, b = np.intersect1d(track[first], track[second], return_indices=True)
        return Tracks(px[first[a]][:, :3], px[second[b]][:, :3])

    return Sequence(f"kitti {path.stem[-15:]}", rig, frames, (100.0,), tracks, (0.03, 0.01))


def _reader(folder: Path, name: str, sides: tuple[str, str] = ("left", "right")) -> Callable[[], tuple[Image, Image]]:
    def images() -> tuple[Image, Image]:
        left, right = (cv2.imread(str(folder / side / name), cv2.IMREAD_GRAYSCALE) for side in sides)
        assert left is not None
        assert right is not None
        return left, right

    return images


def _no_images() -> tuple[Image, Image]:
    raise AssertionError("a set of tracks")


def _euroc_camera(path: Path) -> tuple[CameraModel, Array]:
    read = YAML(typ="safe").load(path)
    distortion = tuple(read["distortion_coefficients"])
    (width, height), (fx, fy, cx, cy) = read["resolution"], read["intrinsics"]
    return CameraModel(width, height, fx, fy, cx, cy, distortion), np.array(read["T_BS"]["data"]).reshape(4, 4)


def _orthonormal(R: Array) -> Array:
    u, _, v = np.linalg.svd(R)
    turned: Array = u @ v
    return turned


def pose_at(truth: Array, t: float) -> Pose:
    """Between the two nearest rows t, p, v, q."""
    i = int(np.clip(np.searchsorted(truth[:, 0], t), 1, len(truth) - 1))
    a, b = truth[i - 1], truth[i]
    w = (t - a[0]) / (b[0] - a[0])
    q = np.ascontiguousarray(a[7:11])
    turn = so3.quat_log(so3.multiply(so3.conjugate(q), np.ascontiguousarray(b[7:11])))
    return Pose(a[1:4] + w * (b[1:4] - a[1:4]), so3.matrix(so3.normalise(so3.multiply(q, so3.quat_exp(w * turn)))))
