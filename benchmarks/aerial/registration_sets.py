"""Sets for registration: a video, photos, rendered ground."""

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.aerial import brighton, nust
from benchmarks.aerial.trials import Spread, generator, nadir_rig
from estimator.map_files import image as image_store
from estimator.map_files.image_file import ImageFile
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.image import GroundImage, Heights
from vision.ground.learned import Learned, Model
from vision.image.rectify import Image
from vision.recognisers import MapImage
from vision.synthetic import Conditions, Sun, World, WorldSpec, draw_rig, make_rig, make_world, render
from vision.synthetic.texture import bounded, pyramid, texels_a_side

EVERY = 15  # th frame of the video
NEAR = Spread(30.0, 5.0, math.radians(1.0), math.radians(2.0))
WIDE = Spread(100.0, 5.0, math.radians(1.0), math.radians(2.0))
LOW = Spread(15.0, 2.0, math.radians(1.0), math.radians(2.0))
_FRAME_NS = 33_366_700
_ORTHO_M, _ORTHO_PX, _ORTHO_FROM_M = 0.3, 1000, 5000.0  # of rendered ground: nearly straight from above
SAME_DAY, OTHER_SUN = "rendered, the same day", "rendered, sun from the other side"
OTHER_SEASON = "rendered, another season"
_OVERCAST = Sun(0.0, math.radians(60.0), 0.85)


@dataclass(frozen=True)
class Shot:
    """An image, the pose it was taken from, and its prior. reference_m: standard deviation of what that pose is judged by."""

    t_ns: int
    image: Image
    p_n: Array
    R_nb: Array
    prior: Prior
    reference_m: float = 0.0


@dataclass(frozen=True)
class Taken:
    """An image and the pose it was taken from, by a reference that is good to so much on the ground."""

    t_ns: int
    image: Image
    p_n: Array
    R_nb: Array
    reference_m: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Images of one rig in their order, and the map of their place."""

    rig: StereoRig
    known: MapImage
    taken: list[Taken]


@dataclass(frozen=True)
class Flight:
    """Images in their order over one map."""

    group: str
    rig: StereoRig
    known: MapImage
    shots: Callable[[], Iterator[Shot]]


def flights(name: str, data: Path, seed: int, out: Path) -> Iterator[Flight]:
    """Those of a set."""
    if name == "nust":
        yield from _nust(data, seed)
    elif name == "brighton":
        yield from _brighton(data, seed, out)
    else:
        for number in range(3):
            for group, scene in village(10 * seed + number).items():
                yield Flight(group, scene.rig, scene.known, shots(scene, NEAR, (10 * seed + number, group, 0)))


def _nust(data: Path, seed: int) -> Iterator[Flight]:
    """The error of the prior lasts over the flight, as a filter's does."""
    scene = nust_scene(data, 0)
    yield Flight("NUST, prior off by up to 30 m", scene.rig, scene.known, shots(scene, NEAR, (seed, "nust", 0)))
    yield Flight("NUST, prior off by up to 100 m", scene.rig, scene.known, shots(scene, WIDE, (seed, "nust", 1)))


def nust_file(data: Path) -> ImageFile:
    """The orthophoto, with its errors."""
    return ImageFile(data / nust.FOLDER / "orthophoto_0.5m_epsg32643.tif", 0.5, None, 1.0)


def nust_scene(data: Path, after: int) -> Scene:
    """The frames that have a reference, `after` frames after every 15th."""
    landmarks = nust.landmark_map()
    known = image_store.load(nust_file(data), landmarks.origin)
    registered = nust.registrations(data)
    wanted = [number for number in registered if number % EVERY == after]
    rig = nadir_rig(nust.camera())
    taken = []
    for number, image in nust.frames(data, wanted):
        p_nc, R_nc = nust.pose(registered[number], landmarks)
        taken.append(Taken(number * _FRAME_NS, image, p_nc, R_nc @ rig.R_bc.T, nust.REFERENCE_M))
    return Scene(rig, known, taken)


def _brighton(data: Path, seed: int, out: Path) -> Iterator[Flight]:
    """The photos from which the orthophoto was made: light and season are the same, it shows no more than that it works."""
    scene = brighton_scene(data, out)
    yield Flight("Brighton, prior off by up to 15 m", scene.rig, scene.known, shots(scene, LOW, (seed, "brighton", 0)))


def brighton_scene(data: Path, out: Path) -> Scene:
    """The 18 photos. The reference was found with the same camera: its errors would show nowhere, so it counts as exact."""
    landmarks = brighton.landmark_map()
    known = image_store.load(brighton_files(data, out), landmarks.origin)
    rig = nadir_rig(msgspec.structs.replace(brighton.camera(), covariance=None))
    taken = []
    for k, (name, where) in enumerate(brighton.references(data, landmarks, brighton.photo_names(data)).items()):
        sigma_m = float(np.linalg.norm(where.sigma_m[:2])) / math.sqrt(2.0)
        taken.append(Taken(k * 7_000_000_000, brighton.photo(data, name), where.p_nc, where.R_nc @ rig.R_bc.T, sigma_m))
    return Scene(rig, known, taken)


def brighton_files(data: Path, out: Path) -> ImageFile:
    """The set's orthophoto and heights as files that a configuration can name."""
    out.mkdir(parents=True, exist_ok=True)
    with np.load(data / brighton.FOLDER / "dsm_0.1m_utm15n.npz") as archive:
        heights, x0, y1, step = archive["dsm"], float(archive["x0"]), float(archive["y1"]), float(archive["res"])
    image, raster = out / "ortho.png", out / "dsm.tif"
    shutil.copyfile(data / brighton.FOLDER / "ortho_0.1m_utm15n.png", image)
    cv2.imwrite(str(raster), heights.astype(np.float32))
    for path in (image.with_suffix(".pgw"), raster.with_suffix(".tfw")):
        path.write_text(f"{step} 0 0 {-step} {x0} {y1}")
    return ImageFile(image, 0.2, None, 0.5, raster, brighton.EPSG)


