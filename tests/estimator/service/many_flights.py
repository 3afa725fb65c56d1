"""Flights of all kinds in a process that has warmed up, as the daemon does: prints what was compiled for them, as JSON.

compiled: as the daemon's own report counts it; new: kernels that have more signatures than after the warm-up. The first flight
goes through a log.

python -m tests.estimator.service.many_flights
"""

import gc
import itertools
import json
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from numba.core.dispatcher import Dispatcher

from estimator.filter.smoother import smooth
from estimator.publish import OutputConfig, Publisher
from estimator.service.base import compilation
from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder, encode_input
from models.measurements import DIRECTION_SCALE
from models.messages import AidStatus, Array, Estimate, Input, LandmarkFix, PoseFix, Reading, Reason
from models.sim.scenario import EPOCH_NS
from tests.estimator.partial import in_part
from tests.estimator.scenes import SECOND, Run, by_arrival, config_of, hover, simulated

HEAD = """
duration_s = 60.0
origin = [47.3977, 8.5456, 488.0]
[imu]
rate_hz = 100.0
"""
SCENARIOS = (
    HEAD + "[gnss]\noutages_s = [[25.0, 60.0]]\n[pose_fix]\nrate_hz = 2.0\ndelay_s = 0.3\noutages_s = [[35.0, 45.0]]\n",
    HEAD + '[vehicle]\nkind = "fixed_wing"\n[gnss]\noutages_s = [[20.0, 60.0]]\n[pose_fix]\nrate_hz = 0.5\ndelay_s = 1.5\n'
    "false_spans = [{ start_s = 30.0, end_s = 42.0, offset_n_m = [30.0, -20.0, 5.0] }]\n",
    HEAD.replace("origin = [47.3977, 8.5456, 488.0]\n", "") + "[pose_fix]\nrate_hz = 5.0\nsigma_m = [0.5, 0.5, 0.5]\n",
    HEAD + "[gnss]\n",
)


def _with_less(fix: PoseFix, turn: int) -> PoseFix | LandmarkFix:
    """In part; with errors that repeat; without roll and pitch; without yaw; without attitude; without height; whole."""
    if turn == 0:
        return in_part(fix, np.eye(6)[:4] * DIRECTION_SCALE, np.zeros(2))
    if turn == 1:
        moved = 0.1 * np.eye(6)[:, :3]
        common = moved @ moved.T + 1e-4 * np.eye(6)
        return LandmarkFix(
            fix.t_ns, fix.arrived_ns, fix.p_n, fix.q_nb_wxyz, fix.covariance, common, ("roof",), 0.9, 0.5, moved[None],
            1e-4 * np.eye(6),
        )  # fmt: skip
    covariance: Array = fix.covariance.copy()
    without = ([3, 4], [5], [3, 4, 5], [2], [])[turn - 2]
    covariance[without, without] = np.nan
    return structs.replace(fix, covariance=covariance)


def flights() -> list[tuple[str, list[Input]]]:
    """Configuration and messages, in order of arrival: fixes whole and in part, a barometer, and an IMU that is missing."""
    found = []
    for seed, text in enumerate(SCENARIOS):
        simulation, turns = simulated(text, seed), itertools.cycle(range(7))
        messages = [_with_less(m, next(turns)) if isinstance(m, PoseFix) and seed != 2 else m for m in simulation.messages]
        messages += [
            Reading(t, t, "/baro", "baro", (95_000.0 + 10.0 * np.sin(t * 1e-10),))
            for t in range(EPOCH_NS + SECOND, EPOCH_NS + 59 * SECOND, SECOND)
        ]
        gap = EPOCH_NS + 50 * SECOND, EPOCH_NS + 52 * SECOND
        messages = [m for m in messages if isinstance(m, Reading | PoseFix | LandmarkFix) or not gap[0] < m.t_ns < gap[1]]
        found.append((text, by_arrival(messages)))
    return found


def kernels() -> set[tuple[str, str]]:
    """Name and signature of every kernel that is compiled or loaded in this process."""
    found: list[Any] = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    return {(f"{d.__module__}.{d.__name__}", str(signature)) for d in found for signature in d.signatures}


def logged(messages: Iterable[Input]) -> list[Input]:
    """The messages as a log gives them back."""
    decoder = Decoder()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.mcap"
        with Recorder(file) as recorder:
            for message in messages:
                recorder.write(*encode_input(message), message.arrived_ns)
        with LogReader(file) as reader:
            decoded = [decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in reader]
    return [message for message in decoded if message is not None]


def main() -> None:
    from estimator.fusion import Fusion  # noqa: PLC0415
    from estimator.service.warm_up import warm_up  # noqa: PLC0415

    warm_up()
    warm = kernels()
    compiled = list[str]()
    compilation.listen(lambda kernel, _: compiled.append(kernel) if kernel and not kernel.startswith("models.sim") else None)
    reasons, fused, estimates = Counter[str](), set[str](), 0
    for seed, (text, messages) in enumerate(flights()):
        fusion, publisher = Fusion(config_of(simulated(text, seed))), Publisher(OutputConfig())
        for message in messages if seed else logged(messages):
            said = fusion.handle(message)
            list(publisher.encoded(said))
            reasons.update(f"{s.kind} {s.reason.value}" for s in said if isinstance(s, AidStatus))
            fused |= {s.topic for s in said if isinstance(s, AidStatus) and s.reason is Reason.FUSED}
            estimates += sum(isinstance(s, Estimate) for s in said)
    smooth(simulated(SCENARIOS[0]).messages, config_of(simulated(SCENARIOS[0])))
    run = Run(Fusion(config_of(simulated(SCENARIOS[3])))).feed(hover(9.0))
    new = sorted({name for name, _ in kernels() - warm if not name.startswith("models.sim")})
    found = {"warm": len(warm), "new": new, "compiled": compiled, "fused": sorted(fused)}
    print(json.dumps(found | {"estimates": estimates + len(run.estimates), "reasons": reasons}))


if __name__ == "__main__":
    main()
