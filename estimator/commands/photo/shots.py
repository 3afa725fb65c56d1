"""Input of landfix locate: rig and images, with priors by --prior or by tags (then the body is the camera)."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
import typer

from calib.errors import CalibrationError
from calib.files.formats import BodyPose, load_cameras
from estimator.commands.common import image_source
from estimator.commands.photo import fitted
from estimator.commands.photo.camera import camera_of
from estimator.commands.photo.pose import DOWN, prior_of
from estimator.commands.photo.tags import Tags, read
from models import so3
from models.camera import StereoRig
from models.frames import Origin
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import Image

_WIDTH: Final = 800  # px of a photo whose camera is known by its tags: from 100 m a pixel is 0.1 to 0.2 m, as good as maps are
_MOST_FRAMES: Final = 60  # of a video
_APART_NS = 1_000_000_000  # of images, whose time is not given
_ONE_FLIGHT_S: Final = 60.0  # photos that are farther apart confirm nothing: their priors' errors are not the same
_OTHER_FLIGHT_NS = 1000 * _APART_NS
_WIDEST_M = 1e7  # a quarter of the way around the Earth
_USUAL_SIGMA = "10,2"
_BY_AXIS: Final = 4  # numbers of --prior-sigma: horizontal, vertical, tilt, heading


class Given(NamedTuple):
    """Options."""

    files: Sequence[Path]
    rig: Path | None
    mount: BodyPose | None
    prior: Sequence[str]
    prior_sigma: str
    height_m: float | None
    camera_pitch_deg: float | None
    width: int | None


class Shot(NamedTuple):
    """follows: a video frame, prior at the last fix."""

    name: str
    t_ns: int
    left: Image
    right: Image | None
    prior: Prior
    follows: bool = False


class Shots(NamedTuple):
    """Images one by one, at most `total`; remarks: assumptions."""

    rig: StereoRig
    total: int
    images: Iterator[Shot]
    remarks: list[str]


def numbers(text: str, count: int, option: str, example: str) -> list[float]:
    """`count` numbers separated by commas. Raises BadParameter."""
    try:
        found = [float(x) for x in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise typer.BadParameter(f"{option} '{text}' must be {count} numbers with commas between, as in {example}")
    return found


def check(given: Given) -> None:
    """Wrong usage, before a file is read. Raises BadParameter."""
    for text in given.prior:
        lat, lon, *_ = numbers(text, 6, "--prior", "47.3977,8.5456,560,0,0,90")
        if not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
            raise typer.BadParameter(f"--prior: latitude {lat:g}, longitude {lon:g} is no place on Earth")
    *metres, tilt, heading = _sigmas(given.prior_sigma)
    if not (all(0.0 < m <= _WIDEST_M for m in metres) and 0.0 < tilt <= 180.0 and 0.0 < heading <= 180.0):
        raise typer.BadParameter(f"--prior-sigma must be positive, at most {_WIDEST_M:.0f} m and 180 degrees")
    if not given.prior and given.mount is not None:
        raise typer.BadParameter("--mount is for --prior: the angles in a photo's tags are those of the camera itself")
    if given.prior and given.height_m is not None:
        raise typer.BadParameter("--height-m is for photos with tags: --prior has a height of its own")
    if given.prior and given.camera_pitch_deg is not None:
        raise typer.BadParameter("--camera-pitch is for photos with tags: --prior has angles of its own")


def take(given: Given, frame: Origin, ground_d: Callable[[float, float], float]) -> Shots:
    """ground_d(north, east): down of the ground. Raises CalibrationError, BadParameter."""
    files = [Path(name) for name in image_source.files_of([str(path) for path in given.files])]
    if given.rig is not None and given.prior:
        rig = load_cameras(given.rig, given.mount)
        if not rig.one_camera:
            return _of_rig(rig, files, given, frame)
    videos = [path for path in files if image_source.is_video(path)]
    if videos and (given.rig is None or not given.prior):
        raise CalibrationError(f"{videos[0]}: a video has no tags: give --rig with --mount, and --prior")
    if len(given.prior) > 1 and (videos or len(given.prior) != len(files)):
        counted = "a video" if videos else f"{len(files)} photos"
        raise typer.BadParameter(f"--prior given {len(given.prior)} times for {counted}: give one for all, or one for each")
    tags = {path: read(path) for path in files} if given.rig is None or not given.prior else {}
    remarks: list[str] = []
    rig = _rig(files[0], given, tags, remarks)
    turns = [0 if path in videos else fitted.quarter_turns(path) for path in files]
    if given.prior and given.mount is None:
        turned = rig
    else:
        turned = msgspec.structs.replace(rig, R_bc=fitted.turned_mount(rig.R_bc, _one_turn(rig, files, turns)))
    priors = _priors(files, given, tags, frame, ground_d, remarks)
    total = len(files) - len(videos) + _MOST_FRAMES * len(videos)
    return Shots(turned, total, _photos(turned, files, turns, priors, tags), remarks)


def _of_rig(rig: StereoRig, files: list[Path], given: Given, frame: Origin) -> Shots:
    if len(files) > 2:
        raise typer.BadParameter(
            f"{len(files)} files: a rig of two cameras takes LEFT [RIGHT]; several photos are for one camera"
        )
    if len(given.prior) > 1:
        raise typer.BadParameter(f"--prior given {len(given.prior)} times for 1 photos: give one for all, or one for each")
    cameras = rig.left, rig.right
    images = [
        fitted.fitted(path, image_source.read_image(path), camera, 0)[0] for path, camera in zip(files, cameras, strict=False)
    ]
    prior = _prior(given.prior[0], given.prior_sigma, frame)
    shot = Shot(str(files[0]), 0, images[0], images[1] if len(images) == 2 else None, prior)
    return Shots(rig, 1, iter([shot]), [])


def _rig(first: Path, given: Given, tags: dict[Path, Tags], remarks: list[str]) -> StereoRig:
    mount = given.mount
    if given.rig is not None:
        rig = load_cameras(given.rig, mount if given.prior else BodyPose(DOWN, np.zeros(3), np.zeros((6, 6))))
        if not rig.one_camera:
            raise CalibrationError(f"{given.rig}: a rig of two cameras needs --prior: tags are of one camera")
        camera = rig.left if given.width is None else fitted.at_width(rig.left, given.width)
        return StereoRig.of_one(camera, rig.R_bc, rig.p_bc, rig.covariance_bc if given.prior else None)
    if given.prior and mount is None:
        raise CalibrationError(
            "--prior needs --mount X,Y,Z,ROLL,PITCH,YAW: 0,0,0,0,-90,0 looks down, the photo's upper edge forward"
        )
    camera, source, sigma = camera_of(tags[first], given.width or min(_WIDTH, tags[first].width), str(first))
    other = next((p for p, t in tags.items() if _camera_key(t) != _camera_key(tags[first])), None)
    if other is not None:
        raise CalibrationError(f"{other}: of another camera or size than {first}: locate them one by one")
    remarks.append(
        f"camera by its tag {source}: focal length {camera.fx / camera.width:.3f} of the width, {100.0 * sigma:g} % uncertain "
        "(landfix calibrate mono knows it better: --rig)"
    )
    if mount is None:
        return StereoRig.of_one(camera, DOWN, np.zeros(3), None)
    return StereoRig.of_one(camera, *mount)


def _camera_key(tags: Tags) -> tuple[object, ...]:
    return tags.make, tags.model, tags.width, tags.height, tags.focal_mm, tags.focal_35_mm, tags.focal_px, tags.dewarp


def _one_turn(rig: StereoRig, files: list[Path], turns: list[int]) -> int:
    left = {fitted.turns_left(path, rig.left, n) for path, n in zip(files, turns, strict=True)}
    if len(left) > 1:
        raise CalibrationError(
            f"{files[0]} and others: the photos' EXIF orientations differ, so that --mount is not the same for all: "
            "locate them one by one"
        )
    return left.pop()


def _priors(
    files: list[Path],
    given: Given,
    tags: dict[Path, Tags],
    frame: Origin,
    ground_d: Callable[[float, float], float],
    remarks: list[str],
) -> list[Prior]:
    if given.prior:
        priors = [_prior(text, given.prior_sigma, frame) for text in given.prior]
        return priors * (len(files) if len(priors) == 1 else 1)
    priors = [prior_of(tags[path], frame, ground_d, given.height_m, str(path), given.camera_pitch_deg) for path in files]
    if given.prior_sigma:
        priors = [Prior(prior.p_n, prior.q_nb_wxyz, _covariance(given.prior_sigma)) for prior in priors]
    edited = [path for path, t in tags.items() if t.edited_by]
    if edited:
        others = f" (and {len(edited) - 1} others)" if len(edited) > 1 else ""
        remarks.append(
            f"{edited[0]}{others}: saved by {tags[edited[0]].edited_by}, which may have turned or cropped it without a trace in "
            "its tags"
        )
    return priors


def _prior(text: str, sigma: str, frame: Origin) -> Prior:
    lat, lon, alt, *angles = numbers(text, 6, "--prior", "47.3977,8.5456,560,0,0,90")
    q = so3.from_euler(*(math.radians(angle) for angle in angles))
    return Prior(np.array(frame.to_ned(lat, lon, alt)), q, _covariance(sigma))


def _sigmas(text: str) -> list[float]:
    """Horizontal, vertical [m], tilt, heading [deg]. Raises BadParameter."""
    if text.count(",") == _BY_AXIS - 1:
        return numbers(text, _BY_AXIS, "--prior-sigma", "10,5,1,3")
    metres, degrees = numbers(text or _USUAL_SIGMA, 2, "--prior-sigma", _USUAL_SIGMA)
    return [metres, metres, degrees, degrees]


def _covariance(sigma: str) -> Array:
    horizontal, vertical, tilt, heading = _sigmas(sigma)
    return np.diag(np.array([horizontal, horizontal, vertical, *np.radians([tilt, tilt, heading])]) ** 2)


def _photos(rig: StereoRig, files: list[Path], turns: list[int], priors: list[Prior], tags: dict[Path, Tags]) -> Iterator[Shot]:
    t_ns, before = 0, None
    for path, turn, prior in zip(files, turns, priors, strict=True):
        taken = tags[path].taken_s if path in tags else None
        if taken is not None and before is not None and abs(taken - before) > _ONE_FLIGHT_S:
            t_ns += _OTHER_FLIGHT_NS
        before = taken
        for image in image_source.read_images([str(path)], "", _MOST_FRAMES):
            if image.fault:
                raise CalibrationError(f"{path}: {image.fault}")
            name = image.name if image_source.is_video(path) else str(path)
            seen = fitted.fitted(path, image.image, rig.left, turn)[0]
            yield Shot(name, t_ns, seen, None, prior, image_source.is_video(path))
            t_ns += _APART_NS
