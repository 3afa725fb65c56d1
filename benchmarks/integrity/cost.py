"""What protection levels with alert limits cost: `python -m benchmarks.integrity.cost`.

A simulated rotor of 60 s, flown in turns with limits (time to alert 1 s, 2 s), without, and with levels never due; processor time
a message, least of all rounds. Memory: held by estimator/integrity (tracemalloc).
"""

import argparse
import gc
import os
import time
import tracemalloc
from collections.abc import Callable, Mapping
from functools import partial

import msgspec

from benchmarks.integrity.rows import LIMITS
from benchmarks.integrity.runs import village
from benchmarks.stress.cell import perturbed
from benchmarks.stress.flights import Flight
from benchmarks.stress.perturbations import KINDS
from estimator.fusion import Fusion
from estimator.integrity.config import IntegrityConfig
from models.messages import Input

_NEVER = IntegrityConfig(time_to_alert_s=60.0)  # a level in two minutes
_SLOW = msgspec.structs.replace(LIMITS, time_to_alert_s=2.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the flight")
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    for aids, pulled in (("fixes", False), ("both", False), ("both", True)):
        flight = village("rotor", aids, args.seconds, 0)
        messages = perturbed(flight, KINDS["GNSS pulled, fixes 1 Hz"], 3.0, 0) if pulled else flight.messages
        ways = {
            name: partial(spent_s, flight, messages, c)
            for name, c in (("never", _NEVER), ("plain", IntegrityConfig()), ("limits", LIMITS), ("slow", _SLOW))
        }
        least = in_turns(ways, args.rounds)
        us = {name: 1e6 * s / len(messages) for name, s in least.items()}
        print(
            f"{aids}{', GNSS pulled' if pulled else ''}: {us['never']:.1f} us a message without levels; with limits "
            f"+{us['limits'] - us['never']:.2f} ({us['limits'] / us['never'] - 1.0:.1%}), in 2 s "
            f"+{us['slow'] - us['never']:.2f} ({us['slow'] / us['never'] - 1.0:.1%}), without limits "
            f"+{us['plain'] - us['never']:.2f} ({us['plain'] / us['never'] - 1.0:.1%}); "
            f"{held_bytes(flight, messages) / 1e3:.1f} kB",
            flush=True,
        )


def in_turns(ways: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """The least of each."""
    found = {name: list[float]() for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            found[name].append(way())
    return {name: min(times) for name, times in found.items()}


def held_bytes(flight: Flight, messages: list[Input]) -> int:
    """What estimator/integrity holds after a third of a flight with limits; tracemalloc is slow."""
    fusion = Fusion(msgspec.structs.replace(flight.config, integrity=LIMITS))
    tracemalloc.start()
    for message in messages[: len(messages) // 3]:
        fusion.handle(message)
    gc.collect()
    found = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, f"*{os.sep}estimator{os.sep}integrity{os.sep}*")])
    tracemalloc.stop()
    return sum(trace.size for trace in found.traces)


def spent_s(flight: Flight, messages: list[Input], config: IntegrityConfig) -> float:
    """Processor time of one flight."""
    fusion = Fusion(msgspec.structs.replace(flight.config, integrity=config))
    began = time.process_time()
    for message in messages:
        fusion.handle(message)
    return time.process_time() - began


if __name__ == "__main__":
    main()
