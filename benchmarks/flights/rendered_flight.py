"""One rendered flight: simulated, its images drawn, and replayed with what the cameras see or without it."""

from pathlib import Path

import numpy as np

from calib.files.formats import load_rig
from estimator.config import load
from estimator.frontend.processor import Processor
from estimator.frontend.replay_images import ImageReplay
from estimator.map_files import store as map_store
from estimator.replay import flight_images
from estimator.replay import simulate as simulated
from estimator.replay.replay import replay
from logs.evaluation.collected import read
from logs.evaluation.evaluate import Comparison, compare
from models.sim.scenario import Scenario, simulate


def draw(folder: Path, plan: Scenario, seed: int, *, spread: bool = True) -> None:
    """The flight of a scenario with cameras as flight.mcap, with map, rig and configuration next to it.

    spread: over processes; a job of a pool has none of its own.
    """
    assert plan.cameras is not None
    folder.mkdir(parents=True, exist_ok=True)
    simulation = simulate(plan, seed)
    images = flight_images.plan(plan.cameras, simulation, seed)
    images.write_map_and_rig(folder / "map.geojson", folder / "rig.yaml")
    (folder / "flight.toml").write_text(flight_images.configuration(plan.cameras, simulation, "map.geojson", "rig.yaml"))
    delay_ns = round(plan.cameras.delay_s * 1e9)
    here = [] if spread else [(t + delay_ns, image) for k, t in enumerate(images.t_ns.tolist()) for image in images.draw(k)]
    simulated.write(simulation, folder / "flight.mcap", images=images if spread else here)


def fly(folder: Path, after_s: float, *, landmarks: bool = True) -> Comparison:
    """Estimate and truth from after_s on; landmarks: with what the cameras see."""
    config, log, estimate = load(folder / "flight.toml"), folder / "flight.mcap", estimate_of(folder, landmarks=landmarks)
    processor = None
    if landmarks:
        seen = Processor(load_rig(folder / "rig.yaml"), map_store.load(folder / "map.geojson"))
        processor = ImageReplay(seen, config.vision, config.inputs.left_image, config.inputs.right_image, log)
    replay(log, estimate, config, processor=processor)
    collected = read(estimate)
    c = compare(collected.estimate, collected.truth)
    return c[np.asarray(c.t_ns - int(collected.truth.t_ns[0]) >= round(after_s * 1e9))]


def estimate_of(folder: Path, *, landmarks: bool) -> Path:
    """The log that fly() writes."""
    return folder / f"estimate_{'with' if landmarks else 'without'}.mcap"
