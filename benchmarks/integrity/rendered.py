"""A rendered flight with protection levels: its images through the vision of a replay into the filter, alert limits on.

The flight of examples/scenarios/night.toml, 80 s over a village of the seed's own, GPS for 35 s, images at 2 Hz. By day, in
colour; by night, thermal; by day with 15 s without light. Logs are deleted when they have been read.
"""

from pathlib import Path
from shutil import rmtree
from typing import Final

import msgspec
import numpy as np

from benchmarks.flights import rendered_flight
from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.rows import LIMITS, Row, row_of
from logs.evaluation.collected import read
from logs.evaluation.evaluate import compare
from models.sim.scenario import Scenario
from models.sim.scenario_file import loads

_NIGHT: Final = ROOT / "examples" / "scenarios" / "night.toml"
_DARK_S: Final = ((50.0, 65.0),)
LIGHTS: Final = ("day", "night", "dark for 15 s")


def fly(light: str, seed: int, folder: Path) -> Row:
    """Draw it, replay it from the images, compare the levels with the errors."""
    rendered_flight.draw(folder, _plan(light, seed), seed, spread=False)
    try:
        with (folder / "flight.toml").open("a") as file:
            file.write(f"\n[integrity]\nhal_m = {LIMITS.hal_m}\nval_m = {LIMITS.val_m}\n")
        rendered_flight.fly(folder, 0.0)
        found = read(rendered_flight.estimate_of(folder, landmarks=True))
    finally:
        rmtree(folder)
    against = compare(found.estimate, found.truth)
    return row_of(list(found.integrity), np.asarray(against.t_ns), np.asarray(against.p_error))


def _plan(light: str, seed: int) -> Scenario:
    plan = loads(_NIGHT.read_text(), str(_NIGHT))
    assert plan.cameras is not None
    cameras = msgspec.structs.replace(plan.cameras, world=msgspec.structs.replace(plan.cameras.world, seed=seed))
    if light != "night":
        dark_s = _DARK_S if light.startswith("dark") else ()
        cameras = msgspec.structs.replace(cameras, sees="colour", exposure_s=0.002, dark_s=dark_s)
    return msgspec.structs.replace(plan, name=f"{light} {seed}", cameras=cameras)
