"""Packages that hide ours, are missing, or cannot begin; standard library only."""

import importlib.util
import os
import traceback
from importlib import metadata
from pathlib import Path
from typing import Final

NAMES: Final = ("landfix", "estimator", "vision", "models", "calib", "logs")
EXTRA_OF: Final = {
    "matplotlib": "tools", "PIL": "tools", "pyulog": "tools", "pandas": "export", "pyarrow": "export", "pyogrio": "geo",
    "pyproj": "geo", "foxglove": "live", "dask": "fleet", "distributed": "fleet", "fsspec": "fleet",
    "duckdb": "fleet",
}  # fmt: skip
_VARIABLES: Final = {"matplotlib": "MPL"}  # beginning of the names of a package's variables, if it is another than its own
_CAMERAS: Final = "this needs OpenCV, which an installation without cameras leaves out: pip install opencv-python-headless"


def clashes() -> list[str]:
    """What hides our packages or writes into their folders, a line each."""
    root = Path(__file__).resolve().parents[3]
    found = []
    for name in NAMES:
        spec = importlib.util.find_spec(name)
        places = [Path(place).resolve() for place in (spec.submodule_search_locations or [])] if spec else []
        if not places and spec and spec.origin:
            places = [Path(spec.origin).resolve()]
        if not places:
            found.append(f"{name} is missing from {root}")
        elif places[0] != root / name:
            found.append(f"{name} is taken from {places[0]} and hides {root / name}")
    owners = metadata.packages_distributions()
    for name in NAMES:
        others = sorted({owner for owner in owners.get(name, ()) if owner.lower() != "landfix"})
        if others:
            found.append(f"{name} is also a package of {', '.join(others)}")
    return found


def explain(error: Exception) -> str | None:
    """Cause and remedy of what packages or the environment did to a command, one line; None if neither did."""
    top = (getattr(error, "name", None) or "").partition(".")[0] if isinstance(error, ImportError) else ""
    if top in NAMES and (found := clashes()):
        return f"{found[0]}: rename or uninstall it, or take it off PYTHONPATH; best is an environment of its own (uv tool, venv)"
    if top in EXTRA_OF:
        return f"this needs {top}, which is not installed: pip install 'landfix[{EXTRA_OF[top]}]'"
    if top == "cv2":
        return _CAMERAS
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    modules = [str(frame.f_globals.get("__name__", "")).partition(".")[0] for frame in frames]
    if any(frame.f_globals.get("__name__") == "numba.core.caching" for frame in frames):
        return f"compiled code cannot be kept: {error}: free its disk, or set NUMBA_CACHE_DIR to a folder that can be written"
    begins = 1 + max((k for k, name in enumerate(modules) if name in NAMES), default=len(modules))
    if begins >= len(frames) or frames[begins].f_code.co_name != "<module>":
        return None
    name = modules[begins]
    given = [f"{key}={value}" for key, value in os.environ.items() if key.startswith(_VARIABLES.get(name, name.upper()))]
    return f"{name} cannot begin: {error}" + (f": unset or correct {', '.join(sorted(given))}" if given else "")
