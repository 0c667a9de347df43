"""Tasks that a reload has replaced: they give back what they hold while their successors wait for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

LEAVING_S = 10.0
"""How long a reload waits for links and connections that an earlier one replaced; closing takes 2 s at most."""


class Leaving:
    """Those that still give something back; the next reload, and the end, wait for them."""

    def __init__(self) -> None:
        self.tasks: set[asyncio.Task[None]] = set()

    def successor(
        self, name: str, old: asyncio.Task[None] | None, run: Callable[[], Coroutine[Any, Any, None]]
    ) -> asyncio.Task[None]:
        """A task that ends `old`, waits until it and those before it have given everything back, and then runs."""

        async def after() -> None:
            if old is not None:
                self.let(old)
            before = {task for task in self.tasks if task.get_name() == name}
            for task in before:
                task.cancel()
            if before:
                await asyncio.wait(before)
            await run()

        return asyncio.create_task(after(), name=name)

    def let(self, task: asyncio.Task[None]) -> None:
        """A task that gives back what was replaced: the next reload, and the end, wait for it."""
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def all_gone(self) -> None:
        """Wait for the tasks that earlier reloads have replaced. Raises TimeoutError."""
        if self.tasks:
            _, late = await asyncio.wait(self.tasks, timeout=LEAVING_S)
            if late:
                raise TimeoutError(f"{', '.join(task.get_name() for task in late)} still closing after {LEAVING_S} s")
