"""landfix simulate."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.console import Json, Out, print_json, progress


def command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="Vehicle, sensors and what goes wrong.")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal logs.")] = 0,
    json: Json = False,
) -> None:
    """Simulate a flight as a log.

    OUT.mcap holds the sensors' messages and the truth; OUT.toml is the configuration that fits it.

    \b
    Examples:
      landfix simulate examples/scenarios/demo.toml -o flight.mcap --seed 3
      landfix replay flight.mcap -o estimate.mcap -c flight.toml
      landfix evaluate estimate.mcap
    """
    from estimator.simulate import write
    from models.sim.scenario import simulate
    from models.sim.scenario_file import loads

    simulation = simulate(loads(scenario.read_text(), str(scenario)), seed)
    config = out.with_suffix(".toml")
    with progress(f"simulate {scenario.stem}") as report:
        messages = write(simulation, out, report)
    config.write_text(simulation.config_toml)
    if json:
        print_json({"out": str(out), "config": str(config), "messages": messages, "seed": seed})
    else:
        typer.echo(f"{out}: {messages} messages, truth included; its configuration is {config}")
