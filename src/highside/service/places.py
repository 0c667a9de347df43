"""What a daemon holds for itself alone before it speaks to anybody: its state directory, and the tool at its broker.

Two daemons on one state directory would share an outbox. Two of one tool with directories of their own would throw
each other off the broker for ever, because a broker lets the newest connection of a client id win, and their sequence
numbers would mix on one topic. Both are found out on this machine before the first connection; across machines the
broker's behaviour tells (alarm `client_id_taken`).
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import logging
import os
import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO

from highside.config.mqtt import MqttSettings
from highside.config.places import service_state
from highside.config.settings import Settings
from highside.errors import InputError
from highside.recording.files import make_directory, set_aside
from highside.recording.locks import lock as take_lock
from highside.service.outbox_places import Places
from highside.service.quiet_log import QuietLog

log = logging.getLogger("highside")

LOOK_S = 2.0
"""Seconds between looks at the lock of the state directory: as the outbox looks at its files"""

_LOOPBACK = {"localhost", "127.0.0.1", "::1", "ip6-localhost", ""}


def state_dir(settings: Settings) -> Path:
    """Where the service keeps its state: configured, given by systemd, or the user's own folder."""
    if settings.service.state_dir is not None:
        return settings.service.state_dir
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else service_state(settings.tool.id)


def take_state_dir(directory: Path) -> IO[str]:
    """Make the directory and lock it; the lock goes when the file is closed. Raises InputError: not usable, or used."""
    lock = _open_lock(directory)
    try:
        take_lock(lock.fileno())
    except OSError:
        lock.close()
        raise InputError(
            "another highside uses this state directory",
            where=str(directory),
            field="service.state_dir",
            remedy="stop it, or give this one its own",
        ) from None
    return lock


def _open_lock(directory: Path) -> IO[str]:
    try:
        # what is synced into it must not go with the directory itself
        make_directory(directory)
        if (directory / "lock").is_dir():
            set_aside(directory / "lock")
        return (directory / "lock").open("w")
    except OSError as error:
        raise InputError(
            f"the state directory cannot be written: {error.strerror}",
            where=str(directory),
            field="service.state_dir",
            remedy="give one that this user may write",
        ) from None


class StateLock:
    """The lock of the state directory, kept for as long as the service runs.

    Who deletes the directory, or its lock, takes the lock from nobody who has it open, and hides it from everybody
    else: a second service would take the directory, too. `look` takes what is there now.
    """

    def __init__(self, directory: Path) -> None:
        self._directory, self._path = directory, directory / "lock"
        self._file: IO[str] | None = None
        self._places = Places()
        self._guard = threading.Lock()
        self._missed = 0
        self._quiet = QuietLog(log)

    @property
    def held(self) -> bool:
        """Between `take` and `release`."""
        return self._file is not None

    @property
    def taken(self) -> bool:
        """Another one has the directory. Who only looks whether a service runs has its lock for a moment: twice."""
        return self._missed > 1

    def take(self) -> None:
        """At the start. Raises InputError as `take_state_dir`."""
        self._hold(take_state_dir(self._directory))

    def release(self) -> None:
        """Give it back; may be called more than once."""
        with self._guard:
            if self._file is not None:
                self._file.close()
                self._file = None

    async def run(self) -> None:
        """Look again and again, in a thread: a dead file system holds up nothing else."""
        while True:
            await asyncio.sleep(LOOK_S)
            await asyncio.to_thread(self.look)

    def look(self) -> None:
        """Whether the lock is still that of the directory; if not, take what is there now, or tell that another has."""
        with self._guard:
            if self._file is None or not self._places.moved(self._path):
                return
            try:
                new = _open_lock(self._directory)
            except InputError:
                return  # the outbox, which has its files beside it, tells
            try:
                take_lock(new.fileno())
            except OSError:
                new.close()
                self._missed += 1
                if self.taken:
                    text = (
                        "another highside uses the state directory %s, which was deleted or replaced; stop one of them"
                    )
                    self._quiet.say(logging.ERROR, "taken", text, self._directory)
                return
            old, self._missed = self._file, 0
            self._hold(new)
            old.close()
            text = "the lock of the state directory %s was gone; it was made anew and taken again"
            self._quiet.say(logging.WARNING, "again", text, self._directory)

    def _hold(self, file: IO[str]) -> None:
        with suppress(OSError):  # it cannot be told then whether it moves
            self._places.note(self._path, file.fileno())
        self._file = file


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
