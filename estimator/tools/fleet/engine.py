"""dask.distributed, on this machine or a scheduler's address, at most AHEAD tasks a thread."""

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from itertools import islice
from typing import Any, Final, TypeVar

import dask
from distributed import Client, LocalCluster, as_completed

from estimator.tools.fleet.errors import FleetError

AHEAD: Final = 3
_RETRIES: Final = 3  # of a task whose store failed for longer than the store's client retries
_DASHBOARD: Final = "127.0.0.1:0"  # any free port, of this machine only
_POLL_S: Final = 0.02
_ANSWERS: Final = "10s"  # a scheduler
_ASK_S: Final = 10.0  # without a result, whether there are workers
_WITHOUT_WORKER_S: Final = 300.0  # to start again on a loaded machine, or for a cluster to grow
_REFRESH: Final = 64  # results; a cluster that grows is noticed

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def cluster(jobs: int | None, scheduler: str = "") -> Iterator[Client]:
    """A client of a scheduler, or of `jobs` processes (None: one a core). Raises FleetError."""
    if not scheduler:
        workers = jobs or os.cpu_count() or 1
        with (
            dask.config.set(
                {"distributed.deploy.lost-worker-timeout": _WITHOUT_WORKER_S}
            ),  # 15 s are too few on a loaded machine
            LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=_DASHBOARD, silence_logs=logging.CRITICAL
            ) as local,
            Client(local) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=_ANSWERS)
    except (OSError, ValueError) as error:
        raise FleetError(f"{scheduler}: no scheduler answers ({' '.join(str(error).split())[:100]})") from None
    with client:
        yield client


@contextmanager
def executor(jobs: int | None, scheduler: str = "") -> Iterator[Executor]:
    """As cluster, to those who map a function over a list."""
    with cluster(jobs, scheduler) as client:
        yield client.get_executor(retries=_RETRIES)


def results(
    client: Client, work: Callable[..., Result], items: Iterable[Item], *args: Any
) -> Iterator[tuple[Item, Result | Exception]]:
    """Results or exceptions of work(item, *args), as they end."""
    waiting, running = iter(items), dict[Any, Item]()
    finished = as_completed(with_results=False)

    def submit(count: int) -> None:
        for item in islice(waiting, count):
            future = client.submit(work, item, *args, pure=False, retries=_RETRIES)
            running[future] = item
            finished.add(future)

    submit(_width(client))
    for count, future in enumerate(_ended(client, finished)):
        item, error = running.pop(future), future.exception()
        yield item, future.result() if error is None else error
        submit(max(0, _width(client) - len(running)) if count % _REFRESH == 0 else 1)


def _ended(client: Client, finished: Any) -> Iterator[Any]:
    seen_s = time.monotonic()  # when there was a worker
    while finished.count():
        if batch := finished.next_batch(block=False):
            yield from batch
            seen_s = time.monotonic()
            continue
        time.sleep(_POLL_S)
        if time.monotonic() - seen_s > _ASK_S and client.nthreads():
            seen_s = time.monotonic()
        elif time.monotonic() - seen_s > _WITHOUT_WORKER_S:
            raise FleetError("no worker is left, and none came back; start the same command again: what is done is kept")


def _width(client: Client) -> int:
    threads: int = sum(client.nthreads().values())
    return AHEAD * max(1, threads)
