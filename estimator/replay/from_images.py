"""The images of a log processed again: landmarks, odometry or both, as the configuration says."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from estimator.config import Config, ConfigError

if TYPE_CHECKING:
    from estimator.frontend.repeat import Repeat, Together


def seen_again(config: Config, folder: Path, source: Sequence[Path]) -> "Together":
    """The processor for a replay; files relative to `folder`. Raises ConfigError."""
    from estimator.frontend.files import load_odometry, load_processor  # noqa: PLC0415  (vision is loaded only where it is used)
    from estimator.frontend.repeat import Together  # noqa: PLC0415
    from estimator.frontend.replay_images import ImageReplay  # noqa: PLC0415
    from estimator.frontend.replay_odometry import OdometryReplay  # noqa: PLC0415

    rig, landmarks, image = config.rig.file, config.map.landmarks, config.map_image(folder)
    mapped, odometry = bool(landmarks or image), config.visual_odometry
    if rig is None or not (mapped or odometry.enabled):
        raise ConfigError(
            "--from-images needs the cameras and a map or odometry: give -c FILE with [rig] file, and [map] landmarks, "
            "[map] picture or [visual_odometry] enabled"
        )
    left, right = config.inputs.left_image, config.inputs.right_image
    parts: list[Repeat] = []
    if mapped:
        processor = load_processor(folder / rig, folder / landmarks if landmarks else None, config.map.origin, image)
        parts.append(ImageReplay(processor, config.vision, left, right, list(source)))
    if odometry.enabled:
        parts.append(OdometryReplay(load_odometry(folder / rig), odometry, config.vision, (left, right), list(source)))
    return Together(parts)
