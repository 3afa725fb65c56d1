"""One flight on a worker: fetch, import, replay, evaluate, row."""

import resource
import time
from collections.abc import Callable
from functools import lru_cache
from hashlib import sha256
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import msgspec

from estimator.config import Config, ConfigError, parse, read, recorded
from estimator.replay.from_images import seen_again
from estimator.replay.replay import OWN_INPUTS, OWN_PREFIX, SeesAgain, logged, replay
from estimator.replay.summary import SummaryBuilder
from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.rows import Row, of_evaluation
from estimator.tools.fleet.selected import copy_selected
from estimator.tools.fleet.store import Flight, open_at
from estimator.version import version
from logs.evaluation.collected import TRUTH_TOPIC, Collected, Collector
from logs.evaluation.evaluate import MOST, assess
from logs.importers import convert, kind_of_name
from logs.store.parts import PartsReader
from logs.store.reader import LogError

_PACKAGES: Final = ("estimator", "vision", "models", "calib", "logs")
_OF_SUMMARY: Final = ("first_estimate_s", "internal_errors", "torn", "skipped_chunks", "missing")
_SLOWEST_HZ: Final = 0.01
_ROOT: Final = Path(__file__).parents[3]


class Settings(msgspec.Struct, frozen=True):
    """Common to all flights of a run.

    configuration: TOML text, None: each log's; truth: topic; from_images: files (path -> content); code: equal on the worker.
    """

    label: str
    configuration: str | None = None
    truth: str = TRUTH_TOPIC
    from_images: bool = False
    files: dict[str, bytes] = {}
    code: str = ""


@lru_cache(maxsize=1)
def code() -> str:
    """sha256 of the source files: equal programs make equal rows."""
    digest = sha256(version().encode())
    for package in _PACKAGES:
        for file in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{file.relative_to(_ROOT)}\0".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def key_of(flight: Flight, settings: Settings) -> str:
    """The identity of a row."""
    files = sorted((name, sha256(content).hexdigest()) for name, content in settings.files.items())
    parts = flight.log, flight.state, settings.configuration, settings.truth, settings.from_images, files, settings.code
    return sha256(repr(parts).encode()).hexdigest()[:32]


def fly(flight: Flight, settings: Settings) -> Row:
    """The row of the flight. Raises OSError (store), FleetError (another program here)."""
    if code() != settings.code:
        raise FleetError(f"a worker runs another landfix ({code()}) than this one ({settings.code}): install the same there")
    cpu_s, wall_s = time.process_time(), time.monotonic()
    row: dict[str, Any] = {
        "key": key_of(flight, settings),
        "label": settings.label,
        "log": flight.log,
        "parts": len(flight.parts),
        "stored_bytes": flight.stored_bytes,
        "version": version(),
        "code": settings.code,
        "from_images": settings.from_images,
    }
    with TemporaryDirectory(prefix="landfix-") as scratch:
        try:
            row |= _result(flight, settings, Path(scratch), row)
        except (OSError, MemoryError):  # of the store or this machine: elsewhere, or later, it may go well
            raise
        except Exception as error:  # of this log and this program: it would come again
            row["error"] = _one_line(error).replace(scratch, flight.log.rpartition("/")[0])
    return Row(
        **row,
        cpu_s=time.process_time() - cpu_s,
        wall_s=time.monotonic() - wall_s,
        memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    )


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, LogError | ConfigError) else f"internal error: {type(error).__name__}: {text}"


def _result(flight: Flight, settings: Settings, scratch: Path, row: dict[str, Any]) -> dict[str, Any]:
    collected = _collected(_prepared(flight, settings, scratch, row), settings.truth, row)
    found = of_evaluation(assess(collected, flight.log, relative=False))
    if collected.origin is not None:
        found |= {"lat_deg": collected.origin.lla[0], "lon_deg": collected.origin.lla[1]}
    return found


class _Prepared(NamedTuple):
    files: list[Path]
    config: Config
    processor: SeesAgain | None


def estimate(flight: Flight, settings: Settings, scratch: Path) -> Path:
    """The replayed log in `scratch`. Raises LogError without estimate."""
    files, config, processor = _prepared(flight, settings, scratch, {})
    out = scratch / "estimate.mcap"
    summary = replay(files, out, _sparse(config), processor=processor)
    if summary.advice:
        raise LogError(f"no estimate: {summary.advice}")
    return out


def _prepared(flight: Flight, settings: Settings, scratch: Path, row: dict[str, Any]) -> _Prepared:
    config = parse(settings.configuration) if settings.configuration is not None else None
    files, own = _local(flight, _wanted(config, settings.truth, images=settings.from_images), scratch, row)
    with PartsReader(files) as reader:
        row["start_utc_s"] = next((record.log_time_ns * 1e-9 for record in reader), None)
        row["imported_as"] = reader.imported_as
        if config is None:
            config = own or recorded(reader.attachments, "the log")
    row["configuration_sha256"] = sha256(config.toml().encode()).hexdigest()
    row["vehicle"] = config.bounds.vehicle
    if not settings.from_images:
        return _Prepared(files, config, None)
    return _Prepared(files, config, seen_again(config, _written(settings.files, scratch / "vehicle"), files))


def _collected(prepared: _Prepared, truth: str, row: dict[str, Any]) -> Collected:
    files, config, processor = prepared
    collector, builder = Collector(truth, MOST), SummaryBuilder(watch=False)
    with PartsReader(files) as reader:
        for message in logged(reader, _sparse(config), builder, processor):
            collector.add(*message)
    summary = builder.summary(0.0, reader.torn, reader.skipped_chunks, reader.missing, reader.imported_as)
    row |= {name: getattr(summary, name) for name in _OF_SUMMARY}
    if summary.advice:
        raise LogError(f"no estimate: {summary.advice}")
    return collector.collected(files[0], tuple(reader.attachments))


def _local(flight: Flight, wanted: Callable[[str], bool], scratch: Path, row: dict[str, Any]) -> tuple[list[Path], Config | None]:
    files, digest, made = list[Path](), sha256(), None
    row["read_bytes"] = 0
    for address in flight.parts:
        fs, path = open_at(address)
        name = PurePosixPath(path).name
        kind = kind_of_name(name)
        copied = copy_selected(fs, path, scratch / name, wanted)
        row["read_bytes"] += copied.read_bytes
        digest.update(copied.digest.encode())
        file = scratch / name
        if kind:
            file = scratch / f"{name}.mcap"
            convert(kind, scratch / name, file)
            made = read(file.with_suffix(".toml"))
            (scratch / name).unlink()
        files.append(file)
    row["inputs_sha256"] = digest.hexdigest()
    return files, made


def _sparse(config: Config) -> Config:
    return msgspec.structs.replace(config, output=msgspec.structs.replace(config.output, slow_rate_hz=_SLOWEST_HZ))


def _written(files: dict[str, bytes], folder: Path) -> Path:
    folder.mkdir()
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def _wanted(config: Config | None, truth: str, *, images: bool) -> Callable[[str], bool]:
    if config is None:
        return lambda topic: "image" not in topic and (topic in OWN_INPUTS or not topic.startswith(OWN_PREFIX))
    topics = {topic for value in msgspec.structs.asdict(config.inputs).values() for topic in _flat(value)}
    seen = set() if images else {*config.inputs.left_image, *config.inputs.right_image}
    return (topics - seen | OWN_INPUTS | {truth}).__contains__


def _flat(value: str | tuple[str, ...]) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else value
