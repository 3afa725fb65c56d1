"""One cell of the table: a command with something hostile in it, and what may come of it."""

import msgspec

REFUSED, READ_OR_REFUSED, USAGE, ANY = frozenset({1}), frozenset({0, 1}), frozenset({2}), frozenset({0, 1, 2})


class Cell(msgspec.Struct, frozen=True):
    """words: of the command line; codes: exit codes that are right."""

    area: str
    name: str
    words: tuple[str, ...]
    codes: frozenset[int] = REFUSED


class Row(msgspec.Struct, frozen=True):
    """What came of a cell; said: the last line of stderr, or else of stdout."""

    area: str
    name: str
    verdict: str
    reason: str
    code: int
    cpu_s: float
    said: str
    version: str = ""
