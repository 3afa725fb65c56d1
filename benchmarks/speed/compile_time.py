"""What it costs to compile the kernels: seconds of the processor by kernel and signature, on an empty cache, most costly first.

python -m benchmarks.speed.compile_time replay
python -m benchmarks.speed.compile_time demo --top 40

replay: IMU, GNSS and late fixes through decoder, estimator and encoders. demo: the same, the images of a short flight drawn,
looked at and replayed. The time of a kernel is without that of the kernels it calls. All runs in this process, one thread; the
command that compiles before the demonstration (estimator.tools.kernels) takes less, as it collects no garbage.
"""

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from numba.core import config, event

_REPLAY: Final = """
duration_s = 20.0
origin = [47.3977, 8.5456, 488.0]
[gnss]
outages_s = [[8.0, 20.0]]
[pose_fix]
delay_s = 0.3
outages_s = [[12.0, 15.0]]
"""
_DEMO: Final = """
duration_s = 54.0
origin = [47.3977, 8.5456, 488.0]
[vehicle]
kind = "multirotor"
speed_m_s = 8.0
area_m = 160.0
climb_m_s = 5.0
height_m = 75.0
[gnss]
outages_s = [[30.0, 54.0]]
[cameras]
rate_hz = 0.5
outages_s = [[0.0, 26.0]]
dark_s = [[40.0, 46.0]]
[cameras.world]
painted = 0.7
unmapped = 0.15
"""


class Compilations(event.Listener):
    """Listens to numba: seconds of the processor of each (kernel, signature), without what is compiled inside it."""

    def __init__(self) -> None:
        self.spent: dict[tuple[str, str], float] = defaultdict(float)
        self._open: list[tuple[float, float]] = []  # start, and what was compiled inside

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        """One begins, perhaps inside another."""
        self._open.append((time.process_time(), 0.0))

    def on_end(self, event: Any) -> None:
        """It is done, or has failed."""
        start, inner = self._open.pop()
        whole = time.process_time() - start
        kernel = event.data["dispatcher"].py_func
        self.spent[f"{kernel.__module__}.{kernel.__qualname__}", ", ".join(map(str, event.data["args"]))] += whole - inner
        if self._open:
            outer, so_far = self._open[-1]
            self._open[-1] = outer, so_far + whole


def _replay(folder: Path) -> None:
    from estimator.config import load  # noqa: PLC0415
    from estimator.replay import simulate as simulated  # noqa: PLC0415  (here: not before the cache's folder is set)
    from estimator.replay.replay import replay  # noqa: PLC0415
    from models.sim.scenario import simulate  # noqa: PLC0415
    from models.sim.scenario_file import loads  # noqa: PLC0415

    simulation = simulate(loads(_REPLAY), 0)
    (folder / "flight.toml").write_text(simulation.config_toml, encoding="utf-8")
    simulated.write(simulation, folder / "flight.mcap")
    replay(folder / "flight.mcap", folder / "estimate.mcap", load(folder / "flight.toml"))


def _demo(folder: Path) -> None:
    from estimator.replay import flight_images  # noqa: PLC0415
    from estimator.service import warm_up  # noqa: PLC0415
    from estimator.service.vision import warm_up as vision_warm_up  # noqa: PLC0415
    from estimator.tools import demo  # noqa: PLC0415

    warm_up.warm_up()
    vision_warm_up.warm_up()
    flight_images.pool = _here  # type: ignore[attr-defined, assignment]
    demo.demo(folder, seed=1, scenario=_DEMO)


@contextmanager
def _here(_: int | None, begin: Callable[[], None]) -> Iterator[Any]:
    """A pool of this process alone."""
    begin()

    class Here:
        @staticmethod
        def map(do: Callable[[int], Any], each: range, chunksize: int) -> Iterator[Any]:  # noqa: ARG004
            return map(do, each)

    yield Here


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", choices=("replay", "demo"))
    parser.add_argument("--top", type=int, default=1000, help="rows of the table")
    asked = parser.parse_args()
    listener = Compilations()
    with tempfile.TemporaryDirectory() as folder:
        config.CACHE_DIR = str(Path(folder) / "cache")  # type: ignore[attr-defined]
        event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
        start = time.process_time()
        {"replay": _replay, "demo": _demo}[asked.path](Path(folder))
        whole = time.process_time() - start
    rows = sorted(listener.spent.items(), key=lambda row: -row[1])
    for (kernel, signature), seconds in rows[: asked.top]:
        print(f"{seconds:7.2f} s  {kernel}({signature})")
    print(f"{sum(listener.spent.values()):7.2f} s  {len(rows)} signatures of {len({k for k, _ in listener.spent})} kernels")
    print(f"{whole:7.2f} s  the whole run", file=sys.stderr)


if __name__ == "__main__":
    main()
