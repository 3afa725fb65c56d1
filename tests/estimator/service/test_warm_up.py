"""After the warm-ups every kernel exists: what is flown and looked at then, whatever it is, compiles nothing."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from estimator.replay.simulate import write
from models.messages import PoseFix
from tests import long
from tests.estimator.scenes import simulated
from tests.estimator.service import many_flights
from tests.estimator.service.flying import environment


def _run(*words: str) -> dict[str, Any]:
    process = subprocess.run([sys.executable, "-m", *words], env=environment(), capture_output=True, text=True, check=True)
    answer: dict[str, Any] = json.loads(process.stdout)
    return answer


@long.parametrize(("rigs", "looks", "fixed"), [(1, 30, 8), (5, 110, 40)])
def test_no_kernel_is_compiled_whatever_images_come(rigs: int, looks: int, fixed: int) -> None:
    """Rigs, worlds, heights, one camera; colour, grey, thermal and dark, raw and JPEG; landmarks small, round, cut and alone."""
    said = _run("tests.estimator.service.vision.many_looks", str(rigs))
    assert said["warm"] > 20
    assert said["compiled"] == said["new"] == []
    assert said["looks"] > looks
    assert said["outcomes"]["fixed"] > fixed
    assert len(said["outcomes"]) > 2


@long.parametrize("scenarios", [2, 4])
def test_no_kernel_is_compiled_whatever_is_flown(scenarios: int, tmp_path: Path) -> None:
    """Coasting, late, false and partial fixes, hypotheses, relinearisation, a barometer, no place on Earth, and the smoother."""
    simulation, turns = simulated(many_flights.SCENARIOS[0]), itertools.cycle(range(7))
    messages = [many_flights.with_less(m, next(turns)) if isinstance(m, PoseFix) else m for m in simulation.messages]
    write(replace(simulation, messages=messages), tmp_path / "flight.mcap")
    said = _run("tests.estimator.service.many_flights", str(tmp_path / "flight.mcap"), str(scenarios))
    assert said["warm"] > 15
    assert said["compiled"] == said["new"] == []
    assert said["logged"] > 3000
    assert said["fused"] == ["/gnss", "/gnss/velocity", "/landfix/fix", "/pose_fix"]
    assert said["estimates"] > 2500 * scenarios
    assert {"gnss_position fused", "gnss_velocity fused", "baro fused", "pose fused", "pose gated"} <= set(said["reasons"])
