"""Images on the wire: what goes in comes out, and what is no image is said to be none."""

from contextlib import suppress

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs.wire import schemas
from logs.wire.encoding import header_of, packed
from logs.wire.images import ImageError, Pixels, decode_image, encode_image
from logs.wire.schemas import STORE
from logs.wire.stamps import stamp_of

_GREY = np.arange(5 * 7, dtype=np.uint8).reshape(5, 7)
_DEEP = (1800 * np.arange(5 * 7)).astype(np.uint16).reshape(5, 7)
_COLOUR = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)


@pytest.mark.parametrize("image", [_GREY, _DEEP, _COLOUR, _COLOUR[:, 1:6], _GREY[::-1]])
def test_pixels_come_out_as_they_went_in(image: Pixels) -> None:
    sent = encode_image(123_456_789_012, image, "/left/image")
    got = decode_image(sent.schema, sent.data)
    assert (sent.schema, got.dtype, stamp_of(sent.data)) == (schemas.IMAGE, image.dtype, 123_456_789_012)
    np.testing.assert_array_equal(got, image)


def test_a_jpeg_is_near_what_went_in_and_smaller() -> None:
    smooth = cv2.resize(_COLOUR, (160, 120), interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    sent = encode_image(1, smooth, "/left/image", jpeg_quality=95)
    got = decode_image(sent.schema, sent.data)
    assert sent.schema == schemas.COMPRESSED_IMAGE
    assert len(sent.data) < smooth.size / 4
    assert 0.0 < np.abs(got.astype(float) - smooth).mean() < 3.0


@pytest.mark.parametrize("image", [_GREY, _DEEP, _COLOUR])
def test_a_png_is_read_to_the_bit(image: Pixels) -> None:
    np.testing.assert_array_equal(decode_image(schemas.COMPRESSED_IMAGE, _file(image, ".png")), image)


def test_transparency_is_left_out() -> None:
    see_through = np.dstack((_COLOUR, np.full((5, 7), 9, np.uint8)))
    np.testing.assert_array_equal(decode_image(schemas.COMPRESSED_IMAGE, _file(see_through, ".png")), _COLOUR)


@pytest.mark.parametrize(
    ("encoding", "big", "data", "expected"),
    [
        ("rgb8", 0, bytes([1, 2, 3, 4, 5, 6]), [[[3, 2, 1], [6, 5, 4]]]),
        ("8UC3", 0, bytes([1, 2, 3, 4, 5, 6]), [[[1, 2, 3], [4, 5, 6]]]),
        ("mono16", 0, bytes([1, 2, 3, 4]), [[0x0201, 0x0403]]),
        ("16UC1", 1, bytes([1, 2, 3, 4]), [[0x0102, 0x0304]]),
        ("8UC1", 0, bytes([8, 9, 77, 77]), [[8, 9]]),
    ],
)
def test_channels_bytes_and_padding_are_where_the_message_reports(encoding: str, big: int, data: bytes, expected: object) -> None:
    got = decode_image(schemas.IMAGE, _image(encoding, 1, 2, len(data), data, big))
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(
    ("encoding", "height", "width", "step", "data", "reason"),
    [
        ("yuv422", 1, 2, 4, bytes(4), "encoding 'yuv422' is not read (known: mono8"),
        ("mono8", 2, 2, 2, bytes(3), "need 4 bytes; there are 3"),
        ("mono8", 2, 2, 1, bytes(9), "need 4 bytes"),
        ("mono8", 0, 2, 2, bytes(9), "0 pixels need 0 bytes"),
        ("bgr8", 2**31, 2**31, 2**31, bytes(9), "there are 9"),
    ],
)
def test_what_does_not_fit_is_said(encoding: str, height: int, width: int, step: int, data: bytes, reason: str) -> None:
    with pytest.raises(ImageError) as error:
        decode_image(schemas.IMAGE, _image(encoding, height, width, step, data))
    assert reason in str(error.value)


def test_a_file_that_is_none_is_said() -> None:
    for data in (b"", b"not an image", _jpeg_file()[:40]):
        with pytest.raises(ImageError, match="no image that can be read"):
            decode_image(schemas.COMPRESSED_IMAGE, _compressed(data))


def test_images_of_numbers_that_are_no_brightness_are_not_read() -> None:
    deep_colour = (300 * _COLOUR.astype(np.uint16)).astype(np.uint16)
    with pytest.raises(ImageError, match="images of uint16 are not read"):
        decode_image(schemas.COMPRESSED_IMAGE, _file(deep_colour, ".png"))


@given(st.binary(max_size=200), st.sampled_from([schemas.IMAGE, schemas.COMPRESSED_IMAGE]))
def test_any_bytes_give_an_image_or_a_reason(data: bytes, schema: str) -> None:
    with suppress(ImageError):
        assert decode_image(schema, data).size > 0


@given(st.data())
def test_a_message_with_bytes_changed_gives_an_image_or_a_reason(data: st.DataObject) -> None:
    message = bytearray(encode_image(1, _COLOUR, "/left/image").data)
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, 80))] = data.draw(st.integers(0, 255))
    with suppress(ImageError):
        assert decode_image(schemas.IMAGE, bytes(message)).size > 0


def _image(encoding: str, height: int, width: int, step: int, data: bytes, big: int = 0) -> bytes:
    return packed(
        "/left/image", schemas.IMAGE, header=header_of(1, "camera"), height=height, width=width, encoding=encoding,
        is_bigendian=big, step=step, data=np.frombuffer(data, np.uint8),
    ).data  # fmt: skip


def _compressed(data: bytes) -> bytes:
    content = np.frombuffer(data, np.uint8)
    return packed("/left/image", schemas.COMPRESSED_IMAGE, header=header_of(1, "camera"), format="png", data=content).data


def _file(image: Pixels, kind: str) -> bytes:
    return _compressed(cv2.imencode(kind, image)[1].tobytes())


def _jpeg_file() -> bytes:
    data: bytes = STORE.deserialize_cdr(
        encode_image(1, _COLOUR, "/left/image", jpeg_quality=90).data, schemas.COMPRESSED_IMAGE
    ).data.tobytes()  # type: ignore[attr-defined]
    return data
