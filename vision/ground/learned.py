"""Position by learned features: XFeat and LighterGlue as ONNX files, one thread, deterministic.

map's image, projected over its heights to what the camera sees -> keypoints of both (Potje et al. 2024) -> matches (LightGlue,
Lindenberger et al. 2023) -> RANSAC and pose as in features.py, with scale, heading and tilt by the prior
"""

import hashlib
import math
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.features import FeatureConfig, Matches, NotRecognised, Recognised, first_inliers, pose_of_matches
from vision.ground.image import Float, GroundImage, pyramid, sample
from vision.ground.search import shift_of_ground
from vision.ground.view import Mask, make_grid
from vision.image.rectify import Image
from vision.pose.pose import Pose

_ROWS, _COLUMNS = 640, 360  # of the extractor's input
_MOST_YAW: Final = math.radians(10.0)  # 1 sigma: the keypoints are not those of a turned image
_WIDEST: Final = 2.0  # of the map's view: beyond it the ground is too small in it
_NEAR: Final = 1.15  # of the map's view where the position is known by a peak: its scale is that of the image
_STEEPEST: Final = 0.05  # least sine of a ray below the horizon
_FEATURE_PX: Final = 1.0  # of a keypoint's position in the extractor's input
_INLIER_PX: Final = 4.0  # the same, of RANSAC
_TERMS: Final = 5  # of the intersection of a ray with the heights, at most
_LEVEL_M: Final = 1e-3  # a change of height that moves no point
_MOVED: Final = 1.9  # as a peak's in peak.py: of the unevenness, common to all matches, the more the fewer of them agree
_LEAST: Final = 8  # keypoints, and matches
_JUDGED = FeatureConfig()


class ModelError(ValueError):
    """An unusable model; one line with the file."""


class Model(NamedTuple):
    """An ONNX file; SHA-256 empty: unchecked."""

    name: str
    content: bytes
    sha256: str = ""


class Learned:
    """Both models. Raises ModelError for a wrong or unusable one."""

    def __init__(self, extractor: Model, matcher: Model) -> None:
        self._extractor = _session(extractor, {"images"}, 3)
        self._matcher = _session(matcher, {"kpts0", "kpts1", "desc0", "desc1"}, 2)

    def keypoints(self, grey: Float) -> tuple[Array, Float]:
        """Pixels (N, 2) and descriptors (N, 64) of an image (640, 360)."""
        images = np.broadcast_to(grey[None, None] / np.float32(255.0), (1, 3, *grey.shape))
        px, descriptors, _ = self._extractor.run(None, {"images": np.ascontiguousarray(images, dtype=np.float32)})
        return px.astype(np.float64), descriptors

    def matches(self, first: tuple[Array, Float], second: tuple[Array, Float]) -> Array:
        """Rows (M, 2) of both."""
        given: dict[str, Float] = {}
        for k, (px, descriptors) in enumerate((first, second)):
            centred = (px - (0.5 * _COLUMNS, 0.5 * _ROWS)) / (0.5 * _ROWS)
            given |= {f"kpts{k}": centred[None].astype(np.float32), f"desc{k}": descriptors[None]}
        rows: Array = self._matcher.run(None, given)[0]
        return rows


