"""What a row costs beside the estimator alone and the commands replay and evaluate: least CPU time of some rounds, in turns."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from estimator.config import parse
from estimator.fusion import Fusion
from estimator.replay import simulate as simulated
from estimator.replay.replay import replay
from estimator.tools.fleet.flight import Settings, code, fly
from estimator.tools.fleet.store import flights
from logs.evaluation.evaluate import evaluate
from logs.store.reader import LogReader
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

_SECONDS = 60.0
_ROUNDS = 5
_SCENARIO = """
duration_s = {seconds}
[imu]
rate_hz = 100.0
[gnss]
outages_s = [[{outage_s}, {seconds}]]
[pose_fix]
rate_hz = 1.0
delay_s = 0.3
"""
_OUTAGE_S = {"IMU 100 Hz, fixes 1 Hz": 0.0, "the same, GNSS 5 Hz in half of the time": _SECONDS / 2.0}


def table(*_: object) -> dict[str, Any]:
    """Flight hours a core hour."""
    rows = [[name, *measured(outage_s)] for name, outage_s in _OUTAGE_S.items()]
    return {
        "section": "Flight hours a core hour",
        "columns": ["flight", "a row", "replay and evaluate", "estimator alone"],
        "rows": rows,
    }


def measured(outage_s: float) -> list[float]:
    """Flight hours a core hour of a row, of the commands, of the estimator alone."""
    with TemporaryDirectory() as folder:
        log, out = Path(folder) / "flight.mcap", Path(folder) / "estimate.mcap"
        simulation = simulate(loads(_SCENARIO.format(seconds=_SECONDS, outage_s=outage_s)), seed=0)
        simulated.write(simulation, log)
        config = parse(simulation.config_toml)
        settings, (flight,) = Settings("cost", simulation.config_toml, code=code()), flights([str(log)])
        decoder = config.decoder()
        with LogReader(log) as reader:
            read = [decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in reader]
        messages = [m for m in read if m is not None]

        def commands() -> None:
            replay(log, out, config)
            evaluate(out)

        def alone() -> None:
            fusion = Fusion(config.fusion())
            for message in messages:
                fusion.handle(message)

        ways: list[Callable[[], object]] = [lambda: fly(flight, settings), commands, alone]
        least = [min(cpu_s[1:]) for cpu_s in zip(*([_cpu_s(way) for way in ways] for _ in range(_ROUNDS + 1)), strict=True)]
    return [round(_SECONDS / cpu_s, 1) for cpu_s in least]


def _cpu_s(way: Callable[[], object]) -> float:
    began = time.process_time()
    way()
    return time.process_time() - began
