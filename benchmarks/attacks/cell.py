"""One cell of the table: a command with something hostile in it, and what may come of it."""

import msgspec

REFUSED, READ_OR_REFUSED, USAGE, ANY = frozenset({1}), frozenset({0, 1}), frozenset({2}), frozenset({0, 1, 2})


class Cell(msgspec.Struct, frozen=True):
    """words: of the command line; codes: exit codes that are right."""

    area: str
    name: str
    words: tuple[str, ...]
    codes: frozenset[int] = REFUSED
