"""Processes that work for this one.

They are spawned, for forks of a process with threads (OpenCV's, a progress bar's) hang. Ctrl-C goes to all processes of a
terminal at once, but is meant for the one that the person has started; the others end with it. They are born with SIGINT blocked,
so that not even one that is still importing answers with a traceback.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess


class _Worker(SpawnProcess):
    def start(self) -> None:
        """It has the signal mask of the thread that starts it. A tracker started between would unblock SIGINT: that first.

        Ctrl-C may reach another thread meanwhile, and Python would interrupt this one: it waits until the process is known, or
        nobody would end it.
        """
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
    """`jobs` processes (None: one a core), each of which calls `begin` first. An exception in the block ends them at once."""
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
