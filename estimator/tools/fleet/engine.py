"""dask.distributed, on this machine or a scheduler's address, at most _AHEAD tasks a thread."""

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from itertools import islice
from typing import Any, Final, TypeVar

from distributed import Client, LocalCluster, as_completed

from estimator.tools.fleet.errors import FleetError

_AHEAD: Final = 3
_RETRIES: Final = 3  # of a task whose store failed for longer than the store's client retries
_DASHBOARD: Final = "127.0.0.1:0"  # any free port, of this machine only
_REFRESH: Final = 64  # results; a cluster that grows is noticed

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def cluster(jobs: int | None, scheduler: str = "") -> Iterator[Client]:
    """A client of that scheduler, or of `jobs` local processes (None: one a core). Raises FleetError."""
    if not scheduler:
        workers = jobs or os.cpu_count() or 1
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=_DASHBOARD, silence_logs=logging.CRITICAL
            ) as local,
            Client(local) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout="10s")
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
    for count, future in enumerate(finished):
        item, error = running.pop(future), future.exception()
        yield item, future.result() if error is None else error
        submit(max(0, _width(client) - len(running)) if count % _REFRESH == 0 else 1)


def _width(client: Client) -> int:
    threads: int = sum(client.nthreads().values())
    return _AHEAD * max(1, threads)
