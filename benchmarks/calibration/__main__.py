"""Calibration against known truth: are errors what the reported sigmas say, on corners, on rendered images, on recordings?

    python -m benchmarks.calibration corners flexing rendered shaded camera-imu [--runs 50]

Writes out/bench_calibration/PART.json and prints a table each.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import chi2

from calib.board.chessboard import Board, View, find
from calib.cameras import mono, stereo
from calib.cameras.bundle import IDENTITY
from calib.cameras.stereo import Pair
from calib.inertial import camera_imu
from calib.synthetic import motion
from calib.synthetic import views as synthetic
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array

OUT = Path("out/bench_calibration")
BOARD = Board(9, 6, 0.025)
VGA = CameraModel(640, 480, 533.0, 534.0, 342.0, 234.0, (-0.28, 0.06, 0.001, -0.0002, 0.05))
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def rig() -> StereoRig:
    """A rig like the one of the real images."""
    right = CameraModel(640, 480, 537.0, 536.5, 327.0, 249.0, (-0.29, 0.1, -0.0009, 0.0003, -0.01))
    R_rc = so3.matrix(so3.quat_exp(np.deg2rad([0.4, 0.25, -0.2])))
    return StereoRig(VGA, right, R_rc, np.array([-0.083, 0.001, -0.0002]), np.eye(3), np.zeros(3))


def consistency(names: tuple[str, ...], errors: list[Array], covariances: list[Array]) -> dict[str, Any]:
    """Means and scatters of error / sigma, and NEES over all parameters with its 95 % band; errors true minus estimated."""
    e, C = np.array(errors), np.array(covariances)
    z = e / np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    nees = np.array([x @ np.linalg.solve(P, x) for x, P in zip(e, C, strict=True)])
    runs, n = e.shape
    low, high = chi2.ppf((0.025, 0.975), runs * n) / (runs * n)
    per_parameter = {
        name: {
            "rms_error": float(np.sqrt(np.mean(e[:, k] ** 2))), "rms_sigma": float(np.sqrt(np.mean(C[:, k, k]))),
            "z_mean": float(z[:, k].mean()), "z_mean_times_sqrt_runs": float(z[:, k].mean() * np.sqrt(runs)),
            "z_rms": float(np.sqrt(np.mean(z[:, k] ** 2))), "worst": float(np.abs(e[:, k]).max()),
        }
        for k, name in enumerate(names)
    }  # fmt: skip
    z_low, z_high = np.sqrt(chi2.ppf((0.025, 0.975), runs) / runs)
    return {
        "runs": runs, "nees_per_dof": float(nees.mean() / n), "nees_band_95": [float(low), float(high)],
        "z_rms_band_95": [float(z_low), float(z_high)], "parameters": per_parameter,
    }  # fmt: skip


def _camera_error(truth: CameraModel, found: CameraModel) -> Array:
    numbers = [np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion]) for c in (truth, found)]
    return np.asarray(numbers[0] - numbers[1])


def _stereo_error(truth: StereoRig, found: StereoRig) -> Array:
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(truth.R_rc @ found.R_rc.T)))
    return np.concatenate((truth.t_rc - found.t_rc, turn))


def corners(runs: int) -> dict[str, Any]:
    """Mono and stereo on exact corners with white noise of 0.2 px."""
    mono_e, mono_C, stereo_e, stereo_C, widened = [], [], [], [], []
    truth = rig()
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        poses = synthetic.poses(synthetic.both(truth), BOARD, 20, rng)
        views = [
            [
                synthetic.seen(c, type(p)(place.R @ p.R, place.of(p.t[None])[0]), BOARD, rng, 0.2, str(k))
                for k, p in enumerate(poses)
            ]
            for c, place in synthetic.both(truth)
        ]
        one = mono.calibrate(views[0], BOARD)
        both = stereo.calibrate([Pair(*p) for p in zip(*views, strict=True)], BOARD)
        mono_e.append(_camera_error(VGA, one.camera))
        mono_C.append(_some(one.camera.covariance))
        stereo_e.append(_stereo_error(truth, both.rig))
        stereo_C.append(_some(both.rig.covariance_rc))
        widened.append((one.solution.widened, both.solution.widened))
    share = np.mean(np.array(widened) > 1.0, axis=0)
    return {
        "mono": consistency(CAMERA_NAMES, mono_e, mono_C), "stereo": consistency(POSE_NAMES, stereo_e, stereo_C),
        "share_widened": share.tolist(),
    }  # fmt: skip


def flexing(runs: int) -> dict[str, Any]:
    """One camera, a board that flexes in the hand: in each view another parabola of 0.2 mm (one sigma), corners with 0.05 px."""
    x, y = (2.0 * BOARD.points[:, :2] / BOARD.points[:, :2].max(axis=0) - 1.0).T
    modes, errors, covariances, widened = np.column_stack((x * x, x * y, y * y)), [], [], []
    for seed in range(runs):
        rng, views = np.random.default_rng(seed), []
        for k, pose in enumerate(synthetic.poses([(VGA, IDENTITY)], BOARD, 13, rng)):
            bent = np.column_stack((BOARD.points[:, :2], modes @ rng.normal(0.0, 2e-4, 3)))
            px = VGA.project(pose.of(bent)) + rng.normal(0.0, 0.05, (len(bent), 2))
            views.append(View(str(k), VGA.width, VGA.height, np.arange(len(px)), px, 2.0))
        found = mono.calibrate(views, BOARD)
        errors.append(_camera_error(VGA, found.camera))
        covariances.append(_some(found.camera.covariance))
        widened.append(found.solution.widened)
    return {**consistency(CAMERA_NAMES, errors, covariances), "widened": float(np.sqrt(np.mean(widened)))}


def shaded(runs: int) -> dict[str, Any]:
    """One camera on rendered images whose corners get a quarter of the light; noise 3 grey levels, blur 0.7 px."""
    painter, (v, u) = synthetic.Painter(VGA, BOARD), np.mgrid[0 : VGA.height, 0 : VGA.width]
    middle = 0.5 * np.array([VGA.width, VGA.height])
    light = 1.0 - 0.75 * ((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (middle @ middle)
    errors, covariances, off = [], [], []
    for seed in range(runs):
        rng, views = np.random.default_rng(seed), []
        for k, pose in enumerate(synthetic.poses([(VGA, IDENTITY)], BOARD, 15, rng)):
            image = painter.paint(pose, rng, 0.0, 0.7) * light + rng.normal(0.0, 3.0, light.shape)
            seen = find(np.asarray(np.clip(np.rint(image), 0, 255), dtype=np.uint8), BOARD, str(k))
            if isinstance(seen, View):
                views.append(seen)
                off.append(seen.px - VGA.project(pose.of(BOARD.points)))
        found = mono.calibrate(views, BOARD)
        errors.append(_camera_error(VGA, found.camera))
        covariances.append(_some(found.camera.covariance))
    rms = float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    return {**consistency(CAMERA_NAMES, errors, covariances), "corner_rms_px": rms}


def rendered(runs: int) -> dict[str, Any]:
    """Stereo on rendered pairs through the corner finder: noise 3 grey levels, blur 0.7 px."""
    truth = rig()
    painters = [synthetic.Painter(c, BOARD) for c in (truth.left, truth.right)]
    stereo_e, stereo_C, left_e, left_C, right_e, right_C, rms, widened = [], [], [], [], [], [], [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        pairs = []
        for k, pose in enumerate(synthetic.poses(synthetic.both(truth), BOARD, 15, rng)):
            seen = []
            for painter, (_, place) in zip(painters, synthetic.both(truth), strict=True):
                image = painter.paint(type(pose)(place.R @ pose.R, place.of(pose.t[None])[0]), rng, 3.0, 0.7)
                seen.append(find(image, BOARD, str(k)))
            if isinstance(seen[0], View) and isinstance(seen[1], View):
                pairs.append(Pair(seen[0], seen[1]))
        result = stereo.calibrate(pairs, BOARD)
        stereo_e.append(_stereo_error(truth, result.rig))
        stereo_C.append(_some(result.rig.covariance_rc))
        left_e.append(_camera_error(VGA, result.rig.left))
        left_C.append(_some(result.rig.left.covariance))
        right_e.append(_camera_error(truth.right, result.rig.right))
        right_C.append(_some(result.rig.right.covariance))
        rms.append(result.solution.rms)
        widened.append(result.solution.widened)
    return {
        "left": consistency(CAMERA_NAMES, left_e, left_C), "right": consistency(CAMERA_NAMES, right_e, right_C),
        "stereo": consistency(POSE_NAMES, stereo_e, stereo_C),
        "rms_px": float(np.mean(rms)), "share_widened": float(np.mean(np.array(widened) > 1.0)),
    }  # fmt: skip


def camera_imu_runs(runs: int, first: int = 0) -> dict[str, Any]:
    """Camera on an IMU of EuRoC's noise, 60 s of motion at 20 Hz, corners with 0.15 px."""
    camera = CameraModel(752, 480, 458.654, 457.296, 367.215, 248.375, (-0.283, 0.074, 2e-4, 1.8e-5))
    forward = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    errors, covariances, squares = [], [], []
    for seed in range(first, first + runs):
        rng = np.random.default_rng(seed)
        turn = so3.matrix(so3.quat_exp(rng.normal(0.0, 0.3, 3)))
        truth = motion.Truth(turn @ forward, rng.uniform(-0.1, 0.1, 3), float(rng.uniform(-0.05, 0.05)))
        recording, stamps, views, _ = motion.record(truth, camera, BOARD, motion.EUROC_NOISE, rng)
        r = camera_imu.calibrate(recording, stamps, views, BOARD, camera, motion.EUROC_NOISE)
        rotation = so3.quat_log(so3.from_matrix(np.ascontiguousarray(truth.R_bc @ r.R_bc.T)))
        errors.append(np.concatenate((truth.p_bc - r.p_bc, rotation, [truth.time_offset_s - r.time_offset_s])))
        covariances.append(r.covariance)
        squares.append(r.mean_square)
    return {**consistency((*POSE_NAMES, "offset_s"), errors, covariances), "mean_square": float(np.mean(squares))}


def _some(covariance: Array | None) -> Array:
    assert covariance is not None
    return covariance


def main() -> None:
    """Run the parts named."""
    parts: dict[str, Callable[[int], dict[str, Any]]] = {
        "corners": corners, "flexing": flexing, "rendered": rendered, "shaded": shaded, "camera-imu": camera_imu_runs,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=list(parts))
    parser.add_argument("--runs", type=int, default=50)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    for part in arguments.parts:
        began = time.perf_counter()
        result = parts[part](arguments.runs)
        result["seconds"] = round(time.perf_counter() - began, 1)
        text = json.dumps(result, indent=1)
        (OUT / f"{part}.json").write_text(text)
        print(text)


if __name__ == "__main__":
    main()
