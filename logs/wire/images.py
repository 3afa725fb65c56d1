"""Images to and from the wire: (H, W) grey, 8 or 16 bit, or (H, W, 3) BGR."""

from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from logs.wire import schemas
from logs.wire.encoding import Encoded, header_of, packed
from logs.wire.schemas import STORE
from models.untrusted.image_header import image_header, too_large
from models.untrusted.limits import CAMERA_PIXELS

Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

_ENCODINGS: Final[dict[str, tuple[int, type[np.generic]]]] = {
    "mono8": (1, np.uint8),
    "8UC1": (1, np.uint8),
    "bgr8": (3, np.uint8),
    "8UC3": (3, np.uint8),
    "rgb8": (3, np.uint8),
    "mono16": (1, np.uint16),
    "16UC1": (1, np.uint16),
}


class ImageError(Exception):
    """Bytes that are no image; one line."""


def encode_image(t_ns: int, image: Pixels, topic: str, *, jpeg_quality: int | None = None, frame: str = "camera") -> Encoded:
    """An image of camera `frame` at t_ns: pixels, or JPEG of that quality (1 to 100)."""
    header = header_of(t_ns, frame)
    if jpeg_quality is not None:
        _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
        return packed(topic, schemas.COMPRESSED_IMAGE, header=header, format="jpeg", data=file.ravel())
    height, width = image.shape[:2]
    encoding = "bgr8" if image.ndim == 3 else "mono16" if image.dtype == np.uint16 else "mono8"
    raw = np.ascontiguousarray(image)
    step = raw.strides[0]
    return packed(
        topic,
        schemas.IMAGE,
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=step,
        data=np.frombuffer(raw.tobytes(), np.uint8),
    )


def decode_image(schema: str, data: bytes, most_pixels: int = CAMERA_PIXELS) -> Pixels:
    """Image of an Image or CompressedImage. Raises ImageError, before decoding if too large."""
    try:
        message: Any = STORE.deserialize_cdr(data, schema)
        return _unpacked(message) if schema == schemas.IMAGE else decode_file(message.data, most_pixels)
    except ImageError:
        raise
    except Exception as error:  # bytes from outside: whatever they trip over, they are no image
        raise ImageError(f"not a {schema}: {type(error).__name__}") from None


def _unpacked(message: Any) -> Pixels:
    if message.encoding not in _ENCODINGS:
        raise ImageError(f"encoding {message.encoding!r} is not read (known: {', '.join(_ENCODINGS)})")
    channels, kind = _ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = message.height, message.width, message.step
    row = width * channels * dtype.itemsize
    if not (height and width and step >= row and len(message.data) >= height * step):
        raise ImageError(f"{width} x {height} pixels need {height * row} bytes; there are {len(message.data)}")
    rows = np.asarray(message.data[: height * step], np.uint8).reshape(height, step)[:, :row]
    image = np.ascontiguousarray(rows).view(dtype).astype(kind, copy=False).reshape(height, width, channels)
    if message.encoding == "rgb8":
        image = np.ascontiguousarray(image[:, :, ::-1])
    return image if channels == 3 else image[:, :, 0]


def decode_file(content: bytes | NDArray[np.uint8], most_pixels: int = CAMERA_PIXELS) -> Pixels:
    """Image of a file, EXIF orientation ignored. Raises ImageError."""
    data = np.frombuffer(content, np.uint8)
    header = image_header(data.data)
    if header is None:
        raise ImageError(f"no image that can be read ({len(data)} bytes; needed: JPEG, PNG, TIFF, BMP, WebP or PNM)")
    if reason := too_large(header, len(data), most_pixels):
        raise ImageError(reason)
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(f"no image that can be read ({len(data)} bytes, damaged)")
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[:, :, :3]
    if image.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)} or (image.ndim == 3 and image.dtype != np.uint8):
        raise ImageError(f"images of {image.dtype} are not read")
    if image.dtype == np.uint16:
        return np.ascontiguousarray(image, np.uint16)
    return np.ascontiguousarray(image, np.uint8)
