"""All flights of a list; those with a row are skipped."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
from distributed import Client

from estimator.config import ConfigError, load
from estimator.tools.fleet.engine import results
from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.flight import Settings, code, fly, key_of
from estimator.tools.fleet.results import Results, keep_configuration
from estimator.tools.fleet.rows import Row
from estimator.tools.fleet.store import Flight
from models.untrusted.file import content

KEPT_EVERY_S: Final = 10.0  # rows that came meanwhile are what the loss of this process costs


class RunSummary(msgspec.Struct, frozen=True):
    """Flights listed, known, done; failed: rows with an error; unfinished: log and reason.

    hours: of flight; memory_mb: largest worker.
    """

    label: str
    flights: int
    known: int
    done: int
    failed: int
    unfinished: dict[str, str]
    hours: float
    hours_a_core_hour: float
    read_bytes: int
    stored_bytes: int
    memory_mb: float


def settings_of(label: str, config: Path | None, truth: str, *, from_images: bool = False) -> Settings:
    """The Settings of a configuration file. Raises ConfigError."""
    if config is None:
        if from_images:
            raise ConfigError("--from-images needs the cameras and a map: give -c FILE")
        return Settings(label=label, truth=truth, code=code())
    loaded = load(config)
    images = [loaded.map.picture, loaded.map.picture_heights]
    names = [name for name in [*loaded.files().values(), *images] if name] if from_images else []
    try:
        files = {name: content(config.parent / name) for name in names}
    except OSError as error:
        raise ConfigError(f"{error.filename}: {(error.strerror or 'cannot be read').lower()}") from None
    if away := [name for name in names if Path(name).is_absolute() or ".." in Path(name).parts]:
        raise ConfigError(f"{config}: {away[0]}: a worker has the files below the configuration's folder; put it there")
    return Settings(label, loaded.toml(), truth, from_images, files, code())


def run(
    flights: Sequence[Flight],
    settings: Settings,
    folder: str,
    client: Client,
    progress: Callable[[float, str], None] = lambda _, __: None,
) -> RunSummary:
    """Compute missing rows into `folder`. Raises FleetError."""
    kept = Results(folder, settings.label)
    if settings.configuration is not None:
        keep_configuration(folder, settings.configuration)
    known = kept.keys()
    if other := [f.log for f in flights if f.log in known and known[f.log] != key_of(f, settings)]:
        raise FleetError(
            f"{other[0]}: has a row of other inputs, another configuration or another program under {settings.label}; "
            "take another --label"
        )
    left = [flight for flight in flights if flight.log not in known]
    counts, fresh = _Counts(settings.label, len(flights), len(flights) - len(left)), list[Row]()
    written_s = time.monotonic()
    try:
        for flight, result in results(client, fly, left, settings):
            if isinstance(result, FleetError):
                raise result
            if isinstance(result, Row):
                fresh.append(result)
            counts.add(flight, result)
            progress(counts.ended / max(len(left), 1), counts.text)
            if time.monotonic() - written_s > KEPT_EVERY_S:
                kept.add(fresh)
                fresh.clear()
                written_s = time.monotonic()
    finally:
        kept.add(fresh)
    kept.compact()
    return counts.summary()


class _Counts:
    def __init__(self, label: str, flights: int, known: int) -> None:
        self._label, self._flights, self._known = label, flights, known
        self._done = self._failed = self._read = self._stored = 0
        self._hours = self._cpu_h = self._memory_mb = 0.0
        self._unfinished: dict[str, str] = {}

    def add(self, flight: Flight, result: Row | Exception) -> None:
        if not isinstance(result, Row):
            self._unfinished[flight.log] = f"{type(result).__name__}: {' '.join(str(result).split())}"[:200]
            return
        self._done += 1
        self._failed += bool(result.error)
        self._hours += (result.duration_s or 0.0) / 3600.0
        self._cpu_h += result.cpu_s / 3600.0
        self._read += result.read_bytes
        self._stored += result.stored_bytes
        self._memory_mb = max(self._memory_mb, result.memory_mb)

    @property
    def ended(self) -> int:
        return self._done + len(self._unfinished)

    @property
    def text(self) -> str:
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{self._known + self._done} of {self._flights} flights, {self._hours:.1f} h{failed}"

    def summary(self) -> RunSummary:
        return RunSummary(
            label=self._label,
            flights=self._flights,
            known=self._known,
            done=self._done,
            failed=self._failed,
            unfinished=self._unfinished,
            hours=self._hours,
            hours_a_core_hour=self._hours / self._cpu_h if self._cpu_h else 0.0,
            read_bytes=self._read,
            stored_bytes=self._stored,
            memory_mb=self._memory_mb,
        )
