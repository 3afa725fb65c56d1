"""After the warm-ups every kernel exists: what is flown and looked at then, whatever it is, compiles nothing."""

import json
import subprocess
import sys
from typing import Any

from tests.estimator.service.flying import environment


def _run(module: str) -> dict[str, Any]:
    process = subprocess.run([sys.executable, "-m", module], env=environment(), capture_output=True, text=True, check=True)
    answer: dict[str, Any] = json.loads(process.stdout)
    return answer


def test_no_kernel_is_compiled_whatever_images_come() -> None:
    """Rigs, worlds, heights, one camera; colour, grey, thermal and dark, raw and JPEG; landmarks small, round, cut and alone."""
    said = _run("tests.estimator.service.vision.many_looks")
    assert said["warm"] > 20
    assert said["compiled"] == said["new"] == []
    assert said["looks"] > 300
    assert said["outcomes"]["fixed"] > 100
    assert len(said["outcomes"]) > 4


def test_no_kernel_is_compiled_whatever_is_flown() -> None:
    """Coasting, late, false and partial fixes, hypotheses, relinearisation, a barometer, no place on Earth, and the smoother."""
    said = _run("tests.estimator.service.many_flights")
    assert said["warm"] > 15
    assert said["compiled"] == said["new"] == []
    assert said["estimates"] > 10_000
    assert {"/gnss", "/gnss/velocity", "/landfix/fix", "/pose_fix", "/baro"} <= set(said["fused"])
    assert {"gnss_position fused", "gnss_velocity fused", "baro fused", "pose fused", "pose gated"} <= set(said["reasons"])
