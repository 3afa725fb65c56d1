"""Keypoints of a map's image, cached as NAME.keypoints.npz for its content and method."""

import hashlib
import os
import zipfile
from contextlib import suppress
from pathlib import Path

import cv2
import msgspec
import numpy as np

from models.messages import Array
from vision.ground.features import Descriptors, FeatureConfig, map_keypoints
from vision.ground.image import GroundImage

_VERSION = 1


def keypoints(path: Path, image: GroundImage, config: FeatureConfig | None = None) -> tuple[Array, Descriptors]:
    """Pixels (N, 2) and descriptors (N, 128), cached."""
    config = config or FeatureConfig()
    key, file = _key(image, config), path.with_name(f"{path.name}.keypoints.npz")
    kept = _read(file, key, image)
    if kept is None:
        kept = map_keypoints(image.pyramid, config)
        with suppress(OSError):
            _write(file, key, *kept)
    return kept


def _key(image: GroundImage, config: FeatureConfig) -> str:
    grey = image.pyramid[0]
    way = msgspec.json.encode((_VERSION, cv2.__version__, grey.shape, config.most_in_map, config.longest_map))
    return hashlib.sha256(way + np.ascontiguousarray(grey).tobytes()).hexdigest()


def _read(file: Path, key: str, image: GroundImage) -> tuple[Array, Descriptors] | None:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            if str(archive["key"]) != key:
                return None
            px, descriptors = archive["px"], archive["descriptors"]
    except (OSError, ValueError, KeyError, EOFError, TypeError, MemoryError, zipfile.BadZipFile):
        return None
    height, width = image.pyramid[0].shape
    sound = px.dtype == np.float64 and descriptors.dtype == np.uint8 and px.shape[1:] == (2,)
    if not sound or descriptors.shape != (len(px), 128) or not np.all((px > -1.0) & (px < (width, height))):
        return None
    return px, descriptors


def _write(file: Path, key: str, px: Array, descriptors: Descriptors) -> None:
    part = file.with_name(f"{file.name}.{os.getpid()}")
    try:
        with part.open("wb") as stream:
            np.savez(stream, key=np.array(key), px=px, descriptors=descriptors)
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
