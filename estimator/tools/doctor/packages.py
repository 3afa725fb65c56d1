"""Packages that hide ours, or are missing; standard library only."""

import importlib.util
from importlib import metadata
from pathlib import Path
from typing import Final

NAMES: Final = ("landfix", "estimator", "vision", "models", "calib", "logs")
EXTRA_OF: Final = {
    "matplotlib": "tools", "PIL": "tools", "pyulog": "tools", "pandas": "export", "pyarrow": "export", "pyogrio": "geo",
    "pyproj": "geo", "foxglove": "live", "dask": "fleet", "distributed": "fleet", "fsspec": "fleet",
    "duckdb": "fleet",
}  # fmt: skip
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


def explain(error: ImportError) -> str | None:
    """Cause and remedy of a failed import, one line; None if neither clash nor extra."""
    top = (error.name or "").partition(".")[0]
    if top in NAMES and (found := clashes()):
        return f"{found[0]}: rename or uninstall it, or take it off PYTHONPATH; best is an environment of its own (uv tool, venv)"
    if top in EXTRA_OF:
        return f"this needs {top}, which is not installed: pip install 'landfix[{EXTRA_OF[top]}]'"
    return _CAMERAS if top == "cv2" else None
