"""landfix run."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path

from estimator.commands.common.console import ConfigFile


def command(config: ConfigFile = None) -> None:
    """Fly: sensors in, estimate out, everything in the log, until stopped.

    Listens on loopback only unless the configuration says otherwise. SIGTERM or Ctrl-C stops it; the log is whole then. After
    kill -9 the log has lost less than 0.1 s, is made whole by the next start, and the estimate goes on from its last state.

    \b
    Examples:
      landfix run -c vehicle.toml
      systemctl start landfix                   as a service: examples/systemd/landfix.service
      landfix monitor                           what it does, live
      landfix replay logs/landfix-....mcap -o again.mcap -c vehicle.toml     the same bytes again
    """
    from estimator.config import load
    from estimator.service.run import run

    run(load(config), config.parent if config else Path())
