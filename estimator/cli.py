"""The command line `landfix`; exit codes: 0 done, 1 failed, 2 wrong usage."""
# ruff: noqa: D301  (\b keeps line breaks in help)

import os
import re
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from estimator.commands import (
    demo,
    doctor,
    evaluate,
    evidence,
    export,
    forecast,
    live,
    recover,
    replay,
    report,
    simulate,
    tune,
)
from estimator.commands import import_ as import_command
from estimator.commands.calibrate import app as calibrate
from estimator.commands.common.groups import Group
from estimator.commands.daemon import monitor, run, start
from estimator.commands.fleet import app as fleet
from estimator.commands.map import app as map_command
from estimator.commands.vision import bench, locate, measure, overlay
from estimator.version import version

PANELS = FLY, LOGS, MAPS, PHOTOS, CALIBRATION, MORE = ("Fly", "Logs", "Maps", "Photos", "Calibration", "More")
_OURS = frozenset({"estimator", "logs", "models", "vision", "calib"})


class OneLineErrors(Group):
    """Errors in a command: one line, exit code 1, unless LANDFIX_DEBUG=1 or --debug."""

    panels = PANELS

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except TyperException as error:  # usage errors exit with 2
            error.message = plain(error.message)
            raise
        except (typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except Exception as error:
            if os.environ.get("LANDFIX_DEBUG"):
                raise
            typer.echo(f"landfix: {printable(one_line(error))}", err=True)
            raise typer.Exit(1) from None


def plain(message: str) -> str:
    """A usage error in plain words."""
    message = re.sub(r"Value error, |, unable to parse string as an? \w+", "", message)
    return message.replace("Input should be", "must be")


def printable(text: str) -> str:
    """A text without control characters for a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def one_line(error: Exception) -> str:
    """One line; errors not ours or the system's are defects."""
    from estimator.tools.doctor import packages  # noqa: PLC0415  (when something is wrong)

    if reason := packages.explain(error):
        return " ".join(reason.split())
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    text = " ".join(str(error).split())
    if type(error).__module__.partition(".")[0] in _OURS:
        return text
    return f"internal error, please report it: {type(error).__name__}: {text} (LANDFIX_DEBUG=1 shows where)"


app = typer.Typer(
    cls=OneLineErrors, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)  # fmt: skip


def _version(show: bool) -> None:
    if show:
        typer.echo(f"landfix {version()}")
        raise typer.Exit


@app.callback()
def _landfix(
    _show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", hidden=True, help="Show the traceback of an error.")] = False,
) -> None:
    """Estimate the state of a vehicle without GPS: IMU, rare pose fixes and the last GPS in one consistent estimate.

    \b
    Start here:
      landfix demo                                a simulation, through everything
      landfix import FLIGHT.BIN -o flight.mcap    or .ulg, .tlog, a bag, CSV
      landfix replay flight.mcap -o estimate.mcap -c flight.toml
      landfix evaluate estimate.mcap              how good it was
    """
    if debug:
        os.environ["LANDFIX_DEBUG"] = "1"


app.command("run", short_help="Run the estimator in flight.", rich_help_panel=FLY)(run.command)
app.command("monitor", short_help="Watch a running daemon: mode, position, 95 % radius, sources.", rich_help_panel=FLY)(
    monitor.command
)
app.command("start", short_help="Start a daemon without GNSS, at a typed position.", rich_help_panel=FLY)(start.command)
app.command("live", short_help="Show a running daemon, or play a log, in Foxglove.", rich_help_panel=FLY)(live.command)
app.command("forecast", short_help="Predict the 95 % radius along a route without GPS.", rich_help_panel=FLY)(forecast.command)
app.command("replay", rich_help_panel=LOGS)(replay.command)
app.command("evaluate", short_help="Evaluate an estimate against truth, or compare several.", rich_help_panel=LOGS)(
    evaluate.command
)
app.command("report", short_help="Write a report of a flight as one HTML page.", rich_help_panel=LOGS)(report.command)
app.command("export", rich_help_panel=LOGS)(export.command)
app.command("import", rich_help_panel=LOGS)(import_command.command)
app.command("tune", rich_help_panel=LOGS)(tune.command)
app.command("simulate", rich_help_panel=LOGS)(simulate.command)
app.command("recover", rich_help_panel=LOGS)(recover.command)
app.add_typer(fleet.app, name="fleet", short_help="Replay and evaluate many logs, compare two runs.", rich_help_panel=LOGS)
app.add_typer(map_command.app, name="map", rich_help_panel=MAPS)
app.command("locate", short_help="Locate the vehicle from photos, a video or a stereo pair.", rich_help_panel=PHOTOS)(
    locate.command
)
app.command("measure", rich_help_panel=PHOTOS)(measure.command)
app.command("overlay", rich_help_panel=PHOTOS)(overlay.command)
app.add_typer(calibrate.app, name="calibrate", short_help="Calibrate cameras, stereo rigs and IMUs.", rich_help_panel=CALIBRATION)
app.command("demo", rich_help_panel=MORE)(demo.command)
app.command("doctor", rich_help_panel=MORE)(doctor.command)
app.command("evidence", short_help="Write the evidence for the protection levels.", rich_help_panel=MORE)(evidence.command)
app.add_typer(bench.app, name="bench", rich_help_panel=MORE)


def main() -> None:
    """The entry point `landfix`."""
    app(prog_name="landfix")
