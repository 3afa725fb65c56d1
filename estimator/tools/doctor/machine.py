"""Checks of the machine, a configuration and a log, each with advice."""

import ctypes
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from enum import StrEnum
from importlib import metadata
from pathlib import Path

import msgspec
import numpy as np

from estimator.config import Config, read, with_origin
from estimator.strict_toml import ConfigError
from estimator.tools.doctor.packages import clashes
from models import so3

_MIN_FREE_BYTES, _GOOD_FREE_BYTES = 5e8, 5e9
_CLOCK_WATCH_S = 0.3
_TIMEX_BYTES, _TIME_ERROR = 512, 5  # of adjtimex: more than a struct timex has; the clock is not synchronised
_CLOCK_LIMIT_PPM = 1000.0  # an adjusted clock is slewed by 500 ppm at most; more is a step

# From a tactical-grade gyroscope on foam to a consumer MEMS next to a propeller.
TYPICAL_NOISE = {
    "gyro_noise": (1e-5, 5e-2),
    "accel_noise": (1e-4, 2.0),
    "gyro_walk": (1e-8, 1e-2),
    "accel_walk": (1e-7, 1e-1),
    "gyro_scale": (0.0, 5e-2),
}


class State(StrEnum):
    """How a check came out."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


class Check(msgspec.Struct, frozen=True):
    """advice: remedy or empty."""

    name: str
    state: State
    found: str
    advice: str = ""


def judge(name: str, found: str, *, fail: bool = False, warn: bool = False, advice: str = "") -> Check:
    """A Check, with advice if needed."""
    state = State.FAIL if fail else State.WARN if warn else State.OK
    return Check(name, state, found, "" if state is State.OK else advice)


def failed(checks: Iterable[Check]) -> bool:
    """Whether anything failed."""
    return any(c.state is State.FAIL for c in checks)


def machine() -> list[Check]:
    """Python, libraries, clashing names, numba's cache, processors, disk, clock."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    free = shutil.disk_usage(Path.cwd()).free
    return [
        judge("python", platform.python_version(), fail=sys.version_info < (3, 11), advice="landfix needs Python 3.11 or newer"),
        judge("libraries", ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "scipy", "numba", "mcap"))),
        _names(),
        _numba_cache(),
        judge("processors", str(cpus), warn=cpus < 2, advice="vision and estimator want a core each"),
        judge("free disk", f"{free / 1e9:.1f} GB here", fail=free < _MIN_FREE_BYTES, warn=free < _GOOD_FREE_BYTES,
              advice="a log with images takes 1-10 GB an hour"),
        _clock(),
        _synchronised(),
    ]  # fmt: skip


def _names() -> Check:
    found = clashes()
    advice = "rename or uninstall it, or take it off PYTHONPATH; best is an environment of its own (uv tool, venv)"
    return judge("package names", "; ".join(found) or "no other package has ours", fail=bool(found), advice=advice)


def _numba_cache() -> Check:
    so3.normalise(np.array([1.0, 0.0, 0.0, 0.0]))
    folder = Path(str(so3.normalise.stats.cache_path))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return judge("numba cache", f"{folder}: {error.strerror}", warn=True, advice="set NUMBA_CACHE_DIR to a writable folder")
    return judge("numba cache", str(folder))


def _clock() -> Check:
    wall, steady = time.time_ns(), time.monotonic_ns()
    time.sleep(_CLOCK_WATCH_S)
    elapsed = time.monotonic_ns() - steady
    ppm = abs(time.time_ns() - wall - elapsed) / elapsed * 1e6
    found = f"wall clock within {ppm:.0f} ppm of the steady one over {_CLOCK_WATCH_S} s"
    return judge(
        "clock", found, warn=ppm > _CLOCK_LIMIT_PPM, advice="something sets the clock; let chrony slew it before the flight"
    )


def _synchronised() -> Check:
    """The kernel's clock state: adjtimex(2), read only."""
    unset = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)) == _TIME_ERROR
    advice = "synchronise it with chrony or PTP, or set it by hand: MAVLink signatures, log names and foreign stamps need it"
    return judge("system clock", "not synchronised" if unset else "synchronised by NTP, PTP or GNSS", warn=unset, advice=advice)


def configuration(path: Path | None) -> tuple[list[Check], Config | None]:
    """Does the file load, and do its numbers make sense?"""
    try:
        config = read(path) if path else Config()
    except (ConfigError, OSError) as error:
        what = "lists all keys" if path is None or path.exists() else f"> {path} writes one"
        return [judge("config", str(error), fail=True, advice=f"landfix doctor --config --all {what}")], None
    checks = [judge("config", str(path) if path else "defaults")]
    for name, (low, high) in TYPICAL_NOISE.items():
        value = getattr(config.imu, name)
        found = f"{value:g} (typical {low:g} to {high:g})"
        advice = "units are rad, m, s and sqrt(Hz), gyro_scale is a share; data sheets give degrees/hour, ug and percent"
        checks.append(judge(f"imu.{name}", found, warn=not low <= value <= high, advice=advice))
    folder = path.parent if path else Path()
    known = config.map
    named = {"map.landmarks": known.landmarks, "map.picture": known.picture, "map.picture_heights": known.picture_heights}
    named |= {"rig.file": config.rig.file}
    files = [_file(key, folder / given) for key, given in named.items() if given]
    if not failed(files):
        try:
            config = with_origin(config, folder)
        except ConfigError as error:
            files.append(judge("map.origin", str(error), fail=True, advice="landfix map check shows what is wrong with the file"))
    return checks + files, config


def _file(key: str, file: Path) -> Check:
    return judge(key, str(file), fail=not file.is_file(), advice="no such file; paths count from the config's folder")
