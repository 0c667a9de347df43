"""A broker inside the process, for `highside demo` and quick tests: amqtt (MQTT 3.1.1), bound to the loopback.

It keeps nothing and authenticates nobody: real tools use a real broker (`config/mosquitto.conf`). `on_receipt` tells
when the broker had each message, from which the latency of the demo is taken. It can also be a process of its own:
`python -m highside.service.embedded_broker --port N` prints `ready PORT` when it listens.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from highside.errors import InputError

try:
    from amqtt.broker import Broker
    from amqtt.contexts import BrokerConfig, ListenerConfig
    from amqtt.plugins.base import BasePlugin
except ImportError as error:
    raise InputError("the embedded broker needs amqtt", remedy="pip install 'highside[demo]'") from error

Receipt = Callable[[str, bytes, float], None]
"""Called with topic, payload and the monotonic time (s) at which the broker had the message."""


class ReceiptPlugin(BasePlugin[Any]):  # type: ignore[misc]  # amqtt is not typed
    """Passes every message that reaches the broker to its listeners."""

    def __init__(self, context: Any) -> None:
        super().__init__(context)
        self.listeners: list[Receipt] = []

    async def on_broker_message_received(self, *, client_id: str, message: Any) -> None:
        """Called by amqtt, once a message."""
        t_mono = time.monotonic()
        if message is not None:
            for listener in self.listeners:
                listener(message.topic, bytes(message.data), t_mono)


class EmbeddedBroker:
    """`async with EmbeddedBroker() as broker: ... broker.port`; port 0 takes a free one."""

    def __init__(self, port: int = 0, *, host: str = "127.0.0.1") -> None:
        self._bind = f"{host}:{port}"
        self._broker: Broker | None = None
        self.port = port

    async def __aenter__(self) -> Self:
        # its own log speaks of every connection, and as errors of clients that leave without a word
        for name in ("amqtt", "transitions"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        config = BrokerConfig(
            listeners={"default": ListenerConfig(bind=self._bind)},
            plugins={
                "amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True},
                f"{ReceiptPlugin.__module__}.{ReceiptPlugin.__name__}": {},
            },
        )
        self._broker = Broker(config)
        try:
            await self._broker.start()
        except Exception as error:
            raise InputError(f"cannot listen on {self._bind} ({error})", remedy="choose another port") from error
        server = self._broker._servers["default"].instance
        self.port = server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._broker is not None:
            broker, self._broker = self._broker, None
            try:
                await broker.shutdown()
            except asyncio.CancelledError:
                # it ends its sessions before its deliveries: one that still waits for an acknowledgement is cancelled,
                # and passes that on as if we were; what is left to do then is done here
                task = asyncio.current_task()
                if task is not None and task.cancelling():
                    raise
                if broker._session_monitor_task is not None:
                    broker._session_monitor_task.cancel()
                for server in broker._servers.values():
                    await server.close_instance()

    def on_receipt(self, listener: Receipt) -> None:
        """Call `listener(topic, payload, t_mono)` for every message from now on."""
        assert self._broker is not None, "enter the broker first"
        for plugin in self._broker.plugins_manager.plugins:
            if isinstance(plugin, ReceiptPlugin):
                plugin.listeners.append(listener)


async def _serve(port: int) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    async with EmbeddedBroker(port) as broker:
        sys.stdout.write(f"ready {broker.port}\n")
        sys.stdout.flush()
        await stop.wait()


def main() -> None:
    """Run the broker until SIGTERM."""
    parser = argparse.ArgumentParser(description="A broker that keeps nothing, on the loopback.")
    parser.add_argument("--port", type=int, default=0)
    asyncio.run(_serve(parser.parse_args().port))


if __name__ == "__main__":
    # the plugin is found by its module's name, which here is not `__main__`
    from highside.service import embedded_broker

    embedded_broker.main()
