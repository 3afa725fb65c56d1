"""Vision's files: rig, landmark map, map image."""

from pathlib import Path

from calib.errors import CalibrationError
from calib.files.formats import load_cameras
from estimator.frontend.odometry import OdometryProcessor
from estimator.frontend.processor import Processor
from estimator.map_files import image as image_store
from estimator.map_files import store as map_store
from estimator.map_files.image_file import ImageFile
from estimator.strict_toml import ConfigError
from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError
from models.messages import Vec3


def load_processor(rig_file: Path, map_file: Path | None, origin: Vec3 | None, image: ImageFile | None = None) -> Processor:
    """Vision with these files, in the frame at `origin` (None: the map's). Raises ConfigError."""
    try:
        if map_file:
            landmarks = map_store.load(map_file, Defaults(origin=origin))
        else:
            landmarks = LandmarkMap.from_landmarks(origin or _image_origin(image), [])
        known = image_store.load(image, landmarks.origin) if image else None
        return Processor(load_cameras(rig_file), landmarks, known)
    except (CalibrationError, MapError, ValueError) as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{error.filename}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None


def load_odometry(rig_file: Path) -> OdometryProcessor:
    """Visual odometry with these cameras. Raises ConfigError."""
    try:
        return OdometryProcessor(load_cameras(rig_file))
    except (CalibrationError, ValueError) as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{error.filename}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None


def map_origin(map_file: Path | None, image: ImageFile | None = None) -> Vec3:
    """Origin of a map: of its landmarks, else of its image. Raises ConfigError."""
    try:
        return map_store.load(map_file).origin if map_file else _image_origin(image)
    except MapError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{map_file}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None


def _image_origin(image: ImageFile | None) -> Vec3:
    if image is None:
        raise ConfigError("[map]: neither landmarks nor an image")
    return image_store.origin(image)
