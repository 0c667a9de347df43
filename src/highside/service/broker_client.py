"""The client of the broker as this project uses it: secrets, limits, and what aiomqtt leaves to its callers.

**What comes in is bounded.** MQTT 3.1.1 lets a sender put 256 MB into one message, and a client has no word in it; paho
keeps the whole of it in memory. Here a packet is kept up to `INCOMING_MAX` bytes (by an onlooker up to a bound of its
own) and the rest is read and let go: the connection lives, the broker gets its acknowledgement (else it would send the
message again for ever), and whoever takes the message sees one that is longer than any command. What this cannot do is
to save the network the time of the transfer: that is the broker's to bound (`message_size_limit` in
`config/mosquitto.conf`).

`on_each_message` hands messages over in the callback of the library, not through its queue, which has no bound.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
import threading
from collections.abc import Callable
from typing import Any

import aiomqtt
import paho.mqtt.client as mqtt
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from highside.config.mqtt import MqttSettings, TlsSettings
from highside.errors import InputError
from highside.reading import CERTIFICATES_MAX, read_named

log = logging.getLogger(__name__)

INCOMING_MAX = 16 * 1024
"""Bytes of a packet that are kept. The longest command, of a bench session, has 10,000."""

_client_log = logging.getLogger("highside.mqtt.client")
"""Of the client library: it counts every message under way as a warning, on stderr where nothing else is set up."""
_client_log.setLevel(logging.CRITICAL)


class LostConnection(Exception):  # noqa: N818 - an event of every day, not an error
    """The connection is of no more use; `reason` is the name under which that is counted."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class _Head(bytearray):
    """Keeps the first `most` bytes of what is added to it."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most = most

    def __iadd__(self, more: Any) -> _Head:  # type: ignore[misc]
        room = self._most - len(self)
        if room > 0:
            self.extend(more[:room])
        return self


def _bound_incoming(paho: mqtt.Client, most: int) -> None:
    """Never hold more of a packet than its head; never ask the system for more than that at once."""
    receive = paho._sock_recv

    def bounded(bufsize: int) -> bytes:
        packet = paho._in_packet
        if packet["have_remaining"] and packet["remaining_length"] > most:
            if not isinstance(packet["packet"], _Head):
                packet["packet"] = _Head(most)
            return receive(min(bufsize, most))
        return receive(bufsize)

    paho._sock_recv = bounded  # type: ignore[method-assign]


def on_each_message(client: aiomqtt.Client, take: Callable[[str, bytes, bool], None]) -> None:
    """Call `take` (topic, payload, whether retained) with each message, at once. It must not raise."""

    def on_message(_paho: mqtt.Client, _userdata: Any, message: mqtt.MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:
            return
        take(topic, bytes(message.payload), message.retain)

    client._client.on_message = on_message


def notice_a_closed_door(client: aiomqtt.Client) -> None:
    """End `connect` when the peer closes before it has answered; aiomqtt would wait for its whole timeout."""
    loop = asyncio.get_running_loop()
    chained = client._on_disconnect

    def end_connect() -> None:
        if not client._connected.done():
            client._connected.set_exception(aiomqtt.MqttError("closed by peer before an answer"))

    def on_disconnect(
        paho: mqtt.Client, userdata: Any, flags: mqtt.DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        chained(paho, userdata, flags, reason, properties)
        loop.call_soon_threadsafe(end_connect)

    client._client.on_disconnect = on_disconnect


def write_only_while_open(client: aiomqtt.Client) -> None:
    """Write in the next turn of the loop, and watch the descriptor only for what the kernel does not take at once.

    aiomqtt asks the loop to watch it, a turn later and by number. By then the number may be nobody's, which is an error
    with a traceback in the log, or another file's: a serial port is always ready to be written to, and the loop would
    never rest again. It also costs a message three turns of the loop and six calls of the system.
    """
    loop, paho = asyncio.get_running_loop(), client._client
    ours = threading.get_ident()

    def write() -> None:
        try:
            paho.loop_write()
        except Exception as error:
            if not client._disconnected.done():
                client._disconnected.set_exception(error)

    def watch(_paho: mqtt.Client, _userdata: Any, sock: Any) -> None:
        def is_open() -> bool:
            now = paho.socket()
            return now is not None and now is sock and now.fileno() >= 0

        def begin() -> None:
            if not is_open():
                return
            write()
            if paho.want_write() and is_open():
                loop.add_writer(sock.fileno(), write)

        # paho connects in a thread of its own
        (loop.call_soon if threading.get_ident() == ours else loop.call_soon_threadsafe)(begin)

    paho.on_socket_register_write = watch


def reset(client: aiomqtt.Client) -> None:
    """End the TCP connection without a word (RST), so that the broker sends the last will and nothing arrives late."""
    paho = client._client
    sock = paho.socket()
    if not isinstance(sock, socket.socket):
        return
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    # paho's own way to close: it also takes the descriptor out of the event loop
    paho._sock_close()
    if client._misc_task is not None:
        client._misc_task.cancel()
    if client._connected.done() and not client._disconnected.done():
        client._disconnected.set_result(None)


def check_secrets(mqtt: MqttSettings) -> None:
    """Read the files with password and certificates once. Raises `InputError` that names the file and the field."""
    mqtt.read_password()
    tls = mqtt.tls
    if tls is None:
        return
    for name, path in (("ca", tls.ca), ("cert", tls.cert), ("key", tls.key)):
        if path is not None:
            read_named(path, f"mqtt.tls.{name}", max_bytes=CERTIFICATES_MAX)
    try:
        _tls_context(tls)
    except OSError as error:
        # ssl does not say which of the files it could not understand
        named = [str(path) for path in (tls.ca, tls.cert, tls.key) if path is not None]
        raise InputError(
            f"is no certificate or key that can be used ({error.strerror or error})",
            where=" or ".join(named) or None,
            field="mqtt.tls",
            remedy="give PEM files that belong together",
        ) from None


async def broker_client(
    settings: MqttSettings,
    identifier: str,
    *,
    will: aiomqtt.Will | None = None,
    clean_session: bool = True,
    max_queued_incoming: int = 0,
    incoming_max: int = INCOMING_MAX,
) -> aiomqtt.Client:
    """A client of the configured broker, not yet connected. Raises InputError or OSError if a secret cannot be read.

    `max_queued_incoming`: of the messages that wait to be read one by one (`client.messages`); 0 is without bound.
    `incoming_max`: bytes of a packet that are kept.
    """
    password = settings.read_password()
    # reading the system's certificates takes tens of milliseconds
    context = None if settings.tls is None else await asyncio.to_thread(_tls_context, settings.tls)
    client = aiomqtt.Client(
        settings.host,
        settings.port,
        transport=settings.transport,
        identifier=identifier,
        username=settings.username,
        password=password.get_secret_value() if password is not None else None,
        will=will,
        clean_session=clean_session,
        keepalive=settings.keepalive_s,
        timeout=settings.connect_timeout_s,
        tls_context=context,
        max_inflight_messages=settings.in_flight + 8,
        max_queued_incoming_messages=max_queued_incoming,
        logger=_client_log,
    )
    _bound_incoming(client._client, incoming_max)
    return client


def _tls_context(tls: TlsSettings) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(tls.ca) if tls.ca is not None else None)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if tls.cert is not None and tls.key is not None:
        # an encrypted key is refused: without a password here OpenSSL would prompt for one at the terminal
        context.load_cert_chain(tls.cert, tls.key, password="")
    return context


async def connect(client: aiomqtt.Client, stop: asyncio.Event, *, timeout_s: float) -> None:
    """Connect, unless asked to stop. Raises what aiomqtt raises, TimeoutError, or `LostConnection` when `stop` was set
    meanwhile."""
    connecting = asyncio.create_task(client.__aenter__())
    stopping = asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({connecting, stopping}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        stopping.cancel()
        if not connecting.done():
            connecting.cancel()
            await asyncio.gather(connecting, return_exceptions=True)
    if not connecting.cancelled():
        connecting.result()
    elif stop.is_set():
        raise LostConnection("stopped", "asked to stop while connecting")
    else:
        raise TimeoutError


def connect_reason(error: BaseException) -> str:
    if isinstance(error, MqttConnectError):
        return "refused by broker"
    text = str(error).lower()
    if "refused" in text:
        return "no broker"
    if "closed by peer" in text:
        return "closed by peer"
    if isinstance(error, TimeoutError) or "timed out" in text:
        return "no answer"
    if "certificate" in text or "ssl" in text:
        return "tls"
    return "cannot connect"


async def subscribe(client: aiomqtt.Client, topic: str, *, timeout_s: float) -> str | None:
    """Subscribe to a topic; returns why nothing of it will arrive, None if it will."""
    try:
        granted = await client.subscribe(topic, qos=1, timeout=timeout_s)
    except (aiomqtt.MqttError, ValueError) as error:
        return f"no subscription to {topic}: {error}"
    codes = [code if isinstance(code, int) else code.value for code in granted]
    return f"the broker refuses the subscription to {topic}: see its access list" if max(codes) >= 0x80 else None


async def publish(
    client: aiomqtt.Client, topic: str, payload: bytes, *, qos: int, retain: bool, timeout_s: float
) -> None:
    """Publish, and wait for the PUBACK of QoS 1. Raises `LostConnection` if the connection is of no more use,
    ValueError for what the protocol cannot carry."""
    try:
        await client.publish(topic, payload, qos=qos, retain=retain, timeout=timeout_s)
    except aiomqtt.MqttCodeError as error:
        raise LostConnection("connection lost", str(error)) from error
    except aiomqtt.MqttError as error:
        raise LostConnection("no acknowledgement", str(error)) from error
    except RuntimeError as error:
        raise LostConnection("refused by client", str(error)) from error
