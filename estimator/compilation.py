"""The compiler of kernels, numba: what it is at, and all that a flight or a demonstration needs, compiled before it begins."""

import time
from collections.abc import Callable
from typing import Any

from numba.core import event

Heard = Callable[[str, float], None]  # kernel that is begun; "" and its seconds when it is done


class _Listener(event.Listener):
    """Hears of kernels that are compiled; of those that one of them calls only the outermost is told."""

    def __init__(self, heard: Heard) -> None:
        self._heard, self._depth, self._since_s = heard, 0, 0.0

    def on_start(self, event: Any) -> None:
        """A kernel is begun."""
        if self._depth == 0:
            self._since_s = time.perf_counter()
            self._heard(name_of(event.data["dispatcher"]), 0.0)
        self._depth += 1

    def on_end(self, event: Any) -> None:  # noqa: ARG002
        """It is done, or has failed."""
        self._depth -= 1
        if self._depth == 0:
            self._heard("", time.perf_counter() - self._since_s)


def listen(heard: Heard) -> None:
    """Call `heard` from now on when this process compiles; a kernel that is loaded from the cache is not compiled."""
    event.register("numba:compile", _Listener(heard))


def name_of(dispatcher: Any) -> str:
    """Module and name of a kernel."""
    return f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
