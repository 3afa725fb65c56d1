"""The kernels that `make kernels` compiles: seconds of the processor of each, and how often Python calls it.

NUMBA_CACHE_DIR=$(mktemp -d) python -m benchmarks.speed.kernels

Writes benchmarks/results/kernels.csv. Each part of estimator.tools.kernels runs as there, two processes at a time, on an empty
cache; then once more, when every call is counted. A kernel that only kernels call has none. seconds: without the kernels that it
calls; of numba's own functions the sum. Printed: the parts, with the largest memory of each, and a loop to compare machines by.
"""

import csv
import os
import resource
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgspec
from numba.core import event
from numba.core.dispatcher import Dispatcher

from estimator.service.base import compilation
from estimator.tools import kernels

ROOT: Final = Path(__file__).parents[2]
_REPORT: Final = ROOT / "benchmarks/results/kernels.csv"


class Row(msgspec.Struct, frozen=True):
    """A part: seconds of its process, what it compiled (kernel, signature, seconds), and what it calls from Python."""

    part: str
    seconds: float
    peak_mb: float
    compiled: list[tuple[str, str, float]]
    calls: dict[str, int]


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


class Watched:
    """A part of estimator.tools.kernels that writes its row into a folder."""

    def __init__(self, part: Callable[[], None], folder: Path) -> None:
        self.part, self.folder, self.__name__ = part, folder, part.__name__

    def __call__(self) -> None:
        """In a process of its own."""
        listener = Compilations()
        event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
        self.part()
        seconds, peak_mb = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        compiled = [(kernel, signature, spent) for (kernel, signature), spent in listener.spent.items()]
        row = Row(self.__name__, seconds, peak_mb, compiled, called(self.part))
        (self.folder / f"{self.__name__}.json").write_bytes(msgspec.json.encode(row))


def called(part: Callable[[], None]) -> dict[str, int]:
    """How often a part calls each kernel from Python. Every kernel of this process is replaced by one that counts."""
    counts = Counter[str]()
    for module in list(sys.modules.values()):
        for name, kernel in list(vars(module).items()):
            if isinstance(kernel, Dispatcher) and _is_ours(kernel.py_func.__module__):
                setattr(module, name, _counting(kernel, counts))
    part()
    return dict(counts)


def _counting(kernel: Any, counts: Counter[str]) -> Callable[..., Any]:
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"

    def counted(*arguments: Any) -> Any:
        counts[name] += 1
        return kernel(*arguments)

    return counted


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in compilation.PACKAGES


def table(rows: list[Row]) -> list[list[Any]]:
    """kernel, signatures, seconds, parts that compile it, calls of each part; the dearest first."""
    seconds, signatures, parts = defaultdict[str, float](float), defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    for row in rows:
        for kernel, signature, spent in row.compiled:
            name = kernel if _is_ours(kernel) else "numba's own"
            seconds[name] += spent
            signatures[name].add(signature)
            parts[name].add(row.part.strip("_"))
    return [
        [name, len(signatures[name]), f"{spent:.3f}", " ".join(sorted(parts[name])), *(row.calls.get(name, 0) for row in rows)]
        for name, spent in sorted(seconds.items(), key=lambda item: -item[1])
    ]


def calibration_s() -> float:
    """Seconds of the processor for three million additions."""
    start, total = time.process_time(), 0
    for k in range(3_000_000):
        total += k
    return time.process_time() - start


def main() -> None:
    cache = Path(os.environ.get("NUMBA_CACHE_DIR", "."))
    if any(cache.iterdir()):
        sys.exit("NUMBA_CACHE_DIR has to name an empty folder")
    watched = [Watched(part, cache) for part in kernels.PARTS]
    kernels.prepare(kernels.each_tenth("compiling"), watched)
    rows = [msgspec.json.decode((cache / f"{part.__name__}.json").read_bytes(), type=Row) for part in watched]
    with _REPORT.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["kernel", "signatures", "seconds", "parts", *(f"calls{row.part}" for row in rows)])
        writer.writerows(table(rows))
    for row in rows:
        print(f"{row.part.strip('_'):14} {row.seconds:6.1f} s  {row.peak_mb:4.0f} MB  {len(row.compiled)} signatures")
    print(f"{sum(row.seconds for row in rows):6.1f} s in all; three million additions take {calibration_s():.2f} s")


if __name__ == "__main__":
    main()
