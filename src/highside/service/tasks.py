"""Ending tasks for good."""

from __future__ import annotations

import asyncio
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
