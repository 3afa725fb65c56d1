"""Lists of commands in help."""

from typing import Any

from typer.core import TyperGroup

_WHOLE = 1000  # characters: the formatter wraps, nothing is cut


class Group(TyperGroup):
    """Commands by panel: those of `panels`, then in order of registration."""

    panels: tuple[str, ...] = ()

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
