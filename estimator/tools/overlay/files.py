"""Cameras and map of a log: named, attached, or next to it."""

import tempfile
from pathlib import Path
from typing import NamedTuple

from calib.errors import CalibrationError
from calib.files.formats import load_cameras
from estimator.config import Config, ConfigError, read, recorded
from estimator.map_files import store as map_store
from logs.store.reader import Attachment
from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError

_MISSING = {  # by the names of attachments of landfix run
    "calibration": "neither holds nor names a calibration of its cameras; give one with --rig FILE",
    "map": "neither holds nor names a map of landmarks; give one with --map FILE",
}


class Scenery(NamedTuple):
    """Cameras and map."""

    rig: StereoRig
    landmarks: LandmarkMap


def configuration(log: Path, attachments: list[Attachment], given: Path | None) -> Config:
    """Configuration of a flight: the given file, else attached, else defaults."""
    return recorded(attachments, str(log)) if given is None else read(given)


def scenery(
    log: Path, attachments: list[Attachment], given: Path | None, rig_file: Path | None = None, map_file: Path | None = None
) -> Scenery:
    """Cameras and map: named, of the configuration, attached, or named by the attached one. Raises ConfigError."""
    config = configuration(log, attachments, given)
    with tempfile.TemporaryDirectory() as unpacked:
        attached = {kind: _unpacked(kind, attachments, Path(unpacked)) for kind in _MISSING}
        named = {kind: (given or log).parent / file for kind, file in config.files().items()}
        paths: dict[str, Path] = {}
        for kind, wanted in (("calibration", rig_file), ("map", map_file)):
            order = (named.get(kind), attached[kind]) if given else (attached[kind], named.get(kind))
            path = wanted or order[0] or order[1]
            if path is None:
                raise ConfigError(f"{log}: {_MISSING[kind]}")
            paths[kind] = path
        try:
            landmarks = map_store.load(paths["map"], Defaults(origin=config.map.origin))
            return Scenery(load_cameras(paths["calibration"]), landmarks)
        except (CalibrationError, MapError, ValueError) as error:
            raise ConfigError(str(error).replace(f"{unpacked}/", f"{log}, ")) from None
        except OSError as error:
            raise ConfigError(f"{error.filename}: cannot be read ({(error.strerror or 'unknown error').lower()})") from None


def _unpacked(kind: str, attachments: list[Attachment], folder: Path) -> Path | None:
    for attachment in attachments:
        if attachment.name.partition("/")[0] == kind:
            path = folder / Path(attachment.name).name
            path.write_bytes(attachment.data)
            return path
    return None
