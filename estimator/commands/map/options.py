"""Options that several map commands have."""

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from models.maps.colours import Colour


def colours(pick: str) -> "tuple[Colour, ...]":
    """The colours of --pick. Raises a usage error."""
    from models.maps.colours import parse

    found = [(word, parse(word)) for word in pick.split(",") if word.strip()]
    for word, colour in found:
        if colour is None:
            raise typer.BadParameter(f"--pick: {word!r} is neither a CSS name nor #rrggbb")
    return tuple(colour for _, colour in found if colour is not None)
