"""landfix run."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import ConfigFile


def command(
    config: ConfigFile = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors, as under systemd.")] = False,
) -> None:
    """Run the estimator in flight: sensors in, estimate out, all in the log, until stopped.

    Listens on loopback only unless the configuration says otherwise. Prints on stderr what it listens on, where it logs, what it
    waits for, and every change of mode. SIGTERM or Ctrl-C stops it: the log is then complete, and its path and size are printed.
    After kill -9 the log has lost less than 0.1 s. The next start repairs it, and the estimate continues from its last state.

    \b
    Examples:
      landfix run -c vehicle.toml
      systemctl start landfix                   as a service: examples/systemd/landfix.service
      landfix monitor                           its status, live
      landfix replay logs/landfix-....mcap -o again.mcap -c vehicle.toml     the same bytes again
    """
    from estimator.config import load
    from estimator.service.run import run

    run(load(config), config.parent if config else Path(), quiet=quiet)
