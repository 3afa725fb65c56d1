"""What vision needs from disk: the rig file and the landmark map that the configuration names."""

from pathlib import Path

from calib.errors import CalibrationError
from calib.files import load_rig
from estimator import map_store
from estimator.sight import Sight
from estimator.strict_toml import ConfigError
from models.map_table import Defaults, MapError
from models.messages import Vec3


def load_sight(rig_file: Path, map_file: Path, origin: Vec3 | None) -> Sight:
    """Vision with these files, in the frame at `origin` (None: the map's own). Raises ConfigError, which names the file."""
    try:
        return Sight(load_rig(rig_file), map_store.load(map_file, Defaults(origin=origin)))
    except (CalibrationError, MapError, ValueError) as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{error.filename}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None


def map_origin(map_file: Path) -> Vec3:
    """Where the frame of a map lies. Raises ConfigError."""
    try:
        return map_store.origin(map_file)
    except MapError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{map_file}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None
