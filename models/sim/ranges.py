"""The ranges of the numbers a person may type into a scenario."""

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Rate = Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)]
Interval = tuple[NotNegative, NotNegative]
Sigma3 = tuple[NotNegative, NotNegative, NotNegative]
Delay = float | Interval  # a constant, or [least, most] of a random one; checked by ascending()


def ascending(name: str, *ranges: Delay) -> None:
    """Raises ValueError unless [least, most], or a number >= 0."""
    for given in ranges:
        least, most = given if isinstance(given, tuple) else (0.0, given)
        if not least <= most:
            raise ValueError(f"{name} = {given}: must be positive, and the smaller number first")


def between(delay: Delay) -> Interval:
    """[least, most] of a delay, whichever way it was given."""
    return delay if isinstance(delay, tuple) else (delay, delay)
