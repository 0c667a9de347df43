"""The scheduler and the workers of a fleet on this machine: dask's own, without their servers of HTTP.

Each of dask's listens for HTTP whether a dashboard was asked for or not, the scheduler on port 8787. Here the scheduler
does where the dashboard is asked for, and no worker does. What they tell one another by is bound to the loopback
interface, each on a port of its own.
"""

from __future__ import annotations

from typing import Any

from distributed import Nanny, Scheduler, Worker

__all__ = ["scheduler_of", "worker_of"]

HERE = "127.0.0.1"


class QuietScheduler(Scheduler):
    """Listens for HTTP at the address of its dashboard, if it was given one."""

    def start_http_server(self, routes: Any, dashboard_address: Any, *args: Any, **kwargs: Any) -> None:
        """As dask does it where there is an address, else nothing."""
        if dashboard_address is not None:
            super().start_http_server(routes, dashboard_address, *args, **kwargs)  # type: ignore[no-untyped-call]


class QuietWorker(Worker):
    """Does not listen for HTTP."""

    def start_http_server(self, routes: Any, dashboard_address: Any, *args: Any, **kwargs: Any) -> None:
        """Nothing: what workers do is on the page of the scheduler."""


def scheduler_of(*, dashboard: bool) -> dict[str, Any]:
    """What a `SpecCluster` begins as its scheduler; its dashboard has a port of its own."""
    address = f"{HERE}:0" if dashboard else None
    options = {"host": HERE, "protocol": "tcp://", "dashboard": dashboard, "dashboard_address": address}
    return {"cls": QuietScheduler, "options": options}


def worker_of(count: int) -> dict[str, Any]:
    """What a `SpecCluster` begins as each of `count` workers: a process of one thread, its share of the memory, and
    who begins it anew where it dies."""
    options = {
        "host": HERE,
        "protocol": "tcp://",
        "nthreads": 1,
        # a fraction of what this machine, or the container, has
        "memory_limit": 1 / count,
        "worker_class": QuietWorker,
        "silence_logs": 50,
    }
    return {"cls": Nanny, "options": options}
