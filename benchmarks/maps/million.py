"""A map of a million footprints: what it costs to build, check, load and ask. `python -m benchmarks.maps.million [count]`.

The source is what a public building set looks like: OpenStreetMap's properties, no colours, houses 40 m apart in streets. Each
step runs in a process of its own, so that its peak memory is its own.
"""

import argparse
import math
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from estimator.map_files import store as map_store
from estimator.tools.maps.ambiguity import marked
from estimator.tools.maps.check import check
from models.maps.table import Defaults
from models.messages import Vec3

_ORIGIN: Vec3 = (47.0, 8.0, 400.0)
_PLACES = 1000  # asked for
_SPACING_M = 40.0


def write_source(path: Path, count: int) -> str:
    """Rectangles at all angles, as longitude and latitude."""
    rng = np.random.default_rng(count)
    side = math.ceil(math.sqrt(count))
    per_deg = np.array([111_320.0 * math.cos(math.radians(_ORIGIN[0])), 111_130.0])
    half, turn = 0.5 * rng.uniform(6.0, 20.0, (count, 1, 2)), rng.uniform(0.0, math.pi, count)
    corners = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    R = np.stack((np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)), axis=1).reshape(-1, 2, 2)
    places = _SPACING_M * (np.column_stack(np.divmod(np.arange(count), side)) - side / 2) + rng.uniform(-8.0, 8.0, (count, 2))
    lonlat = ((corners @ R + places[:, None]) / per_deg + (_ORIGIN[1], _ORIGIN[0])).round(7).reshape(count, -1).tolist()
    levels = rng.integers(1, 4, count).tolist()
    with path.open("w", encoding="ascii") as file:
        file.write('{"type":"FeatureCollection","features":[')
        for k, (a, b, c, d, e, f, g, h, i, j) in enumerate(lonlat):
            properties = f'{{"@id":"way/{k}","building":"house","building:levels":"{levels[k]}"}}'
            ring = f"[[[{a},{b}],[{c},{d}],[{e},{f}],[{g},{h}],[{i},{j}]]]"
            geometry = f'{{"type":"Polygon","coordinates":{ring}}}'
            file.write(f'{"," if k else ""}\n{{"type":"Feature","properties":{properties},"geometry":{geometry}}}')
        file.write("]}")
    return f"{path.stat().st_size / 1e6:.0f} MB"


def build(source: Path, out: Path) -> str:
    """As `landfix map build` does."""
    the_map = map_store.load(source, Defaults(origin=_ORIGIN))
    out.write_bytes(the_map.to_geojson(marked(the_map)))
    return f"{len(the_map)} landmarks, {out.stat().st_size / 1e6:.0f} MB"


def check_it(path: Path) -> str:
    """As `landfix map check` does, its defaults."""
    found = check(map_store.load(path), 50.0, 0.9)
    return f"{len(found.look_alikes)} pairs alike, {len(found.repeats)} repeated"


def origin(path: Path) -> str:
    """Where it lies, from its head."""
    begin = time.process_time()
    map_store.origin(path)
    return f"{1e3 * (time.process_time() - begin):.2f} ms"


def ask(path: Path) -> str:
    """Load it, and ask for 100 m around many places."""
    begin = time.process_time()
    the_map = map_store.load(path)
    loaded = time.process_time() - begin
    edge = 0.4 * _SPACING_M * math.sqrt(len(the_map))
    places = np.random.default_rng(0).uniform(-edge, edge, (_PLACES, 2)).tolist()
    the_map.near(0.0, 0.0, 100.0)  # compiled
    begin = time.process_time()
    found = sum(len(the_map.near(north, east, 100.0)) for north, east in places)
    asked = time.process_time() - begin
    return f"loaded in {loaded:.1f} s, {1e6 * asked / _PLACES:.0f} us for {found / _PLACES:.0f} landmarks within 100 m"


def _measured(name: str, step: Callable[[], str]) -> None:
    """One line: processor time, peak memory, and what the step says; in a process of its own."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)

    def run() -> None:
        said = step()
        used = resource.getrusage(resource.RUSAGE_SELF)
        theirs.send((said, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6))

    process = context.Process(target=run)
    process.start()
    said, seconds, gigabytes = ours.recv()
    process.join()
    print(f"{name:12} {seconds:7.1f} s  {gigabytes:5.2f} GB  {said}", flush=True)


def main() -> None:
    """All steps, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=1_000_000)
    count = parser.parse_args().count
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "footprints.geojson", Path(folder) / "map.geojson"
        _measured("source", lambda: write_source(source, count))
        _measured("build", lambda: build(source, out))
        _measured("origin", lambda: origin(out))
        _measured("load, ask", lambda: ask(out))
        _measured("check", lambda: check_it(out))


if __name__ == "__main__":
    main()
