"""A transport that is opened before its supervisor runs.

Whether a link can be opened at all is known before anything depends on it: at the start of the service before it speaks
to anybody, at a reload before the running link is given up. What arrives meanwhile waits for the supervisor.
"""

from __future__ import annotations

from highside.link.base import Batch, Deliver, LinkError, LinkReason, Transport


class OpenedTransport:
    """A transport for one attempt that is open already; `open` hands over what has arrived since."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._deliver: Deliver | None = None
        self._waiting: list[Batch] = []

    @property
    def kernel_drops(self) -> int:
        return self._transport.kernel_drops

    async def open_ahead(self) -> None:
        """Open. Raises LinkError; nothing is held then."""
        try:
            await self._transport.open(self._take)
        except OSError as error:
            await self._transport.close()
            raise LinkError(LinkReason.IO_ERROR, f"{error.strerror or error}") from error
        except BaseException:
            await self._transport.close()
            raise

    def _take(self, batch: Batch) -> None:
        if self._deliver is None:
            self._waiting.append(batch)
        else:
            self._deliver(batch)

    async def open(self, deliver: Deliver) -> None:
        self._deliver = deliver
        waiting, self._waiting = self._waiting, []
        for batch in waiting:
            deliver(batch)

    async def wait_closed(self) -> LinkError:
        return await self._transport.wait_closed()

    async def wait_ready(self) -> None:
        await self._transport.wait_ready()

    async def close(self) -> None:
        await self._transport.close()
