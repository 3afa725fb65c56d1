"""landfix fleet run, compare, show."""

import typer

from estimator.commands.common.groups import Group
from estimator.commands.fleet import compare, run, show

app = typer.Typer(cls=Group, no_args_is_help=True, help="Many flights at once: run, compare, show.", rich_markup_mode=None)
app.command("run")(run.command)
app.command("compare")(compare.command)
app.command("show")(show.command)
