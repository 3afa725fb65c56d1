"""The demonstration.

GPS ends after one third; then landmarks, a dark lens, and odometry over meadows, compared with a replay without it.
"""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import msgspec

from estimator.config import Config, load
from estimator.replay import simulate as simulated
from estimator.replay.replay import replay
from estimator.replay.summary import ReplaySummary
from logs.evaluation.collected import Collected
from logs.evaluation.evaluate import find_outages
from logs.evaluation.records import Evaluation
from logs.report.write import Written, compose, gather
from models.messages import Reason
from models.sim.scenario import Scenario, simulate
from models.sim.scenario_file import loads

SCENARIO = "demo.toml"
_CHECKOUT = Path("examples/scenarios") / SCENARIO  # a wheel has it next to this file instead

_OUTAGE_S = 5.0  # longer without a fix is an outage

Progress = Callable[[float], None]
Stages = Callable[[float, str], None]  # share that is done, and the name of the stage


class DemoResult(msgspec.Struct, frozen=True):
    """Files written and results."""

    folder: str
    log: str
    config: str
    estimate: str
    without_odometry: str  # "": no odometry was used
    picture: str
    overlay: str  # "": there was no fix to draw
    report: str
    replay: ReplaySummary
    evaluation: Evaluation


def scenario_text() -> str:
    """The demonstration's scenario, installed or in examples/."""
    packaged = resources.files("estimator.tools") / SCENARIO
    return (packaged if packaged.is_file() else Path(__file__).parents[2] / _CHECKOUT).read_text(encoding="utf-8")


def demo(
    folder: Path,
    seed: int = 0,
    progress: Stages = lambda _, __: None,
    scenario: str | None = None,
    one_camera: bool = False,
) -> DemoResult:
    """Fly the scenario (TOML text; default: the demonstration's), write all into `folder`.

    one_camera: the left camera alone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log, config, estimate = (folder / name for name in ("input.mcap", "demo.toml", "estimate.mcap"))
    _simulate(folder, _plan(scenario or scenario_text(), one_camera), seed, _part(progress, 0.0, 0.5, "simulate and render"))
    loaded = load(config)
    summary, overlay = _fly(folder, loaded, _part(progress, 0.5, 0.8, "replay"))
    without = folder / "without_odometry.mcap" if loaded.visual_odometry.enabled else None
    if without is not None:
        replay(estimate, without, loaded, _part(progress, 0.8, 0.87, "replay without odometry"), odometry=False)
    written = _report(folder, without, _part(progress, 0.87, 1.0, "evaluate and report"))
    return DemoResult(
        folder=str(folder),
        log=str(log),
        config=str(config),
        estimate=str(estimate),
        without_odometry=str(without or ""),
        picture=str(folder / "demo.png"),
        overlay=overlay,
        report=written.report,
        replay=summary,
        evaluation=written.evaluation,
    )


def _plan(scenario: str, one_camera: bool) -> Scenario:
    plan = loads(scenario, SCENARIO)
    if not one_camera:
        return plan
    if plan.cameras is None:
        raise ValueError("one camera: the scenario has no [cameras]")
    return msgspec.structs.replace(plan, cameras=msgspec.structs.replace(plan.cameras, one_camera=True))


def _simulate(folder: Path, plan: Scenario, seed: int, progress: Progress) -> None:
    from estimator.replay import flight_images  # noqa: PLC0415  (slow to import, and not always needed)

    simulation = simulate(plan, seed)
    text, images = simulation.config_toml, None
    if plan.cameras:
        images = flight_images.plan(plan.cameras, simulation, seed)
        images.write_map_and_rig(folder / "map.geojson", folder / "rig.yaml")
        text = flight_images.configuration(plan.cameras, simulation, "map.geojson", "rig.yaml")
    (folder / "demo.toml").write_text(text, encoding="utf-8")
    simulated.write(simulation, folder / "input.mcap", progress, *([images] if images else []))


def _fly(folder: Path, config: Config, progress: Progress) -> tuple[ReplaySummary, str]:
    log, estimate, sheet = folder / "input.mcap", folder / "estimate.mcap", folder / "overlay.png"
    rig_file, map_file = config.rig.file, config.map.landmarks
    if rig_file is None or map_file is None:
        return replay(log, estimate, config, progress), ""
    from calib.files.formats import load_cameras  # noqa: PLC0415
    from estimator.frontend.odometry import OdometryProcessor  # noqa: PLC0415
    from estimator.frontend.processor import Processor  # noqa: PLC0415
    from estimator.frontend.repeat import Repeat, Together  # noqa: PLC0415
    from estimator.frontend.replay_images import ImageReplay  # noqa: PLC0415
    from estimator.frontend.replay_odometry import OdometryReplay  # noqa: PLC0415
    from estimator.map_files import store as map_store  # noqa: PLC0415
    from estimator.tools.overlay.sheet import write_sheet  # noqa: PLC0415

    rig, landmarks = load_cameras(folder / rig_file), map_store.load(folder / map_file)
    sides = config.inputs.left_image, config.inputs.right_image
    parts: list[Repeat] = [ImageReplay(Processor(rig, landmarks), config.vision, *sides, log)]
    if config.visual_odometry.enabled:
        parts.append(OdometryReplay(OdometryProcessor(rig), config.visual_odometry, config.vision, sides, log))
    summary = replay(log, estimate, config, progress, Together(parts))
    drawn = write_sheet(estimate, sheet, rig, landmarks)
    return summary, str(sheet) if drawn else ""


def _report(folder: Path, without_odometry: Path | None, progress: Progress) -> Written:
    from estimator.tools.overlay.gallery import illustrations  # noqa: PLC0415
    from logs.evaluation import plots  # noqa: PLC0415  (matplotlib is slow to import, and not needed before)

    estimate = folder / "estimate.mcap"
    collected, gathered = gather(estimate, progress=progress)
    outages = find_outages(collected.aids, collected.health, collected.estimate, _OUTAGE_S)
    figure = plots.overview(collected, outages["all"].spans)
    gps_off_s = (outages["/gnss"].spans[0][0] - int(collected.estimate.t_ns[0])) * 1e-9
    figure.axes[1].axvline(gps_off_s, color="black", linestyle="--", linewidth=1.0)
    figure.axes[1].text(gps_off_s, 0.97, " GPS cut off", va="top", transform=figure.axes[1].get_xaxis_transform())
    for span in outages["all"].spans:
        begin_s = (span[0] - int(collected.estimate.t_ns[0])) * 1e-9
        figure.axes[1].text(begin_s, 0.90, carried_by(collected, span), va="top", transform=figure.axes[1].get_xaxis_transform())
    figure.savefig(folder / "demo.png")
    report, illustrate = folder / "report.html", illustrations(estimate)
    return compose(
        collected,
        gathered,
        str(estimate),
        report,
        outage_s=_OUTAGE_S,
        without_odometry=without_odometry,
        illustrate=illustrate,
    )


def carried_by(collected: Collected, span: tuple[int, int]) -> str:
    """Mode in an outage, for a plot."""
    begin, end = span
    steps = any(a.kind == "odometry" and a.reason is Reason.FUSED and begin < a.t_ns <= end for a in collected.aids)
    return " no landmark\n in view:\n odometry" if steps else " lens dark:\n IMU alone"


def _part(progress: Stages, begin: float, end: float, stage: str) -> Progress:
    progress(begin, stage)
    return lambda fraction: progress(begin + (end - begin) * fraction, stage)
