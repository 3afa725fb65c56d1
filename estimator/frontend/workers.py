"""Worker processes: spawned (forks of threads hang), SIGINT blocked."""

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess


class _Worker(SpawnProcess):
    def start(self) -> None:
        """Start with the parent thread's signal mask, after the resource tracker."""
        self.daemon = True  # terminated with this process
        resource_tracker.ensure_running()
        before, held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}), list[int]()
        handler = signal.getsignal(signal.SIGINT)
        holds = handler is not None and threading.current_thread() is threading.main_thread()
        if holds:
            signal.signal(signal.SIGINT, lambda number, _: held.append(number))
        try:
            super().start()
        finally:
            if holds:
                signal.signal(signal.SIGINT, handler)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            if held:
                signal.raise_signal(signal.SIGINT)


class _Workers(SpawnContext):
    Process = _Worker


SPAWNED = _Workers()


@contextmanager
def pool(jobs: int | None, begin: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """`jobs` processes (None: one a core) that call `begin` first."""
    others = set(active_children())
    executor = ProcessPoolExecutor(jobs, SPAWNED, begin)
    try:
        yield executor
    except BaseException:
        for worker in set(active_children()) - others:
            worker.terminate()
        executor.shutdown(cancel_futures=True)  # waits for the executor's thread, which joins them
        raise
    executor.shutdown()
