"""TOML text -> table; whatever the text, what is wrong with it is one line."""

import tomllib
from typing import Any

MOST_BYTES = 1_000_000  # of a configuration or a scenario, which a person writes


def decode(data: bytes) -> str:
    """The text of a file, of which MOST_BYTES + 1 bytes are enough to be given. Raises ValueError."""
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
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("not valid TOML: it is nested too deeply") from None
    except ValueError as error:  # a TOMLDecodeError, or a number of more than 4300 digits
        raise ValueError(f"not valid TOML: {one_line(str(error))}") from None


def one_line(text: str, most: int = 300) -> str:
    """A message in which the input itself may stand, on one line of readable length."""
    words = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return words if len(words) <= most else f"{words[: most - 3]}..."