def village(seed: int) -> dict[str, Scene]:
    """A village seen by an orthophoto on one day, and by a camera on that day, on another one, and in another season.

    Each image has another camera, whose errors are drawn from what its calibration says of them.
    """
    scene = make_world(seed, WorldSpec(painted=0.0))
    rig, rng = make_rig(), np.random.default_rng(seed)
    known = MapImage.of(_orthophoto(scene.world, rng))
    opposite = Sun(scene.world.sun.azimuth_rad + math.pi, math.radians(28.0), 0.3)
    worlds = {
        SAME_DAY: (scene.world, Conditions()),
        OTHER_SUN: (replace(scene.world, sun=opposite), Conditions(exposure=0.8)),
        OTHER_SEASON: (_other_season(scene.world), Conditions(haze_per_m=0.001, cast_bgr=(1.1, 1.0, 0.9))),
    }
    scenes = {}
    for group, (world, conditions) in worlds.items():
        taken = []
        for k in range(20):
            p_n = np.array([*rng.uniform(-60.0, 60.0, 2), -rng.uniform(90.0, 140.0)])
            R_nb = so3.matrix(so3.from_euler(rng.normal(0.0, 0.05), rng.normal(0.0, 0.05), rng.uniform(-math.pi, math.pi)))
            true = draw_rig(rig, rng)
            image = render(world, true.left, *true.camera_pose(p_n, R_nb), conditions, rng)
            taken.append(Taken(k * 500_000_000, image, p_n, R_nb))
        scenes[group] = Scene(rig, known, taken)
    return scenes


def _orthophoto(world: World, rng: np.random.Generator) -> GroundImage:
    """From so far up that roofs lean by little more than a pixel; north up."""
    middle, f = 0.5 * (_ORTHO_PX - 1), _ORTHO_FROM_M / _ORTHO_M
    above = CameraModel(_ORTHO_PX, _ORTHO_PX, f, f, middle, middle)
    image = render(world, above, np.array([0.0, 0.0, -_ORTHO_FROM_M]), nadir_rig(above).R_bc, Conditions(vignetting=0.0), rng)
    affine = np.array([[0.0, -_ORTHO_M, _ORTHO_M * middle], [_ORTHO_M, 0.0, -_ORTHO_M * middle]])
    return GroundImage("ortho", image, affine, Heights.level(world.ground.down_m), 0.1, 0.1)


def _other_season(world: World) -> World:
    """Fields that were bright are dark, other grass has grown, trees are bare and pale, an overcast sky casts faint shadows."""
    ground = world.ground
    mean = ground.cover[-1]
    side = texels_a_side(ground.detail)
    grass = ground.detail[: side * side].reshape(side, side)
    other = pyramid(bounded(np.ascontiguousarray(grass[::-1].T)))
    cover = np.clip(2.0 * mean - ground.cover, 10.0, 250.0).astype(np.float32)
    clutter = tuple(
        replace(s, appearance=replace(s.appearance, roof_bgr=(120.0, 135.0, 140.0))) if s.appearance.texture == "leaves" else s
        for s in world.clutter
    )
    return replace(world, ground=replace(ground, cover=cover, detail=other), clutter=clutter, sun=_OVERCAST)


def turned(known: MapImage, turn: int) -> MapImage:
    """The same georeference over an image that is turned about its middle, as far as the new one covers the same pixels."""
    ground = known.image
    image = np.asarray(cv2.rotate(ground.image, turn), dtype=np.uint8)
    return MapImage.of(replace(ground, image=image))


def learned_models(data: Path) -> Learned | None:
    """XFeat and LighterGlue, where the data has them."""
    files = [data / "models" / name for name in ("xfeat_1024_640x360.onnx", "lighterglue_L3.onnx")]
    if not all(file.is_file() for file in files):
        return None
    extractor, matcher = (Model(file.name, file.read_bytes()) for file in files)
    return Learned(extractor, matcher)


def shots(
    scene: Scene, spread: Spread, key: tuple[int, str, int], away: tuple[float, float] = (0.0, 0.0)
) -> Callable[[], Iterator[Shot]]:
    """Errors drawn anew every 3 s of the flight, so that images within share them; away: the prior is so much farther off, m.

    The map's own error is drawn for each image, since references come from the same map.
    """
    sigma_m = scene.known.image.sigma_m

    def drawn() -> Iterator[Shot]:
        rng = generator(*key)
        until_ns = -1
        for taken in scene.taken:
            if taken.t_ns >= until_ns:
                off, until_ns = spread.draw(rng, np.zeros(3), np.eye(3)), taken.t_ns + 3_000_000_000
                bearing, farther = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*away)
            p_n = taken.p_n + np.append(rng.normal(0.0, sigma_m, 2), 0.0)
            there = p_n + off.p_n + farther * np.array([math.cos(bearing), math.sin(bearing), 0.0])
            q = so3.normalise(so3.multiply(off.q_nb_wxyz, so3.from_matrix(np.ascontiguousarray(taken.R_nb))))
            yield Shot(taken.t_ns, taken.image, p_n, taken.R_nb, Prior(there, q, off.covariance), taken.reference_m)

    return drawn
