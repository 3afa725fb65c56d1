"""Is the estimate consistent with landmarks alone? One flight each over many villages, each with its own map errors.

python -m benchmarks.flights.villages --scenario examples/scenarios/night.toml --villages 25
python -m benchmarks.flights.villages --scenario examples/scenarios/night.toml --villages 25 --day

A map's errors are drawn once a village, so flights over one village, however many, are one draw of them. Counted is what comes
after GPS is cut off. The scatter of a mean is that of the flights' own means. Logs and table go to out/villages/.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.stats import chi2

from benchmarks.flights import rendered_flight
from benchmarks.tables import Table, number
from logs.evaluation.metrics import nees
from models.sim.scenario import Scenario
from models.sim.scenario_file import ScenarioError, loads

OUT = Path(__file__).resolve().parents[2] / "out" / "villages"
COLUMNS = ("village", "position error m, RMS", "worst m", "NEES/3", "inside the 95 % ellipsoid")


class Flown(msgspec.Struct, frozen=True):
    """One flight after the cut: position error [m], NEES/3 in the mean, share of the time inside the 95 % ellipsoid."""

    village: int
    rms_m: float
    worst_m: float
    nees: float
    inside: float


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.flights.villages", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", type=Path, required=True, help="with [cameras], GPS cut off from some moment on")
    parser.add_argument("--villages", type=int, default=25)
    parser.add_argument("--seed", type=int, default=1, help="of the first village, and of the flight over it")
    parser.add_argument("--day", action="store_true", help="in colour, with a shutter of 2 ms, whatever the scenario has")
    arguments = parser.parse_args()
    try:
        plan = loads(arguments.scenario.read_text(), str(arguments.scenario))
    except (OSError, ScenarioError) as error:
        parser.error(f"--scenario: {error}")
    if plan.cameras is None or plan.gnss is None or not plan.gnss.outages_s:
        parser.error("--scenario: must have [cameras], and [gnss] with outages_s")
    if arguments.villages < 2:
        parser.error("--villages must be at least 2")
    if arguments.day:
        cameras = msgspec.structs.replace(plan.cameras, sees="colour", exposure_s=0.002)
        plan = msgspec.structs.replace(plan, name=f"{plan.name}_by_day", cameras=cameras)
    seeds = range(arguments.seed, arguments.seed + arguments.villages)
    flown = [fly(plan, seed, OUT / f"{plan.name}_{seed}") for seed in track(seeds, "flights", console=Console(stderr=True))]
    text = table(plan.name, flown).markdown()
    (OUT / f"{plan.name}.md").write_text(text)
    print(text)


def fly(plan: Scenario, seed: int, folder: Path) -> Flown:
    """Over the village of this seed."""
    assert plan.cameras is not None
    assert plan.gnss is not None
    world = msgspec.structs.replace(plan.cameras.world, seed=seed)
    there = msgspec.structs.replace(plan, cameras=msgspec.structs.replace(plan.cameras, world=world))
    rendered_flight.draw(folder, there, seed)
    c = rendered_flight.fly(folder, plan.gnss.outages_s[0][0])
    squared, error = nees(c.p_error, c.p_covariance), np.linalg.norm(c.p_error, axis=1)
    inside = float(np.mean(squared <= chi2.ppf(0.95, 3)))
    return Flown(seed, float(np.sqrt(np.mean(error**2))), float(error.max()), float(squared.mean()) / 3.0, inside)


def table(name: str, flown: list[Flown]) -> Table:
    """A row a village, and their means."""
    rows = [(str(f.village), number(f.rms_m), number(f.worst_m), number(f.nees), f"{f.inside:.0%}") for f in flown]
    mean = np.array([f.nees for f in flown])
    scatter = float(mean.std(ddof=1)) / len(mean) ** 0.5
    rms = float(np.sqrt(np.mean([f.rms_m**2 for f in flown])))
    together = (
        "all", number(rms), number(max(f.worst_m for f in flown)), f"{mean.mean():.2f} ({scatter:.2f})",
        f"{np.mean([f.inside for f in flown]):.0%}",
    )  # fmt: skip
    return Table(f"Flights on landmarks alone: {name}", COLUMNS, [*rows, together])


if __name__ == "__main__":
    main()
