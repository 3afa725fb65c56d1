"""Images of a simulated flight, one random stream per pair.

pose at exposure:  p + v dt,  R exp(omega dt)
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from calib.files.formats import save_mounted, save_rig
from estimator.frontend.workers import pool
from logs.wire.cameras import LEFT_FRAME, RIGHT_FRAME
from logs.wire.encoding import Encoded
from logs.wire.images import Pixels, encode_image
from models import so3
from models.camera import StereoRig
from models.messages import Array
from models.sim.cameras import Cameras
from models.sim.scenario import EPOCH_NS, Simulation, Truth
from vision.synthetic import Conditions, Image, Scene, WorldSpec, blur_of_motion, make_rig, make_world, render, render_pair
from vision.synthetic.night import counts, night

LEFT, RIGHT = "/left/image", "/right/image"

_LOWEST_M: Final = 0.15  # camera above ground: what a vehicle stands on
_SWING_S: Final = 37.0  # period of the light's changes
_CHUNK: Final = 4  # pairs a process draws at a time


@dataclass(frozen=True)
class Flight:
    """A scene and the rig's poses; iteration renders the pairs."""

    cameras: Cameras
    scene: Scene
    truth: Truth
    seed: int
    t_ns: NDArray[np.int64]  # exposures

    def __len__(self) -> int:
        return (1 if self.cameras.one_camera else 2) * len(self.t_ns)

    def __iter__(self) -> Iterator[tuple[int, Encoded]]:
        delay_ns = round(self.cameras.delay_s * 1e9)
        with pool(None, partial(_begin, self)) as drawing:
            for t_ns, pair in zip(self.t_ns.tolist(), drawing.map(_draw, range(len(self.t_ns)), chunksize=_CHUNK), strict=True):
                for message in pair:
                    yield t_ns + delay_ns, message

    def write_map_and_rig(self, map_file: Path, rig_file: Path) -> None:
        """Files of the vehicle: map with errors, calibrated rig."""
        map_file.write_bytes(self.scene.map.to_geojson())
        (save_mounted if self.cameras.one_camera else save_rig)(rig_file, self.scene.rig_calibrated)

    def draw(self, k: int) -> tuple[Encoded, ...]:
        """The k-th pair or image."""
        cameras, t_ns, rng = self.cameras, int(self.t_ns[k]), np.random.default_rng([self.seed, k])
        since_s = (t_ns - EPOCH_NS) * 1e-9
        p_n, R_nb, v_n, omega_b = _pose(self.truth, t_ns)
        p_n = np.array([p_n[0], p_n[1], min(p_n[2], -_LOWEST_M - float(self.scene.rig.p_bc[2]))])
        world, rig, conditions = self.scene.world, self.scene.rig, self._conditions(since_s, p_n, R_nb, v_n, omega_b)
        if cameras.one_camera:
            images: tuple[Image, ...] = (render(world, rig.left, *rig.camera_pose(p_n, R_nb), conditions, rng),)
        else:
            images = render_pair(world, rig, p_n, R_nb, conditions, rng)
        quality = None if cameras.sees == "thermal" else cameras.jpeg_quality or None
        return tuple(
            encode_image(t_ns, _sensed(image, cameras), topic, jpeg_quality=quality, frame=frame)
            for image, topic, frame in zip(images, (LEFT, RIGHT), (LEFT_FRAME, RIGHT_FRAME), strict=False)
        )

    def _conditions(self, since_s: float, p_n: Array, R_nb: Array, v_n: Array, omega_b: Array) -> Conditions:
        cameras, rig = self.cameras, self.scene.rig
        R_nc = R_nb @ rig.R_bc
        depth = max(-float(p_n[2]) / max(float(R_nc[2, 2]), 0.2), 1.0)
        blur = blur_of_motion(rig.left.fx, R_nc.T @ v_n, rig.R_bc.T @ omega_b, depth, cameras.exposure_s)
        light = 1.0 + cameras.light_swing * math.sin(2.0 * math.pi * since_s / _SWING_S)
        dark = any(start <= since_s < end for start, end in cameras.dark_s)
        return Conditions(exposure=0.0 if dark else light, haze_per_m=cameras.haze_per_m, blur_px=blur)


def plan(cameras: Cameras, simulation: Simulation, seed: int) -> Flight:
    """Scene under a simulated flight, and the exposures. Raises ValueError without origin."""
    if simulation.origin is None:
        raise ValueError("cameras: their map needs a place on Earth")
    w = cameras.world
    spec = WorldSpec(
        layout=w.layout,
        area_m=w.area_m,
        spacing_m=w.spacing_m,
        clear_m=w.clear_m,
        painted=w.painted,
        unmapped=w.unmapped,
        gone=w.gone,
        sigma_m=w.sigma_m,
        height_sigma_m=w.height_sigma_m,
        outline_sigma_m=w.outline_sigma_m,
        origin=simulation.origin.lla,
        rig=_rig(cameras),
    )
    t_ns = simulation.truth.t_ns
    period_ns = round(1e9 / cameras.rate_hz)
    exposures = np.arange(int(t_ns[0]) + period_ns // 3, int(t_ns[-1]) - round(cameras.delay_s * 1e9), period_ns, dtype=np.int64)
    taken = np.ones(len(exposures), dtype=np.bool_)
    for start, end in cameras.outages_s:
        taken &= (exposures - EPOCH_NS < start * 1e9) | (exposures - EPOCH_NS >= end * 1e9)
    scene = make_world(w.seed, spec)
    if cameras.sees == "thermal":
        scene = scene._replace(world=night(scene.world, np.random.default_rng([w.seed, 1])))
    return Flight(cameras, scene, simulation.truth, seed, exposures[taken])


def configuration(cameras: Cameras, simulation: Simulation, map_name: str, rig_name: str) -> str:
    """The flight's configuration with images, map, rig."""
    right = "[]" if cameras.one_camera else f'"{RIGHT}"'
    text = simulation.config_toml.replace("[inputs]\n", f'[inputs]\nleft_image = "{LEFT}"\nright_image = {right}\n')
    odometry = "\n[visual_odometry]\nenabled = true\nground_m = 0.0\n" if cameras.odometry else ""
    return text.replace("[map]\n", f'[map]\nlandmarks = "{map_name}"\n') + f'\n[rig]\nfile = "{rig_name}"\n{odometry}'


def _sensed(image: Image, cameras: Cameras) -> Pixels:
    if cameras.sees == "thermal":
        return counts(image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if cameras.sees == "grey" else image


def _rig(cameras: Cameras) -> StereoRig:
    rig = make_rig(cameras.width, cameras.height, cameras.focal_px, cameras.baseline_m, cameras.pitch_deg)
    return msgspec.structs.replace(rig, one_camera=cameras.one_camera)


def _pose(truth: Truth, t_ns: int) -> tuple[Array, Array, Array, Array]:
    k = int(np.clip(np.searchsorted(truth.t_ns, t_ns, side="right") - 1, 0, len(truth.t_ns) - 1))
    dt = (t_ns - int(truth.t_ns[k])) * 1e-9
    turn = so3.matrix(so3.quat_exp(truth.omega_b[k] * dt))
    return truth.p_n[k] + truth.v_n[k] * dt, truth.R_nb[k] @ turn, truth.v_n[k], truth.omega_b[k]


_FLIGHT: list[Flight] = []  # of a drawing process


def _begin(flight: Flight) -> None:
    cv2.setNumThreads(1)
    _FLIGHT[:] = [flight]


def _draw(k: int) -> tuple[Encoded, ...]:
    return _FLIGHT[0].draw(k)
