"""The header of an image file says the size that its decoder finds, whatever follows it."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from models.untrusted.image_header import ImageHeader, image_header, image_header_of_file, too_large


@pytest.mark.parametrize("ending", [".jpg", ".png", ".tif", ".bmp", ".webp", ".pgm", ".ppm"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_of_each_format(tmp_path: Path, ending: str, channels: int, kind: type[np.generic]) -> None:
    if (ending, channels) in {(".pgm", 3), (".ppm", 1)} or (kind == np.uint16 and ending in {".jpg", ".bmp", ".webp"}):
        pytest.skip("no such image")
    image = (np.random.default_rng(1).integers(0, 255, (30, 50, channels))).astype(kind)
    path = tmp_path / f"image{ending}"
    assert cv2.imwrite(str(path), image)
    header = image_header_of_file(path)
    assert header == image_header(path.read_bytes())
    assert header is not None
    assert (header.width, header.height) == (50, 30)
    decoded = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    assert header.bytes_a_pixel >= decoded.nbytes // 1500
    assert too_large(header, path.stat().st_size, 1500) == ""
    assert too_large(header, path.stat().st_size, 1499) == "declares 50 x 30 pixels, 1499 are read at most"
    for cut in range(0, 60, 3):
        image_header(path.read_bytes()[:cut])


def test_pixels_that_cannot_be_in_so_few_bytes_are_too_many() -> None:
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + struct.pack(">IIBB", 32_000, 32_000, 1, 0)
    header = image_header(png)
    assert header == ImageHeader(32_000, 32_000, 1)
    assert too_large(header, 124_517, 2**30) == "declares 32000 x 32000 pixels in 124517 bytes"


def test_a_jpeg_of_thousands_of_scans_is_refused_and_a_progressive_one_is_not() -> None:
    """Each costs a pass over all pixels and a few bytes."""
    image = np.random.default_rng(1).integers(0, 255, (30, 50, 3), dtype=np.uint8)
    _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    data = file.tobytes()
    header = image_header(data)
    assert header is not None
    assert 5 <= header.scans <= 20
    assert too_large(header, len(data), 1500) == ""
    many = data[:-2] + data[data.rindex(b"\xff\xda") : -2] * 100 + data[-2:]
    assert cv2.imdecode(np.frombuffer(many, np.uint8), cv2.IMREAD_COLOR) is not None
    header = image_header(many)
    assert header is not None
    assert too_large(header, len(many), 1500) == "declares 50 x 30 pixels in more than 100 scans"


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"GIF89a" + bytes(20), b"BM" + bytes(30), b"II*\0" + b"\xff" * 20])
def test_no_image(data: bytes) -> None:
    assert image_header(data) is None
