"""A simulation as a log, and its configuration."""

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from logs.store.recorder import Recorder
from logs.wire.codec import Encoded, encode_input, encode_truth
from models.sim.scenario import Simulation

_PROGRESS_EVERY = 2000  # messages


class Images(Protocol):
    """Messages with their times of arrival, in order: flight_images.Flight."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[int, Encoded]]: ...


def write(
    simulation: Simulation,
    out: Path,
    progress: Callable[[float], None] | None = None,
    images: Images = (),
) -> int:
    """Write `out`; number of messages. At equal times: sensors, truth, images."""
    total = len(simulation.messages) + len(simulation.truth.t_ns) + len(images)
    inputs = ((m.arrived_ns, 0, encode_input(m)) for m in simulation.messages)
    shots = ((arrived_ns, 2, message) for arrived_ns, message in images)
    with Recorder(out) as recorder:
        merged = heapq.merge(inputs, _truth(simulation), shots, key=lambda item: item[:2])
        for count, (log_time_ns, _, encoded) in enumerate(merged):
            recorder.write(*encoded, log_time_ns)
            if progress and count % _PROGRESS_EVERY == 0:
                progress(count / total)
    return total


def _truth(simulation: Simulation) -> Iterator[tuple[int, int, Encoded]]:
    truth = simulation.truth
    for t_ns, p_n, v_n, q_nb in zip(truth.t_ns.tolist(), truth.p_n, truth.v_n, truth.q_nb_wxyz, strict=True):
        yield t_ns, 1, encode_truth(t_ns, p_n, v_n, q_nb)
