"""Several tools in one process: each has its own `Service`, with link, record, outbox, broker and topics of its own.

What they share is the event loop, the interpreter and the line to systemd. A service that ends of an error is made
anew after a pause, and the others never hear of it: with a process for each tool systemd would do the same. What one
tool can still do to the others is to keep the loop busy; `health` of each says how long it was held (`loop`).

systemd is told that the process is ready when every tool has been begun once, and is fed as long as the loop turns: a
tool whose outbox is wedged says so in its log and its health, since a restart would interrupt all.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import time
from collections.abc import Callable, Sequence
from typing import Any

from highside.config.settings import Settings
from highside.errors import InputError
from highside.service.app import Service
from highside.service.in_force import error_text
from highside.service.interpreter import settle_interpreter
from highside.service.logs import TOOL
from highside.service.notify import Notifier
from highside.service.quiet_log import QuietLog

__all__ = ["Tools"]

log = logging.getLogger("highside")

PAUSE_S = (1.0, 60.0)
"""Before a service that failed is made anew: at first, and at most; doubled by each failure. systemd's own unit waits
2 s; a port that is not there is asked for once a minute."""
SETTLED_S = 60.0
"""A service that ran for so long begins with the shortest pause again."""
STATUS_S = 5.0


class ToolLine(Notifier):
    """What one tool's service tells systemd: gathered, since there is one line."""

    def __init__(self, begun: Callable[[], None], interval_s: float | None) -> None:
        super().__init__({})
        self._begun = begun
        self.watchdog_interval_s = interval_s
        self.last = ""
        """its own status"""

    def ready(self, status: str = "") -> bool:
        """It does its work, or a reload of it has ended."""
        self.last = status
        self._begun()
        return True

    def status(self, text: str) -> bool:
        self.last = text
        return True


class _Tool:
    """One of them: its service, made anew whenever it fails."""

    def __init__(self, tools: Tools, settings: Settings) -> None:
        self.id = settings.tool.id
        self.service: Service | None = None
        self.error: InputError | None = None
        """of the last attempt, if it was refused"""
        self.failed: str | None = None
        """why it is not at work"""
        self.begun = asyncio.Event()
        """begun once, or reloaded, successfully or not"""
        self._tools, self._settings = tools, settings
        self._leaving = False
        self._wake = asyncio.Event()
        self.line = ToolLine(self.begun.set, tools.notifier.watchdog_interval_s)
        self.task = asyncio.create_task(self._run(), name=f"tool {self.id}")

    def stop(self) -> None:
        """Ask for an orderly end."""
        self._leaving = True
        self._wake.set()
        if self.service is not None:
            self.service.stop()

    def reload(self) -> None:
        """Read the file anew; a tool that waits for its next attempt makes it now."""
        self.begun.clear()
        if self.service is not None:
            self.service.reloader.ask()
        else:
            self._wake.set()

    async def _run(self) -> None:
        TOOL.set(self.id)
        pause_s = PAUSE_S[0]
        while not self._leaving:
            began = time.monotonic()
            if await self._attempt():
                return
            if time.monotonic() - began > SETTLED_S:
                pause_s = PAUSE_S[0]
            log.error("%s; begun anew in %.0f s", self.failed, pause_s)
            self.begun.set()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), pause_s)
            self._wake.clear()
            pause_s = min(2 * pause_s, PAUSE_S[1])
            # what was wrong with it may stand in the file, and have been corrected
            with contextlib.suppress(InputError):
                self._settings = await asyncio.to_thread(self._tools.load, self.id)

    async def _attempt(self) -> bool:
        """Whether it came to an orderly end."""
        try:
            self.service = Service(self._settings, lambda: self._tools.load(self.id), self.line)
            self.failed = self.error = None
            if not self._leaving:
                await self.service.run(signals=False)
        except InputError as error:
            self.error, self.failed = error, error_text(error)
            return False
        except Exception as error:  # a defect that one tool brings out must not cost the others theirs
            self.failed = error_text(error)
            log.debug("a service has ended", exc_info=error)
            return False
        finally:
            self.service = None
        return True


