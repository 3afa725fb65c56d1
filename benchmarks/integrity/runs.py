"""One flight with protection levels, compared with its truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final, TypeAlias

import msgspec
import numpy as np

from benchmarks.flights.tasks import Task
from benchmarks.integrity.rows import LIMITS, Row, row_of
from benchmarks.stress.cell import perturbed
from benchmarks.stress.flights import Flight, load_flight, of_task
from benchmarks.stress.perturbations import KINDS
from estimator.config import parse
from estimator.fusion import Fusion
from logs.evaluation.trajectory import nearest
from models.messages import Estimate, Input, Integrity, Output
from models.sim.aids import Gnss, PoseFixes
from models.sim.ranges import Interval
from models.sim.scenario import Scenario, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing, Multirotor

# group (stress, real, village); flight; kind, scenario or aids; size or seconds; seed; folder of tasks
Job: TypeAlias = tuple[str, str, str, float, int, str]

_NEAR_NS: Final = 15_000_000


def run(job: Job) -> Row:
    """The flight."""
    group, name, kind, size, seed, tasks = job
    flight: Flight | None
    if group == "stress":
        flight = load_flight(name, KINDS[kind].aids, seed, Path(tasks))
        messages = perturbed(flight, KINDS[kind], size, seed)
    else:
        vehicle = Multirotor(seed=seed) if name == "rotor" else FixedWing(seed=seed)
        flight = recorded(name, kind, seed, Path(tasks)) if group == "real" else village(vehicle, kind, size, seed)
        if flight is None:  # too short
            return Row(group, name, kind, size, seed)
        messages = flight.messages
    return msgspec.structs.replace(measured(flight, messages), group=group, flight=name, kind=kind, size=size, seed=seed)


def recorded(name: str, scenario: str, seed: int, tasks: Path) -> Flight | None:
    """A flight of LANDFIX_DATA in a scenario of the scoring tool."""
    group, flight = name.split("/")
    return of_task(Task(group, flight, scenario, seed), tasks)


def village(
    vehicle: Multirotor | FixedWing,
    aids: str,
    seconds: float,
    seed: int,
    rate_hz: float = 0.5,
    outages_s: tuple[Interval, ...] = (),
) -> Flight:
    """Fixes of 0.3 m, 1 degree, and 0.3 m that repeat, as over a village that is mapped; aids: "fixes" or "both"."""
    scenario = Scenario(
        duration_s=seconds,
        vehicle=vehicle,
        imu=Imu(rate_hz=100.0),
        gnss=Gnss() if aids == "both" else None,
        pose_fix=PoseFixes(rate_hz=rate_hz, sigma_m=(0.3, 0.3, 0.3), common_sigma_m=0.3, outages_s=outages_s),
    )
    made = simulate(scenario, seed)
    t = made.truth
    return Flight(made.messages, t.t_ns, t.p_n, t.v_n, t.R_nb, (), parse(made.config_toml, "simulated").fusion())


def measured(flight: Flight, messages: list[Input]) -> Row:
    """Fly it, and compare every protection level with the errors until the next one."""
    estimates, levels = flown(flight, messages)
    return compared(flight, estimates, levels)


def flown(flight: Flight, messages: list[Input]) -> tuple[dict[int, Estimate], list[Integrity]]:
    """The estimates as published first, by stamp, and the levels."""
    estimates, others = outputs_of(Fusion(msgspec.structs.replace(flight.config, integrity=LIMITS)), messages)
    return estimates, [output for output in others if isinstance(output, Integrity)]


def outputs_of(fusion: Fusion, messages: Iterable[Input]) -> tuple[dict[int, Estimate], list[Output]]:
    """The first estimate of each stamp, and all other outputs."""
    estimates, others = dict[int, Estimate](), list[Output]()
    for message in messages:
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                estimates.setdefault(output.t_ns, output)
            else:
                others.append(output)
    return estimates, others


def compared(flight: Flight, estimates: dict[int, Estimate], levels: list[Integrity]) -> Row:
    """Every level with the errors until the next one."""
    t_ns = np.array(sorted(estimates), np.int64)
    if not len(t_ns):
        return Row("", "", "", 0.0, 0)
    row, near = nearest(flight.t_ns, t_ns, _NEAR_NS)
    t_ns, row = t_ns[near], row[near]
    late_s = (t_ns - flight.t_ns[row]) * 1e-9
    estimated = np.array([estimates[t].nav[:3] for t in t_ns.tolist()]).reshape(-1, 3)
    return row_of(levels, t_ns, flight.p_n[row] + flight.v_n[row] * late_s[:, None] - estimated)
