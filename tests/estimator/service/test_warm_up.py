"""After the warm-ups every kernel exists: what is flown and looked at then, whatever it is, compiles nothing."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from estimator.replay.simulate import write
from models.measurements import DIRECTION_SCALE
from models.messages import Array, LandmarkFix, PoseFix
from tests.estimator.partial import in_part
from tests.estimator.scenes import simulated
from tests.estimator.service.flying import environment

_KERNELS = """
import gc, json, sys
import numpy as np
from numba.core.dispatcher import Dispatcher

def kernels():
    found = (d for d in gc.get_objects() if isinstance(d, Dispatcher))
    return {(f"{d.__module__}.{d.__name__}", str(s)) for d in found for s in d.signatures}

def tell(warm, *without, **more):
    new = sorted({name for name, _ in kernels() - warm if not name.startswith(without)})
    print(json.dumps({"warm": len(warm), "new": new} | more))
"""

_FLIGHT = """
from estimator.service.warm_up import warm_up
warm_up()
warm = kernels()

from pathlib import Path
from estimator.fusion import Fusion, FusionConfig
from logs.wire.codec import Decoder
from logs.store.reader import LogReader
from models.messages import AidStatus, Estimate, Reason
said, fusion, decoder = [], Fusion(FusionConfig(origin=(47.3977, 8.5456, 488.0))), Decoder()
with LogReader(Path(sys.argv[1])) as reader:
    for record in reader:
        message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
        said += fusion.handle(message) if message is not None else []
fused = {s.topic for s in said if isinstance(s, AidStatus) and s.reason is Reason.FUSED}
tell(warm, estimates=sum(isinstance(s, Estimate) for s in said), fused=sorted(fused))
"""

_SCENARIO = """
duration_s = 60.0
origin = [47.3977, 8.5456, 488.0]
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
outages_s = [[25.0, 60.0]]
[pose_fix]
rate_hz = 2.0
delay_s = 0.3
outages_s = [[35.0, 45.0]]
"""


def _answer_of(code: str, *words: str) -> dict[str, Any]:
    return _run("-c", _KERNELS + code, *words)


def _run(*words: str) -> dict[str, Any]:
    process = subprocess.run([sys.executable, *words], env=environment(), capture_output=True, text=True, check=True)
    answer: dict[str, Any] = json.loads(process.stdout)
    return answer


def _with_less(fix: PoseFix, turn: int) -> PoseFix | LandmarkFix:
    """The fix in part; without roll and pitch; without yaw; without attitude; without height; whole."""
    if turn == 0:
        return in_part(fix, np.eye(6)[:4] * DIRECTION_SCALE, np.zeros(2))
    without = ([3, 4], [5], [3, 4, 5], [2], [])[turn - 1]
    covariance: Array = fix.covariance.copy()
    covariance[without, without] = np.nan
    return structs.replace(fix, covariance=covariance)


def test_no_kernel_is_compiled_in_flight(tmp_path: Path) -> None:
    simulation = simulated(_SCENARIO)
    turns = itertools.cycle(range(6))
    messages = [_with_less(m, next(turns)) if isinstance(m, PoseFix) else m for m in simulation.messages]
    write(replace(simulation, messages=messages), tmp_path / "flight.mcap")
    said = _answer_of(_FLIGHT, str(tmp_path / "flight.mcap"))
    assert said["warm"] > 15
    assert said["new"] == []
    assert said["estimates"] > 3000
    assert said["fused"] == ["/gnss", "/gnss/velocity", "/landfix/fix", "/pose_fix"]


def test_no_kernel_is_compiled_whatever_images_come() -> None:
    """Rigs, worlds, heights, one camera; colour, grey, thermal and dark, raw and JPEG; landmarks small, round, cut and alone."""
    said = _run("-m", "tests.estimator.service.vision.many_looks")
    assert said["warm"] > 20
    assert said["compiled"] == said["new"] == []
    assert said["looks"] > 300
    assert said["outcomes"]["fixed"] > 100
    assert len(said["outcomes"]) > 4


def test_no_kernel_is_compiled_whatever_is_flown() -> None:
    """Coasting, late, false and partial fixes, hypotheses, relinearisation, a barometer, no place on Earth, and the smoother."""
    said = _run("-m", "tests.estimator.service.many_flights")
    assert said["compiled"] == []
    assert said["estimates"] > 10_000
    assert {"gnss_position fused", "gnss_velocity fused", "baro fused", "pose fused", "pose gated"} <= set(said["reasons"])
