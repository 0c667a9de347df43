"""Tasks: ending them for good, and waiting for one that ends by itself."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any


async def ended(*tasks: asyncio.Task[Any], again_s: float = 0.1) -> None:
    """Cancel `tasks` and wait until they are over, whatever they end with.

    Who goes on is cancelled again every `again_s` (longer than any farewell of theirs): `asyncio.wait_for` of Python
    3.11 loses a cancellation that comes in the moment in which what it waits for is done.
    """
    pending: set[asyncio.Task[Any]] = set(tasks)
    while pending:
        for task in pending:
            task.cancel()
        _, pending = await asyncio.wait(pending, timeout=again_s)
    await asyncio.gather(*tasks, return_exceptions=True)


async def cancelled(task: asyncio.Task[Any]) -> None:
    """Cancel a task and wait until it is over, whatever it ends with."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError, Exception):
        await task


async def first_to_end(
    watched: Callable[[], set[asyncio.Task[None]]], changed: asyncio.Event, stopping: asyncio.Event
) -> asyncio.Task[None] | None:
    """The first of the watched tasks that is over, None when `stopping` is set first. Raises what the task raised.

    A task that is cancelled is being replaced and is no end; when `changed` is set the tasks are requested anew.
    """
    stop = asyncio.create_task(stopping.wait(), name="stopping")
    try:
        while True:
            change = asyncio.create_task(changed.wait(), name="changed")
            try:
                tasks = {task for task in watched() if not task.cancelled()}
                await asyncio.wait({stop, change, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            finally:
                change.cancel()
            if stop.done():
                return None
            if change.done():
                changed.clear()
            for task in tasks:
                if task.done() and not task.cancelled():
                    task.result()
                    return task
    finally:
        stop.cancel()
