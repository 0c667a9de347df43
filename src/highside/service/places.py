"""What a daemon holds for itself alone before it speaks to anybody: its state directory, and the tool at its broker.

Two daemons on one state directory would share an outbox. Two of one tool with directories of their own would throw
each other off the broker for ever, because a broker lets the newest connection of a client id win, and their sequence
numbers would mix on one topic. Both are found out on this machine before the first connection; across machines the
broker's behaviour tells (alarm `client_id_taken`).
"""

from __future__ import annotations

import errno
import hashlib
import os
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import IO

from highside.config.mqtt import MqttSettings
from highside.config.places import service_state
from highside.config.settings import Settings
from highside.errors import InputError
from highside.recording.files import make_directory, set_aside
from highside.recording.locks import lock as take_lock

_LOOPBACK = {"localhost", "127.0.0.1", "::1", "ip6-localhost", ""}


def state_dir(settings: Settings) -> Path:
    """Where the service keeps its state: configured, given by systemd, or the user's own folder."""
    if settings.service.state_dir is not None:
        return settings.service.state_dir
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else service_state(settings.tool.id)


def take_state_dir(directory: Path) -> IO[str]:
    """Make the directory and lock it; the lock goes when the file is closed. Raises InputError: not usable, or used."""
    where = str(directory)
    try:
        # what is synced into it must not go with the directory itself
        make_directory(directory)
        if (directory / "lock").is_dir():
            set_aside(directory / "lock")
        lock = (directory / "lock").open("w")
    except OSError as error:
        raise InputError(
            f"the state directory cannot be written: {error.strerror}",
            where=where,
            field="service.state_dir",
            remedy="give one that this user may write",
        ) from None
    try:
        take_lock(lock.fileno())
    except OSError:
        lock.close()
        raise InputError(
            "another highside uses this state directory",
            where=where,
            field="service.state_dir",
            remedy="stop it, or give this one its own",
        ) from None
    return lock


class ToolLock:
    """The right to speak as a tool at a broker. Raises InputError where another daemon of this machine has it.

    It is a name in Linux' abstract socket name space: seen by all users and state directories of the machine (of one
    network name space), gone with the process however that ends, and no file is left.
    """

    def __init__(self, tool_id: str, mqtt: MqttSettings) -> None:
        self.name = self.name_of(tool_id, mqtt)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.bind(self.name)
            # so that a second one can ask who has it
            self._socket.listen(1)
        except (OSError, ValueError) as error:
            self._socket.close()
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                return  # a system without such names: the broker's behaviour has to tell
            holder = _holder(self.name)
            raise InputError(
                f"{tool_id!r} is spoken for at {mqtt.host}:{mqtt.port} by another highside of this machine"
                + (f" (process {holder})" if holder else ""),
                field="tool.id",
                remedy="stop it, or give this tool an id or a topic prefix of its own",
            ) from None

    @staticmethod
    def name_of(tool_id: str, mqtt: MqttSettings) -> str:
        """One name for one set of topics at one broker."""
        host = "loopback" if mqtt.host.lower() in _LOOPBACK else mqtt.host.lower()
        identity = f"{host} {mqtt.port} {mqtt.topic(tool_id, 'status')}"
        return f"\0highside-{hashlib.sha256(identity.encode()).hexdigest()[:32]}"

    def release(self) -> None:
        """Give it back; may be called more than once."""
        self._socket.close()


def _holder(name: str) -> int | None:
    """The process that holds a name, where the kernel tells."""
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(0.5)
        asking.connect(name)
        pid, _, _ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        return int(pid) or None
    return None
