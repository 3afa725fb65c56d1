"""landfix simulate."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.commands.common.console import Json, Out, print_json, progress


def command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="Vehicle, sensors and faults.")],
    out: Out,
    seed: Annotated[
        int,
        typer.Option(
            min=0, help="Random seed. The same seed gives the same log, another seed another flight over the same village."
        ),
    ] = 0,
    images: Annotated[
        bool, typer.Option("--images/--no-images", help="Draw the images of a scenario that has [cameras], or leave them out.")
    ] = True,
    json: Json = False,
) -> None:
    """Simulate a flight as a log.

    OUT.mcap holds the sensors' messages and the truth; OUT.toml is the matching configuration. With [cameras] in the scenario
    there are stereo images in it, and OUT_map.geojson and OUT_rig.yaml are its landmark map and calibration.

    \b
    Examples:
      landfix simulate examples/scenarios/rare_fixes.toml -o flight.mcap --seed 3
    """
    from estimator.replay.simulate import write
    from models.sim.scenario import simulate
    from models.sim.scenario_file import loads
    from models.untrusted.file import content

    plan = loads(content(scenario), str(scenario))
    simulation = simulate(plan, seed)
    config, text = out.with_suffix(".toml"), simulation.config_toml
    with progress(f"simulate {scenario.stem}") as report:
        if images and plan.cameras:
            from estimator.replay import flight_images

            map_file, rig_file = (out.with_name(f"{out.stem}_{name}") for name in ("map.geojson", "rig.yaml"))
            flight = flight_images.plan(plan.cameras, simulation, seed)
            flight.write_map_and_rig(map_file, rig_file)
            text = flight_images.configuration(plan.cameras, simulation, map_file.name, rig_file.name)
            messages = write(simulation, out, report, flight)
        else:
            messages = write(simulation, out, report)
    config.write_text(text)
    if json:
        print_json({"out": str(out), "config": str(config), "messages": messages, "seed": seed})
    else:
        typer.echo(f"{out}: {messages} messages, truth included; its configuration is {config}")
