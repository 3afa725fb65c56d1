"""Vision's process with something wrong in its looks: a kernel that compiles for seconds, answers that take long or are none."""

import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

from numba import njit
from numba.extending import overload

from estimator.frontend.processor import Processor
from estimator.service.vision import warm_up as vision_warm_up
from estimator.service.vision.wire import Ready, asked, send
from estimator.service.vision.worker import serve

SECONDS = 4.5  # longer than the patience of the tests' workers, shorter than twice that


def compiles_once(*args: Any) -> None:
    """The first look calls a kernel that nobody has compiled and that is in no cache."""
    _serve(_kernel_that_takes(SECONDS), *args)


def hangs_in_the_compiler(*args: Any) -> None:
    """The same, and it never ends."""
    _serve(_kernel_that_takes(3600.0), *args)


def every_other_look_is_slow(*args: Any) -> None:
    """Looks 2, 4, 6 ... take longer than the first patience, and nothing is compiled."""
    looks = iter(range(1, 1000))
    _serve(lambda: time.sleep(0.0 if next(looks) % 2 else SECONDS), *args)


def answers_with_a_pickle(pipe: Connection, *_: Any) -> None:
    """Ready at once; then each answer is a malformed one."""
    send(pipe, Ready(0))
    while True:
        asked(pipe)
        pipe.send([])


def _serve(first: Callable[[], object], *args: Any) -> None:
    look, warm_up = Processor.process, vision_warm_up.warm_up

    def slow(*asked: Any) -> Any:
        first()
        return look(*asked)

    def then_slow(priors_m: Sequence[float] = vision_warm_up.PRIORS_M) -> None:
        warm_up(priors_m)
        Processor.process = slow  # type: ignore[assignment, method-assign]

    vision_warm_up.warm_up = then_slow
    serve(*args)


def _kernel_that_takes(seconds: float) -> Callable[[], object]:
    def wait() -> int:
        return 0

    @overload(wait)
    def _typed() -> Callable[[], int]:
        time.sleep(seconds)
        return lambda: 0

    @njit
    def kernel() -> int:
        return wait()

    return kernel  # type: ignore[return-value]
