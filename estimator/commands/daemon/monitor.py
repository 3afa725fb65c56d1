"""landfix monitor."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json


def command(
    config: ConfigFile = None,
    connect: Annotated[
        str | None, typer.Option("--connect", metavar="ENDPOINT", help="Where the daemon listens; default: as in FILE.")
    ] = None,
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.1, help="Stop after this time; default: on Ctrl-C.")] = None,
    picture: Annotated[Path | None, typer.Option("--svg", metavar="FILE.svg", help="Write the last screen as a picture.")] = None,
    json: Json = False,
) -> None:
    """Watch a running daemon: mode, position, 95 % radius, sources, latencies, log.

    It only listens; the daemon never waits for it.

    \b
    Examples:
      landfix monitor -c vehicle.toml                 endpoint and user from the configuration
      landfix monitor --connect tcp/10.0.0.5:7447
      landfix monitor --seconds 5 --svg now.svg       a picture for a report
    """
    from estimator.config import load
    from estimator.service import monitor

    loaded = load(config)
    with monitor.connected(loaded.zenoh, config.parent if config else Path(), connect) as (session, endpoint):
        if json:
            typer.echo(monitor.asked(session, "status"))
        else:
            monitor.watch(session, loaded.zenoh.domain, endpoint, seconds, picture)
