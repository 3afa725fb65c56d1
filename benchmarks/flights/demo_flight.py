"""The demonstration's flight with and without landmarks, with and without GPS after its first third: error and 95 % radius.

python -m benchmarks.flights.demo_flight --seed 0 --flights 5

Every flight is simulated and drawn with its own seed, twice: with GPS all along and cut off as in the scenario; each is replayed
with what the cameras see and without it. Counted is what comes after the cut. The first flight's errors are drawn beneath their
95 % radius. Logs, table and picture go to out/demo_flight/.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track

from benchmarks.flights import rendered_flight
from benchmarks.tables import Table, number
from estimator.tools.demo import scenario_text
from logs.evaluation.collected import read
from logs.evaluation.evaluate import Comparison, find_outages
from logs.evaluation.metrics import chi2_band, nees
from logs.evaluation.plots import draw_horizontal_error
from models.radius import horizontal_radius
from models.sim.scenario_file import loads

OUT = Path(__file__).resolve().parents[2] / "out" / "demo_flight"
OUTAGE_S = 5.0  # longer without a fix is an outage
EVERY_S = 5.0  # at these instants errors of different flights are compared
COLUMNS = ("GPS", "landmarks", "error m, RMS", "largest m", "95 % radius m, median", "inside it", "NEES/3", "95 % band")


class Errors(msgspec.Struct, frozen=True):
    """One flight after the cut: position errors [m], horizontal errors [m] and radii [m] every EVERY_S, and their NEES."""

    landmarks: bool
    error_m: list[float]
    horizontal_m: list[float]
    radius_m: list[float]
    nees: list[float]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.flights.demo_flight", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flights", type=int, default=5)
    arguments = parser.parse_args()
    jobs = [(arguments.seed + k, gps) for k in range(arguments.flights) for gps in (True, False)]
    flown = [fly(*job) for job in track(jobs, "flights", console=Console(stderr=True))]
    rows = [
        row(gps, seen, [e for job, two in zip(jobs, flown, strict=True) for e in two if (job[1], e.landmarks) == (gps, seen)])
        for gps in (True, False)
        for seen in (True, False)
    ]
    text = Table("The demonstration's flight after the first third", COLUMNS, rows).markdown()
    (OUT / "demo_flight.md").write_text(text)
    draw(arguments.seed).savefig(OUT / "demo_flight.png", dpi=90)
    print(text)


def fly(seed: int, gps: bool) -> list[Errors]:
    """Simulate one flight and replay it with what the cameras see, and without."""
    plan = loads(scenario_text())
    assert plan.gnss is not None
    cut_s = plan.gnss.outages_s[0][0]
    if gps:
        plan = msgspec.structs.replace(plan, gnss=msgspec.structs.replace(plan.gnss, outages_s=()))
    folder = _folder(seed, gps=gps)
    rendered_flight.draw(folder, plan, seed)
    return [_errors(rendered_flight.fly(folder, cut_s, landmarks=seen), landmarks=seen) for seen in (True, False)]


def _errors(c: Comparison, *, landmarks: bool) -> Errors:
    """At instants EVERY_S apart."""
    instant_ns = round(EVERY_S * 1e9)
    c = c[np.asarray(np.diff((c.t_ns - int(c.t_ns[0])) // instant_ns, prepend=-1) > 0)]
    return Errors(
        landmarks,
        np.linalg.norm(c.p_error, axis=1).tolist(),
        np.linalg.norm(c.p_error[:, :2], axis=1).tolist(),
        horizontal_radius(c.p_covariance[:, :2, :2]).tolist(),
        nees(c.p_error, c.p_covariance).tolist(),
    )


def row(gps: bool, landmarks: bool, flights: list[Errors]) -> tuple[str, ...]:
    """All flights together. The band is that of the mean over flights, whose errors are independent, at one instant."""
    error = np.concatenate([f.error_m for f in flights])
    horizontal, radius = (np.concatenate([getattr(f, name) for f in flights]) for name in ("horizontal_m", "radius_m"))
    low, high = (limit / (3 * len(flights)) for limit in chi2_band(3.0 * len(flights)))
    mean = float(np.mean([np.mean(f.nees) for f in flights])) / 3.0
    return (
        "yes" if gps else "cut off", "yes" if landmarks else "no", number(float(np.sqrt(np.mean(error**2)))),
        number(float(error.max())), number(float(np.median(radius))), f"{np.mean(horizontal <= radius):.1%}", number(mean),
        f"{low:.2f} to {high:.2f}",
    )  # fmt: skip


def draw(seed: int) -> Figure:
    """Horizontal error and 95 % radius of one flight, four times."""
    figure = Figure(figsize=(13.0, 8.0), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for axes, (gps, seen) in zip(grid.flat, ((True, True), (True, False), (False, True), (False, False)), strict=True):
        collected = read(rendered_flight.estimate_of(_folder(seed, gps=gps), landmarks=seen))
        outages = find_outages(collected.aids, collected.health, collected.estimate, OUTAGE_S)
        draw_horizontal_error(axes, collected, outages["all"].spans)
        name = f"{'GPS all along' if gps else 'GPS cut off'}, {'landmarks' if seen else 'no landmarks'}"
        axes.set_title(f"{name}: {axes.get_title()}", fontsize=10)
    shown = {label: handle for axes in grid.flat for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _folder(seed: int, *, gps: bool) -> Path:
    return OUT / f"{seed}_{'gps' if gps else 'cut'}"


if __name__ == "__main__":
    main()
