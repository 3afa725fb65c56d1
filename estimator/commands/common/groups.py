"""Lists of commands, and arguments and options as a person names them, in help."""

import re
from typing import Any, Final

from typer.core import TyperGroup

_WHOLE = 1000  # characters: the formatter wraps, nothing is cut
_NUMBER: Final = re.compile(r"<(?:int|float)(?: range)?>")


def _in_words(command: Any) -> None:
    """Options of the help take a <number>; an argument has its name alone: no type of Python, no braces."""
    for parameter in command.params:
        kind = parameter.display_type if parameter.param_type_name == "option" else lambda _: ""
        parameter.display_type = lambda ctx, kind=kind: _NUMBER.sub("<number>", kind(ctx))
    pieces = command.collect_usage_pieces
    command.collect_usage_pieces = lambda ctx: [_plain(piece) for piece in pieces(ctx)]


def _plain(piece: str) -> str:
    """{LOGS...}... is LOGS..., and [[LOG.mcap]] is [LOG.mcap]."""
    return re.sub(r"[{}]", "", piece).replace("[[", "[").replace("]]", "]").replace("......", "...")


class Group(TyperGroup):
    """Commands by panel: those of `panels`, then in order of registration."""

    panels: tuple[str, ...] = ()

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for command in self.commands.values():
            _in_words(command)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002  (as click calls it)
        """The commands of the help, one section a panel."""
        width = max(map(len, self.commands))
        panels: dict[str, list[tuple[str, str]]] = {name: [] for name in self.panels}
        for name, command in self.commands.items():
            panel = command.rich_help_panel or "Commands"  # type: ignore[attr-defined]
            panels.setdefault(panel, []).append((name.ljust(width), command.get_short_help_str(_WHOLE)))
        for panel, rows in panels.items():
            with formatter.section(panel):
                formatter.write_dl(rows)
