"""Images of files, folders, videos, logs, cameras."""

import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from calib.errors import CalibrationError

_IMAGES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"}
_VIDEOS = {".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm"}
MOST_FRAMES = 300  # of a video or a log; evenly spread
_LIVE_S, _LIVE_FOR_S = 0.7, 90.0  # a live camera: an image so often, for so long


class SourceImage(NamedTuple):
    """key: pairs it with the other camera (number, frame, or stamp in ns); done: fraction; fault: why unreadable, image None."""

    name: str
    key: int
    image: Any
    done: float
    fault: str = ""


def read_image(path: Path) -> Any:
    """The image of a file. Raises CalibrationError."""
    first = next(read_images([str(path)], "", 1))
    if first.fault:
        raise CalibrationError(f"{path}: {first.fault}")
    return first.image


def read_images(sources: Sequence[str], topic: str, most: int = MOST_FRAMES) -> Iterator[SourceImage]:
    """All images, `most` of a video or log. Raises CalibrationError."""
    files = files_of(sources)
    source: Iterator[SourceImage]
    for k, file in enumerate(files):
        if is_live(file):
            source = (taken for (taken,) in live([file]))
        elif Path(file).suffix.lower() == ".mcap":
            source = _log(Path(file), topic, most)
        elif is_video(Path(file)):
            source = _video(Path(file), most)
        else:
            source = _still(Path(file), k)
        for image in source:
            yield image._replace(done=(k + image.done) / len(files))


def is_video(path: Path) -> bool:
    """Whether a name is a video's."""
    return path.suffix.lower() in _VIDEOS


def files_of(sources: Sequence[str]) -> list[str]:
    """Files and cameras that sources mean. Raises CalibrationError."""
    return [f for source in sources for f in _files(source)]


def _files(source: str) -> list[str]:
    path = Path(source)
    if is_live(source):
        return [source]
    if path.is_dir():
        found = sorted(str(p) for p in path.iterdir() if p.suffix.lower() in _IMAGES)
        if not found:
            raise CalibrationError(f"{source}: no images in this folder")
        return found
    if any(c in source for c in "*?["):
        base = Path(path.anchor or ".")
        found = sorted(str(p) for p in base.glob(str(path.relative_to(path.anchor)) if path.anchor else source))
        if not found:
            raise CalibrationError(f"{source}: no file has such a name")
        return found
    if not path.exists():
        raise CalibrationError(f"{source}: no such file or folder")
    return [source]


def _still(path: Path, k: int) -> Iterator[SourceImage]:
    from logs.wire.images import ImageError, decode_file
    from models.untrusted.file import content
    from models.untrusted.quiet import silence

    numbers = re.findall(r"\d+", path.stem)
    key = int(numbers[-1]) if numbers else -1 - k
    try:
        with silence():  # libpng and OpenCV would tell of a torn file, too
            image = decode_file(content(path))
    except (ImageError, OSError) as error:
        yield SourceImage(path.name, key, None, 1.0, getattr(error, "strerror", None) or str(error))
    else:
        yield SourceImage(path.name, key, image, 1.0)


def _video(path: Path, most: int) -> Iterator[SourceImage]:
    import cv2

    video = cv2.VideoCapture(str(path))
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    if not video.isOpened() or count == 0:
        raise CalibrationError(f"{path}: no video that can be read")
    step = max(1, -(-count // most))
    for frame in range(count):
        if not video.grab():
            break
        if frame % step == 0:
            ok, image = video.retrieve()
            if ok:
                yield SourceImage(f"{path.name} frame {frame}", frame, image, (frame + 1) / count)


def is_live(source: str) -> bool:
    """Whether a source is a camera: camera:0, camera:URL."""
    return source.startswith("camera:")


def live(sources: Sequence[str]) -> Iterator[tuple[SourceImage, ...]]:
    """Simultaneous images of cameras. Raises CalibrationError."""
    cameras = [_opened(source.removeprefix("camera:")) for source in sources]
    began, taken, count = time.monotonic(), -_LIVE_S, 0
    while (elapsed := time.monotonic() - began) < _LIVE_FOR_S and all(c.grab() for c in cameras):
        if elapsed - taken >= _LIVE_S:
            shots = [c.retrieve() for c in cameras]
            if all(ok for ok, _ in shots):
                taken, count = elapsed, count + 1
                yield tuple(SourceImage(f"image {count}", count, image, elapsed / _LIVE_FOR_S) for _, image in shots)
    if count == 0:
        raise CalibrationError(f"{', '.join(sources)}: opened, but gives no image: is another program using it?")


def _opened(device: str) -> Any:
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # else it reports every back-end that it tried
    camera = cv2.VideoCapture(int(device) if device.isdigit() else device)
    if not camera.isOpened():
        raise CalibrationError(f"camera {device} cannot be opened (landfix takes camera:0, camera:1, ... or camera:URL)")
    return camera


def _log(path: Path, topic: str, most: int) -> Iterator[SourceImage]:
    from logs.store.reader import LogReader

    with LogReader(path) as log:
        stamps = [r.log_time_ns for r in log if r.topic == topic]
    if not stamps:
        raise CalibrationError(f"{path}: no images under {topic} in it; name their topic")
    step = max(1, -(-len(stamps) // most))
    with LogReader(path) as log:
        for k, record in enumerate(r for r in log if r.topic == topic):
            if k % step == 0:
                yield _of_record(record.schema, record.data, topic, (k + 1) / len(stamps))


def _of_record(schema: str, data: bytes, topic: str, done: float) -> SourceImage:
    from logs.wire import schemas
    from logs.wire.images import ImageError, decode_image
    from logs.wire.stamps import stamp_of

    if schema not in {schemas.IMAGE, schemas.COMPRESSED_IMAGE}:
        raise CalibrationError(f"{topic} holds {schema}, not images")
    t_ns = stamp_of(data) or 0
    name = f"{topic} at {t_ns * 1e-9:.3f} s"
    try:
        return SourceImage(name, t_ns, decode_image(schema, data), done)
    except ImageError as error:
        return SourceImage(name, t_ns, None, done, str(error))
