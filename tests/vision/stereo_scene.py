"""Made-up images for the tests of the stages: a tilted textured board in front of a rectified rig, drawn ray by ray."""

import numpy as np

from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.image.rectify import Image

F, BASELINE = 500.0, 0.3
WIDTH, HEIGHT = 320, 240
RED, GREEN = (40.0, 50.0, 190.0), (70.0, 120.0, 80.0)


def rig(width: int = WIDTH, height: int = HEIGHT, shift_px: float = 0.0) -> StereoRig:
    """Rectified; shift_px: cx_r - cx_l."""
    left = CameraModel(width, height, F, F, (width - 1) / 2, (height - 1) / 2)
    right = CameraModel(width, height, F, F, (width - 1) / 2 + shift_px, (height - 1) / 2)
    return StereoRig(left, right, np.eye(3), np.array([-BASELINE, 0.0, 0.0]), np.eye(3), np.zeros(3))


def texture(x: Array, y: Array, seed: int) -> Array:
    """Smooth noise in [-1, 1] of points in metres."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(x)
    for (a, b), phase in zip(rng.normal(0.0, 14.0, (10, 2)), rng.uniform(0.0, 2.0 * np.pi, 10), strict=True):
        total += 0.3 * np.sin(a * x + b * y + phase)
    return total


def board(
    the_rig: StereoRig,
    depth_m: float = 10.0,
    size_m: tuple[float, float] = (1.6, 2.4),
    turn_rad: float = 0.3,
    slope: tuple[float, float] = (0.0, 0.0),
    noise: float = 1.0,
    seed: int = 1,
    ground_m: float = 12.0,
    contrast: float = 25.0,
    vertical_px: float = 0.0,
) -> tuple[Image, Image, Array]:
    """Left and right BGR image of a red rectangle on Z = depth + slope . (X, Y) before a green wall, and its corners (4, 3)."""
    rng = np.random.default_rng(seed)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    a, b = size_m
    flat = np.array([(-a, -b), (a, -b), (a, b), (-a, b)]) / 2.0
    e1 = np.array([1.0, 0.0, slope[0]])
    e1 /= np.linalg.norm(e1)
    normal = np.array([-slope[0], -slope[1], 1.0])
    normal /= np.linalg.norm(normal)
    e2 = np.cross(normal, e1)
    axes = np.stack((c * e1 + s * e2, -s * e1 + c * e2))
    corners = np.array([0.0, 0.0, depth_m]) + flat @ axes
    images = []
    for camera, x0, dv in ((the_rig.left, 0.0, 0.0), (the_rig.right, BASELINE, vertical_px)):
        fine = 3  # rays a pixel each way
        u, v = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in (camera.width, camera.height))
        rx, ry = np.meshgrid((u - camera.cx) / camera.fx, (v - dv - camera.cy) / camera.fy)
        along_ray = (normal[2] * depth_m - normal[0] * x0) / (rx * normal[0] + ry * normal[1] + normal[2])
        p = np.stack((rx * along_ray + x0, ry * along_ray, along_ray - depth_m), axis=-1)
        along, across = p @ axes[0], p @ axes[1]
        inside = (np.abs(along) < a / 2) & (np.abs(across) < b / 2)
        roof = np.array(RED) * (1.0 + contrast / 190.0 * texture(along, across, 3)[..., None])
        wall = np.array(GREEN) * (1.0 + 0.15 * texture(rx * ground_m + x0, ry * ground_m, 4)[..., None])
        light = np.where(inside[..., None], roof, wall)
        light = light.reshape(camera.height, fine, camera.width, fine, 3).mean(axis=(1, 3))
        images.append(np.clip(light + rng.normal(0.0, noise, light.shape), 0, 255).round().astype(np.uint8))
    return images[0], images[1], corners
