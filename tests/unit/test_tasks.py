"""A task that loses its cancellation is ended all the same."""

from __future__ import annotations

import asyncio

from highside.service.tasks import ended


async def test_who_swallows_a_cancellation_is_cancelled_again() -> None:
    swallowed = 0

    async def deaf() -> None:
        nonlocal swallowed
        while True:
            try:
                await asyncio.sleep(60.0)
            except asyncio.CancelledError:
                swallowed += 1
                if swallowed == 3:
                    raise

    async def fails() -> None:
        try:
            await asyncio.sleep(60.0)
        finally:
            raise OSError("gone")

    tasks = asyncio.create_task(deaf()), asyncio.create_task(fails())
    await asyncio.sleep(0)
    async with asyncio.timeout(10.0):
        await ended(*tasks, again_s=0.01)
    assert swallowed == 3 and all(task.done() for task in tasks)