def _session(model: Model, inputs: set[str], outputs: int) -> Any:
    name, content, sha256 = model
    found = hashlib.sha256(content).hexdigest()
    if sha256 and found != sha256.lower():
        raise ModelError(f"{name}: its SHA-256 is {found}, not {sha256}")
    try:
        import onnxruntime  # noqa: PLC0415  (optional)
    except ImportError:
        raise ModelError(f"{name}: learned matching needs onnxruntime: pip install 'landfix[learned]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception:  # whatever the runtime says of a file that is none, it has classes of its own for it
        raise ModelError(f"{name}: not an ONNX model that can be read") from None
    if {one.name for one in session.get_inputs()} != inputs or len(session.get_outputs()) != outputs:
        raise ModelError(f"{name}: not the model that is needed here (inputs {', '.join(sorted(inputs))})")
    return session


def recognise_learned(
    models: Learned, rig: StereoRig, image: Image, prior: Prior, map_image: GroundImage, near: Pose | None = None
) -> Recognised | NotRecognised:
    """Pose of the left camera; near: p_n, R_nb from which the map is viewed, else from the prior, as wide as it is open."""
    p_nc, R_nc = rig.camera_pose(*(near or (prior.p_n, prior.R_nb)))
    grid = make_grid((rig.left, p_nc, R_nc), map_image, _ROWS)
    if grid is None:
        return NotRecognised("no_ground", "the camera does not point at the ground")
    yaw = math.sqrt(float(prior.covariance[5, 5]))
    if yaw > _MOST_YAW:
        return NotRecognised(
            "prior_too_wide", f"heading open by {math.degrees(yaw):.0f} deg (1 sigma), {math.degrees(_MOST_YAW):.0f} would do"
        )
    arm = map_image.points(grid.centre[None])[0] - prior.p_n
    J = shift_of_ground(arm)
    open_px = 2.0 * math.sqrt(float(np.linalg.eigvalsh(J @ prior.covariance @ J.T)[-1])) / grid.camera_m
    wide = _NEAR if near else min(1.0 + 2.0 * open_px / min(rig.left.width, rig.left.height), _WIDEST)
    unit_px = max(rig.left.width, rig.left.height) / _ROWS
    view, shown = _views(rig, image, (p_nc, R_nc), map_image, (wide, unit_px, grid.camera_m))
    mine, theirs = models.keypoints(view), models.keypoints(shown)
    if min(len(mine[0]), len(theirs[0])) < _LEAST:
        return NotRecognised("no_features", f"{len(mine[0])} in the image, {len(theirs[0])} in the map")
    rows = models.matches(mine, theirs)
    px, rays = _to_camera(rig, mine[0][rows[:, 0]]), _widened(rig, _to_camera(rig, theirs[0][rows[:, 1]]), wide)
    x_n, good = _on_ground(rays, (p_nc, R_nc), map_image)
    good &= map_image.contains(x_n[:, :2])
    if good.sum() < _LEAST:
        return NotRecognised("few_matches", f"{good.sum()} of {len(mine[0])} features")
    sigma_px = math.hypot(_FEATURE_PX * wide * unit_px, 0.5 * map_image.pixel_m / grid.camera_m)
    matches = Matches(px[good], x_n[good], sigma_px, _INLIER_PX * wide * unit_px)
    agree = first_inliers(rig, matches)
    found = pose_of_matches(rig, matches, agree, prior, map_image, _JUDGED)
    if isinstance(found, NotRecognised):
        return found
    moved_m = _MOVED * map_image.heights.unevenness_m * (1.0 - found.inliers / found.matched) ** 4
    less_sure = replace(map_image, sigma_m=math.hypot(map_image.sigma_m, moved_m))
    return pose_of_matches(rig, matches, agree, prior, less_sure, _JUDGED)


def _views(
    rig: StereoRig, image: Image, pose: tuple[Array, Array], map_image: GroundImage, sizes: tuple[float, float, float]
) -> tuple[Float, Float]:
    wide, unit_px, camera_m = sizes
    every = _to_camera(rig, np.stack(np.meshgrid(np.arange(float(_COLUMNS)), np.arange(float(_ROWS))), axis=-1).reshape(-1, 2))
    view = sample(pyramid(image), every.reshape(_ROWS, _COLUMNS, 2), unit_px)
    ground, seen = _on_ground(_widened(rig, every, wide), pose, map_image)
    seen &= map_image.contains(ground[:, :2])
    at = map_image.to_pixels(ground[:, :2]).reshape(_ROWS, _COLUMNS, 2)
    shown = sample(map_image.pyramid, at, wide * unit_px * camera_m / map_image.pixel_m)
    return view, np.where(seen.reshape(_ROWS, _COLUMNS), shown, np.float32(0.0))


def _to_camera(rig: StereoRig, px: Array) -> Array:
    width, height = rig.left.width, rig.left.height
    x, y = (px[:, 0] + 0.5) / _COLUMNS, (px[:, 1] + 0.5) / _ROWS
    u, v = (y, 1.0 - x) if width > height else (x, y)
    return np.column_stack((u * width, v * height)) - 0.5


def _widened(rig: StereoRig, px: Array, wide: float) -> Array:
    c = rig.left
    middle = 0.5 * (np.array([c.width, c.height]) - 1.0)
    px = middle + wide * (px - middle)
    return np.column_stack(((px[:, 0] - c.cx) / c.fx, (px[:, 1] - c.cy) / c.fy, np.ones(len(px))))


def _on_ground(rays: Array, pose: tuple[Array, Array], map_image: GroundImage) -> tuple[Array, Mask]:
    p_nc, R_nc = pose
    d = rays @ R_nc.T
    good: Mask = d[:, 2] > _STEEPEST * np.linalg.norm(d, axis=1)
    d[~good] = (0.0, 0.0, 1.0)
    down = np.full(len(d), float(map_image.heights.at(p_nc[None, :2])[0]))
    position: Array = np.zeros((len(d), 2))
    for _ in range(_TERMS):
        position, before = p_nc[:2] + d[:, :2] * ((down - p_nc[2]) / d[:, 2])[:, None], down
        down = map_image.heights.at(position)
        if np.abs(down - before).max() < _LEVEL_M:
            break
    good &= down > p_nc[2]
    return np.column_stack((position, down)), good
