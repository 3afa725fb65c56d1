"""TOML text -> table, errors in one line."""

import re
import tomllib
from typing import Any, Final

MOST_BYTES = 1_000_000  # of a configuration or a scenario, which a person writes
_MOST_PARTS: Final = 16  # of a dotted key; tomllib's time and memory are quadratic in them
_PART: Final = r"(?:[A-Za-z0-9_-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DEEP_KEY: Final = re.compile(
    rf"(?P<deep>{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_MOST_PARTS},}}+)"
    r"|\"{3}(?s:.*?)\"{3}|'{3}(?s:.*?)'{3}|\"(?:[^\"\\\n]|\\.)*+\"|'[^'\n]*+'|#[^\n]*+"
    r"|[A-Za-z0-9_-]++"
)


def decode(data: bytes) -> str:
    """Text of a file's first MOST_BYTES + 1 bytes. Raises ValueError."""
    if len(data) > MOST_BYTES:
        raise ValueError(f"is larger than {MOST_BYTES:_} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError("is not a text file") from None


def table(text: str) -> dict[str, Any]:
    """The table of a TOML text. Raises ValueError."""
    if len(text) > MOST_BYTES:
        raise ValueError(f"is larger than {MOST_BYTES:_} bytes")
    if any(found["deep"] for found in _DEEP_KEY.finditer(text)):
        raise ValueError(f"not valid TOML: a key of more than {_MOST_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("not valid TOML: it is nested too deeply") from None
    except ValueError as error:  # a TOMLDecodeError, or a number of more than 4300 digits
        said = str(error).replace("Cannot overwrite a value", "this key or section is there twice")
        raise ValueError(f"not valid TOML: {one_line(said)}") from None


def one_line(text: str, most: int = 300) -> str:
    """A message on one line of readable length, without control characters."""
    if len(text) <= most and text.isprintable():
        return text
    words = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return words if len(words) <= most else f"{words[: most - 3]}..."
