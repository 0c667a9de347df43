"""The processes that a fleet works on: those of this machine, or any cluster of dask.distributed by its address.

Those of this machine are copies of one that has imported what all of them need (multiprocessing's server of forks), so
that it is imported once whatever their number, and again for none that takes the place of one that died. Where a system
has no such server each imports by itself.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from highside.errors import InputError
from highside.fleet.catalogue import INSTALL
from highside.fleet.policy import TASKS

__all__ = ["cluster_client"]

SETTINGS: dict[str, Any] = {
    # what a process that died was working on is given out by us; the scheduler need not try it on others first
    "distributed.scheduler.allowed-failures": 0,
    "distributed.worker.daemon": False,
    # as multiprocessing begins processes, see `_copies_of_one`
    "distributed.worker.multiprocessing-method": None,
    # what each process does beside its work many times a second: its stack, its delay, its load, its memory
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.scheduler.work-stealing-interval": "1s",
    "distributed.scheduler.active-memory-manager.start": False,
    # dask's own gives the heap back to the kernel from 64 KiB on, and each recording asks for it again: 4 to 6 % of a
    # solution (1,000 sessions)
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1
    ),
    # pages over HTTP, see `local_nodes`; what answers them is not imported then
    "distributed.worker.http.routes": [],
}
WITHOUT_PAGES: dict[str, Any] = {"distributed.scheduler.http.routes": []}
MODULES = (
    "highside.fleet.copied",
    "distributed",
    "highside.fleet.local_nodes",
    "highside.fleet.run",
    "pyarrow.parquet",
)
"""what every process needs"""
SILENT = 50
"""level of logging at and above which dask's messages are shown: those of what ends it"""


@contextmanager
def cluster_client(
    workers: int | None,
    scheduler: str | None,
    modules: Sequence[str] = (),
    *,
    dashboard: bool = False,
    option: str = "--scheduler",
) -> Iterator[Any]:
    """A client of `workers` processes of this machine that have imported `modules` too, ended with it, or of the
    cluster at an address, which `option` gave. `dashboard`: dask's page of what the processes of this machine do, on a
    port of its own; without it nothing is listened on but what they tell one another by, and all of it on the loopback
    interface. Raises InputError where dask.distributed is missing or the cluster cannot be reached."""
    try:
        import dask
        from distributed import Client, SpecCluster

        from highside.fleet.local_nodes import scheduler_of, worker_of
    except ImportError:
        raise InputError("a fleet needs dask.distributed, which is not installed", remedy=INSTALL) from None
    with dask.config.set(SETTINGS):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be reached: {error}", where=scheduler, field=option) from None
            with client:
                yield client
            return
        count = workers or os.cpu_count() or 1
        worker = worker_of(count)
        with (
            dask.config.set({} if dashboard else WITHOUT_PAGES),
            _copies_of_one((*MODULES, *modules)),
            SpecCluster(
                scheduler=scheduler_of(dashboard=dashboard),
                worker=worker,
                workers=dict.fromkeys(range(count), worker),
                silence_logs=SILENT,
            ) as cluster,
            Client(cluster) as client,
            _kept_up(cluster, count),
        ):
            yield client


@contextmanager
def _copies_of_one(modules: Sequence[str]) -> Iterator[None]:
    """Processes that multiprocessing begins meanwhile are copies of one that has imported these modules. That process
    begins with the first of them, when dask has set what the environment says of threads, and has one thread."""
    before = multiprocessing.get_start_method(allow_none=True)
    if "forkserver" in multiprocessing.get_all_start_methods():
        multiprocessing.get_context("forkserver").set_forkserver_preload(list(modules))
        multiprocessing.set_start_method("forkserver", force=True)
    else:
        multiprocessing.set_start_method("spawn", force=True)
    try:
        yield
    finally:
        multiprocessing.set_start_method(before, force=True)


@contextmanager
def _kept_up(cluster: Any, count: int) -> Iterator[None]:
    """Ask for `count` processes again and again: dask begins no other in the place of one that dies while it starts, or
    is 15 s in starting anew (a busy machine), and a cluster that has lost all of them so would wait for ever."""
    ended = threading.Event()

    def ask() -> None:
        while not ended.wait(TASKS.ask_again_s):
            cluster.scale(count)

    thread = threading.Thread(target=ask, name="fleet workers", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
