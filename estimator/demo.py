"""The demonstration: a flight is simulated, replayed through the real pipeline, evaluated and drawn.

GPS is cut off at one third. From then on rare and late pose fixes carry the estimate, and for half a minute not even these.
"""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import msgspec

from estimator import simulate as simulated
from estimator.config import parse
from estimator.replay import replay
from estimator.tally import ReplaySummary
from logs.evaluate import assess, find_outages
from logs.evaluation import Evaluation
from logs.evidence import read
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

SCENARIO = "demo.toml"
_CHECKOUT = Path("examples/scenarios") / SCENARIO  # a wheel has it beside this file instead

_OUTAGE_S = 5.0  # fixes come every 2 s; a longer silence is an outage

Progress = Callable[[float], None]


class DemoResult(msgspec.Struct, frozen=True):
    """What was written, and what came of it."""

    folder: str
    log: str
    config: str
    estimate: str
    picture: str
    replay: ReplaySummary
    evaluation: Evaluation


def scenario_text() -> str:
    """The scenario of the demonstration: from the installed package, or from examples/ of a source folder."""
    packaged = resources.files("estimator") / SCENARIO
    return (packaged if packaged.is_file() else Path(__file__).parents[1] / _CHECKOUT).read_text(encoding="utf-8")


def demo(folder: Path, seed: int = 0, progress: Progress = lambda _: None, scenario: str | None = None) -> DemoResult:
    """Fly the scenario (TOML text; default: the demonstration's) and write everything into `folder`."""
    from logs import plots  # noqa: PLC0415  (matplotlib is slow to import, and not needed before)

    folder.mkdir(parents=True, exist_ok=True)
    log, config, estimate, picture = (folder / n for n in ("input.mcap", "demo.toml", "estimate.mcap", "demo.png"))
    simulation = simulate(loads(scenario or scenario_text(), SCENARIO), seed)
    simulated.write(simulation, log, _part(progress, 0.0, 0.3))
    config.write_text(simulation.config_toml, encoding="utf-8")
    summary = replay(log, estimate, parse(simulation.config_toml, str(config)), _part(progress, 0.3, 0.8))
    evidence = read(estimate, progress=_part(progress, 0.8, 0.95))
    outages = find_outages(evidence.aids, evidence.health, evidence.estimate, _OUTAGE_S)
    figure = plots.overview(evidence, outages["all"])
    gps_off_s = (outages["/gnss"][0][0] - int(evidence.estimate.t_ns[0])) * 1e-9
    figure.axes[1].axvline(gps_off_s, color="black", linestyle="--", linewidth=1.0)
    figure.axes[1].text(gps_off_s, 0.97, " GPS cut off", va="top", transform=figure.axes[1].get_xaxis_transform())
    figure.savefig(picture)
    progress(1.0)
    return DemoResult(
        folder=str(folder),
        log=str(log),
        config=str(config),
        estimate=str(estimate),
        picture=str(picture),
        replay=summary,
        evaluation=assess(evidence, str(estimate), outage_s=_OUTAGE_S),
    )


def _part(progress: Progress, begin: float, end: float) -> Progress:
    """Progress of one stage as its share of the whole."""
    return lambda fraction: progress(begin + (end - begin) * fraction)
