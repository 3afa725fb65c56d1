"""landfix doctor."""

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import Json, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.tools.doctor.machine import Check

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}
_BASIC = {  # section -> keys that a vehicle has of its own; all others have a default that fits most
    "imu": "gyro_noise accel_noise gyro_walk accel_walk axes mounting_rpy_deg",
    "inputs": "imu gnss gnss_velocity pose_fix odometry left_image right_image",
    "map": "origin geoid_m landmarks",
    "rig": "file",
    "gnss": "delay_s antenna_b_m",
    "bounds": "vehicle",
    "visual_odometry": "enabled",
    "drag": "enabled",
    "rest": "enabled",
    "zenoh": "connect listen domain",
    "mavlink": "endpoint baud",
    "px4": "enabled release",
    "log": "folder keep_gb",
}


def command(
    log: Annotated[Path | None, typer.Argument(metavar="[LOG.mcap]", help="A log to check with the configuration.")] = None,
    file: Annotated[Path | None, typer.Option("-c", metavar="FILE", help="TOML configuration to check.")] = None,
    keys: Annotated[
        bool, typer.Option("--config", help="Print a configuration: what a vehicle has of its own, with unit and meaning.")
    ] = False,
    every: Annotated[bool, typer.Option("--all", help="With --config: every key.")] = False,
    autopilot: Annotated[
        bool,
        typer.Option("--autopilot", help="Read the autopilot's parameters and check them; landfix must not be running."),
    ] = False,
    live: Annotated[
        float | None,
        typer.Option("--live", metavar="SECONDS", min=3.0, help="Check the running sensors, the vehicle at rest; sends nothing."),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show the checks that are ok, too.")] = False,
    json: Json = False,
) -> None:
    """Check machine, configuration, autopilot, running sensors and log.

    Every warning and failure comes with advice. Exit code 1 if something fails.

    \b
    Examples:
      landfix doctor -v                           this machine, with the checks that are ok
      landfix doctor -c vehicle.toml              cameras, ports, devices, secrets, the folder of the logs
      landfix doctor -c vehicle.toml --autopilot  the autopilot's parameters, over [mavlink] endpoint
      landfix doctor -c vehicle.toml --live 15    what comes in 15 s, what is missing, what to set
      landfix doctor flight.mcap -c vehicle.toml  a log: topics, rates, stamps, units, axes, delays
      landfix doctor --config > vehicle.toml      the keys of a vehicle, with default, unit and meaning
      landfix doctor --config --all               every key
    """
    if keys:
        if log or file:
            raise typer.BadParameter("--config lists keys and takes no file; check a file with -c FILE")
        _print_keys(json, every)
        return
    if every:
        raise typer.BadParameter("--all belongs to --config")
    if autopilot and file is None:
        raise typer.BadParameter("--autopilot needs -c FILE: [mavlink] endpoint says where it is")
    if live and (log or file is None):
        raise typer.BadParameter("--live needs -c FILE, and takes no log: it records one and checks it")
    from estimator.tools.doctor import machine

    checks = machine.machine()
    found, config = machine.configuration(file)
    checks += found
    if file and config:
        from estimator.tools.doctor import flight as doctor_flight

        checks += doctor_flight.flight(config, file.parent)
    if autopilot and file and config:
        from estimator.tools.doctor import autopilot as doctor_autopilot

        checks += doctor_autopilot.autopilot(config, file.parent)
    heard: list[Check] = []
    if live and file and config:
        from estimator.tools.doctor import live as doctor_live

        typer.echo(f"listening for {live:g} s; the vehicle stands still", err=True)
        heard = doctor_live.live(config, file.parent, live, lambda line: typer.echo(line, err=True))
    if log and config:
        from estimator.tools.doctor import log as doctor_log

        with progress(f"read {log.name}") as report:
            checks += doctor_log.log(log, config, report)
    if json:
        print_json({"checks": checks + heard, "failed": machine.failed(checks + heard)})
    else:
        _print_checks(checks + heard, [c for c in checks if verbose or c.state != "ok"] + heard)
    if machine.failed(checks + heard):
        raise typer.Exit(1)


def _print_checks(checks: "list[Check]", shown: "list[Check]") -> None:
    from rich.text import Text

    rows = [(Text(c.state, style=_COLOURS[c.state]), c.name, c.found + (f"\n-> {c.advice}" if c.advice else "")) for c in shown]
    if rows:
        print_table("landfix doctor", rows)
    ok = sum(c.state == "ok" for c in checks)
    typer.echo(f"{ok} of {len(checks)} checks ok" + ("" if len(shown) == len(checks) else " (-v shows them)"))


def _print_keys(json: bool, every: bool) -> None:
    from estimator.config import Config
    from estimator.strict_toml import keys

    known = keys(Config)
    table = [key for key in known if every or key.name in _BASIC.get(key.section, "").split()]
    if json:
        print_json([key._asdict() for key in table])
        return
    for section, rows in groupby(table, key=lambda key: key.section):
        typer.echo(f"\n[{section}]")
        for key in rows:
            line = f"# {key.name} =" if key.default == "-" else f"{key.name} = {key.default}"
            typer.echo(f"{line:<36} # {f'{key.unit}: ' if key.unit else ''}{key.meaning}")
    if not every:
        typer.echo(f"\n# {len(known) - len(table)} more keys: landfix doctor --config --all")