class Tools:
    """The services of a file with `[[tools]]`. `load` gives the settings of one of them anew, `ids` those there are."""

    def __init__(
        self, settings: Sequence[Settings], load: Callable[[str], Settings], ids: Callable[[], Sequence[str]]
    ) -> None:
        self.load, self._ids, self._first = load, ids, settings
        self.notifier = Notifier()
        self._quiet = QuietLog(log)
        self._tools: dict[str, _Tool] = {}
        self._stopping = asyncio.Event()
        self._reload = asyncio.Event()

    def stop(self) -> None:
        """Ask for an orderly end of all."""
        self._stopping.set()

    async def run(self) -> None:
        """Run until SIGTERM or SIGINT, or until the recordings that are replayed have ended and are delivered.

        Raises InputError if not one tool could be begun.
        """
        loop = asyncio.get_running_loop()
        handlers = ((signal.SIGTERM, self.stop), (signal.SIGINT, self.stop), (signal.SIGHUP, self._reload.set))
        for number, handler in handlers:
            loop.add_signal_handler(number, handler)
        others: list[asyncio.Task[Any]] = []
        try:
            self._tools = {one.tool.id: _Tool(self, one) for one in self._first}
            await self._all_begun()
            refused = [tool.error for tool in self._tools.values() if tool.error is not None]
            if len(refused) == len(self._tools):
                raise refused[0]
            settle_interpreter()
            self.notifier.ready(self._status())
            others = [asyncio.create_task(self._tell()), asyncio.create_task(self._answer_reloads())]
            await self._until_ended()
        finally:
            self.notifier.stopping("leaving")
            for task in others:
                task.cancel()
            for tool in self._tools.values():
                tool.stop()
            await asyncio.gather(*others, *(tool.task for tool in self._tools.values()), return_exceptions=True)
            self.notifier.close()
            for number, _ in handlers:
                loop.remove_signal_handler(number)

    async def _all_begun(self) -> None:
        """Every tool has been begun or has failed, or all are asked to end."""
        ends = [asyncio.create_task(self._stopping.wait())]
        for tool in self._tools.values():
            begun = asyncio.create_task(tool.begun.wait())
            await asyncio.wait({begun, tool.task, *ends}, return_when=asyncio.FIRST_COMPLETED)
            begun.cancel()
        ends[0].cancel()

    async def _until_ended(self) -> None:
        stopping = asyncio.create_task(self._stopping.wait())
        while not stopping.done() and (running := {tool.task for tool in self._tools.values() if not tool.task.done()}):
            # a tool that a reload has added is seen within a second
            await asyncio.wait({stopping, *running}, timeout=1.0, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()

    async def _answer_reloads(self) -> None:
        """SIGHUP: each tool reads its own part of the file; those that are gone end, new ones begin."""
        while True:
            await self._reload.wait()
            self._reload.clear()
            self.notifier.reloading("reloading")
            try:
                ids: Sequence[str] = await asyncio.to_thread(self._ids)
            except InputError as error:
                self._quiet.say(logging.ERROR, f"refused {error}", "reload refused: %s", error)
                ids = [*self._tools]
            for key, tool in list(self._tools.items()):
                if key in ids:
                    tool.reload()
                else:
                    log.info("tool %s is not in the file any more: it ends", key)
                    tool.stop()
                    await tool.task
                    del self._tools[key]
            for key in ids:
                if key not in self._tools:
                    await self._add(key)
            await self._all_begun()
            self.notifier.ready(self._status())

    async def _add(self, key: str) -> None:
        try:
            settings = await asyncio.to_thread(self.load, key)
        except InputError as error:
            text = "tool %s is new and refused: %s"
            self._quiet.say(logging.ERROR, f"{key} {error}", text, key, error)
            return
        self._tools[key] = _Tool(self, settings)

    def _status(self) -> str:
        failed = [f"{tool.id}: {tool.failed}" for tool in self._tools.values() if tool.failed]
        at_work = len(self._tools) - len(failed)
        return "; ".join([f"{at_work} of {len(self._tools)} tools at work", *failed[:3]])

    async def _tell(self) -> None:
        interval_s = self.notifier.watchdog_interval_s
        pause_s = STATUS_S if interval_s is None else min(interval_s / 4.0, STATUS_S)
        while True:
            self.notifier.status(self._status())
            self.notifier.watchdog()
            await asyncio.sleep(pause_s)
