"""landfix start."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import ConfigFile

_PATIENCE_S = 20.0


def command(
    at: Annotated[
        str, typer.Option("--at", metavar="LAT,LON[,M]", help="Degrees, m above the ellipsoid; default: the origin's height.")
    ],
    sigma_m: Annotated[float, typer.Option("--sigma", metavar="M", min=0.01, max=250, help="Sigma of the position, m.")] = 3.0,
    heading_deg: Annotated[
        float | None,
        typer.Option("--heading", metavar="DEG", help="From true north, clockwise; default: not known."),
    ] = None,
    heading_sigma_deg: Annotated[
        float, typer.Option("--heading-sigma", metavar="DEG", min=0.1, max=60, help="Sigma of the heading, degrees.")
    ] = 3.0,
    config: ConfigFile = None,
    connect: Annotated[
        str | None, typer.Option("--connect", metavar="ENDPOINT", help="Where the daemon listens; default: as in FILE.")
    ] = None,
) -> None:
    """Start a running daemon without GNSS: where the vehicle stands, and where its nose points.

    The vehicle stands still meanwhile. Needs [map] origin. Rest holds the estimate until the vehicle moves: [rest] enabled, or
    an autopilot that says it is landed. Refused once there is an estimate. With --heading to 4 degrees or better the estimate
    comes within seconds; otherwise a sensor or the motion has to show the heading.

    \b
    Examples:
      landfix start --at 47.3977,8.5456 --sigma 1 --heading 92 -c vehicle.toml
    """
    import math

    from estimator.config import ConfigError, load, parse
    from estimator.service import monitor, start
    from models.frames import Origin
    from models.messages import vec3

    lat, lon, *height = _place(at)
    mine = load(config)
    with monitor.connected(mine.zenoh, config.parent if config else Path(), connect) as (session, _):
        its = parse(monitor.asked(session, "config"), "the daemon's configuration")
        place = its.map.origin
        if place is None:
            raise ConfigError("the daemon's configuration has no [map] origin: a start without GNSS needs one")
        p_n = vec3(Origin(*place).to_ned(lat, lon, height[0] if height else place[2]))
        heading = None if heading_deg is None else math.radians(heading_deg)
        given = start.Start(p_n, sigma_m, heading, math.radians(heading_sigma_deg))
        waited_s = start.start(session, mine.zenoh.domain, given, _PATIENCE_S)
    typer.echo(f"landfix has an estimate after {waited_s:.1f} s")
    if not its.rest.enabled:
        typer.echo(
            "[rest] enabled is not set: without fixes, or an autopilot that says it is landed, this lasts seconds", err=True
        )


def _place(text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not (2 <= len(found) <= 3 and abs(found[0]) <= 90.0 and abs(found[1]) <= 180.0 and abs(found[-1]) <= 1e5):
        raise typer.BadParameter(f"--at {text}: latitude, longitude and perhaps a height are wanted, as in 47.3977,8.5456,489.2")
    return found
