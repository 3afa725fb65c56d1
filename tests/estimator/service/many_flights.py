"""Flights of all kinds in a process that has warmed up, as the daemon does: prints what was compiled for them, as JSON.

compiled: as the daemon's own report counts it; new: kernels of which a flight from a log, the first of all, has more signatures
than the warm-up. (The simulator of the other flights, in this process, has kernels of its own.)

python -m tests.estimator.service.many_flights FLIGHT.mcap [SCENARIOS]
"""

import gc
import itertools
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from numba.core.dispatcher import Dispatcher

from estimator.filter.smoother import smooth
from estimator.publish import OutputConfig, Publisher
from estimator.service.base import compilation
from logs.store.reader import LogReader
from logs.wire.codec import Decoder
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


def with_less(fix: PoseFix, turn: int) -> PoseFix | LandmarkFix:
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


def flights(scenarios: int) -> list[tuple[str, list[Input]]]:
    """Configuration and messages, in order of arrival: fixes whole and in part, a barometer, and an IMU that is missing."""
    found = []
    for seed, text in enumerate(SCENARIOS[:scenarios]):
        simulation, turns = simulated(text, seed), itertools.cycle(range(7))
        messages = [with_less(m, next(turns)) if isinstance(m, PoseFix) and seed != 2 else m for m in simulation.messages]
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


def decoded(log: Path) -> Iterator[Input]:
    """The measurements of a log."""
    decoder = Decoder()
    with LogReader(log) as reader:
        for record in reader:
            message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
            if message is not None:
                yield message


def main() -> None:
    from estimator.fusion import Fusion, FusionConfig  # noqa: PLC0415
    from estimator.service.warm_up import warm_up  # noqa: PLC0415

    warm_up()
    warm = kernels()
    compiled = list[str]()
    compilation.listen(lambda kernel, _: compiled.append(kernel) if kernel and not kernel.startswith("models.sim") else None)
    fusion = Fusion(FusionConfig(origin=(47.3977, 8.5456, 488.0)))
    logged = [said for message in decoded(Path(sys.argv[1])) for said in fusion.handle(message)]
    new = sorted({name for name, _ in kernels() - warm})
    fused = {s.topic for s in logged if isinstance(s, AidStatus) and s.reason is Reason.FUSED}
    found = {"warm": len(warm), "new": new, "fused": sorted(fused), "logged": sum(isinstance(s, Estimate) for s in logged)}
    reasons, estimates = Counter[str](), 0
    for seed, (text, messages) in enumerate(flights(int(sys.argv[2]) if len(sys.argv) > 2 else len(SCENARIOS))):
        fusion, publisher = Fusion(config_of(simulated(text, seed))), Publisher(OutputConfig())
        for message in messages:
            said = fusion.handle(message)
            list(publisher.encoded(said))
            reasons.update(f"{s.kind} {s.reason.value}" for s in said if isinstance(s, AidStatus))
            estimates += sum(isinstance(s, Estimate) for s in said)
    smooth(simulated(SCENARIOS[0]).messages, config_of(simulated(SCENARIOS[0])))
    run = Run(Fusion(config_of(simulated(SCENARIOS[3])))).feed(hover(9.0))
    print(json.dumps(found | {"compiled": compiled, "estimates": estimates + len(run.estimates), "reasons": reasons}))


if __name__ == "__main__":
    main()
