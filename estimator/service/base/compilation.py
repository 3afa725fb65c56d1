"""numba's compiler: what it compiles now, and validity of its cache.

numba checks a kernel's own file only. Kernels also use kernels and constants of other files, so any changed file discards all
compiled kernels.
"""

import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from numba.core import event
from numba.core.dispatcher import Dispatcher

_ROOT: Final = Path(__file__).parents[3]
PACKAGES: Final = ("models", "vision", "estimator", "logs", "calib")
_CONSTANTS: Final = ("models", "vision")  # packages whose files hold what kernels of other files read
_STAMP: Final = "landfix.kernels"

Heard = Callable[[str, float], None]  # kernel that is begun; "" and its seconds when it is done


class _Listener(event.Listener):
    """Reports kernels as they are compiled; of nested ones the outermost only."""

    def __init__(self, heard: Heard) -> None:
        self._heard, self._depth, self._since_s = heard, 0, 0.0

    def on_start(self, event: Any) -> None:
        """A kernel is begun."""
        if self._depth == 0:
            self._since_s = time.perf_counter()
            kernel = event.data["dispatcher"].py_func
            self._heard(f"{kernel.__module__}.{kernel.__qualname__}", 0.0)
        self._depth += 1

    def on_end(self, event: Any) -> None:  # noqa: ARG002
        """A kernel is compiled, or failed."""
        self._depth -= 1
        if self._depth == 0:
            self._heard("", time.perf_counter() - self._since_s)


def listen(heard: Heard) -> None:
    """Call `heard` when this process compiles; cached kernels are not compiled."""
    event.register("numba:compile", _Listener(heard))  # type: ignore[no-untyped-call]


def is_current() -> bool:
    """Whether all was compiled from the sources as they are now."""
    stamp = _stamp()
    there = stamp.is_file() and any(stamp.parent.glob("*.nbi"))
    return there and stamp.read_text(encoding="utf-8") == _digest()


def mark_current() -> None:
    """Everything has been compiled from the sources as they are now."""
    _stamp().write_text(_digest(), encoding="utf-8")


def forget() -> None:
    """Delete every compiled kernel of ours, wherever numba keeps it."""
    folders = {_cache_of(kernel) for module in _modules() for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}
    for folder in folders:
        for compiled in folder.glob("*.nb[ic]"):
            compiled.unlink(missing_ok=True)


def _modules() -> Iterator[Any]:
    for path in _sources():
        if b"njit" in path.read_bytes() and path != Path(__file__):
            yield import_module(".".join(path.relative_to(_ROOT).with_suffix("").parts))


def _sources() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (_ROOT / package).rglob("*.py"))


def _digest() -> str:
    digest = sha256(version("numba").encode())
    for path in _sources():
        relative, text = path.relative_to(_ROOT), path.read_bytes()
        if relative.parts[0] in _CONSTANTS or b"njit" in text:
            digest.update(str(relative).encode() + text)
    return digest.hexdigest()


def _stamp() -> Path:
    from models import so3  # noqa: PLC0415  (not needed to listen)

    return _cache_of(so3.multiply) / _STAMP


def _cache_of(kernel: Any) -> Path:
    return Path(kernel.stats.cache_path)
