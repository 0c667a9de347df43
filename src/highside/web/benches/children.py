"""The processes of bench sessions, and what is known of them on the disk.

    ID.json    one that was begun: its process, port and file
    ID.log     what it said
    ID.token   what opens its page; for this user alone

A process goes on when the page that began it ends. What its own page answers says how its session stands; one that does
not answer and whose process is gone is forgotten.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import signal
import ssl
import sys
import time
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from highside.config.web import WebTable
from highside.errors import HighsideError, InputError, Refused
from highside.printable import one_line
from highside.reading import parse_json, read_bytes
from highside.recording.files import make_directory, write_whole

SESSIONS_MAX = 8
"""At a time on one machine: each has a process of its own."""
BEGINS_WITHIN_S = 60.0
"""From the command to the page that listens; imports take a second, on a small busy machine ten."""
ANSWERS_WITHIN_S = 3.0
SAID_MAX = 200_000
_ADDRESS = re.compile(r"^bench page: https?://\S+?:(\d+)/", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Begun:
    """One session's process. `file`: its configuration, by name."""

    id: str
    pid: int
    port: int
    file: str
    operator: str
    begun_s: float


@dataclass(frozen=True, slots=True)
class Running:
    """One that answers, and its snapshot."""

    begun: Begun
    snapshot: dict[str, Any]

    @property
    def ended(self) -> bool:
        return self.snapshot.get("state") in ("accepted", "rejected", "aborted")


class Children:
    """Begins, finds and ends them. `token`: what opens their pages; None: each gets one of its own."""

    def __init__(self, folder: Path, web: WebTable, token: str | None, home_port: Callable[[], int]) -> None:
        self._folder, self._web, self._token, self._home_port = folder, web, token, home_port
        self._turn = asyncio.Lock()
        self._own: dict[int, asyncio.subprocess.Process] = {}

    async def begin(self, file: Path, operator: str, arguments: Sequence[str]) -> Begun:
        """A session of that file, its page listening. Raises HighsideError with what the command says."""
        async with self._turn:
            if len(await self.running()) >= SESSIONS_MAX:
                raise Refused(f"{SESSIONS_MAX} sessions run here already: end one first")
            name = secrets.token_hex(8)
            try:
                make_directory(self._folder)
                self._folder.chmod(0o700)
            except OSError as error:
                raise InputError(f"cannot be made ({error.strerror})", where=str(self._folder)) from None
            token = self._folder / f"{name}.token"
            write_whole(token, f"{self._token or secrets.token_urlsafe(18)}\n".encode())
            token.chmod(0o600)
            return await self._started(name, file, operator, [*arguments, *self._where(token)])

    def _where(self, token: Path) -> list[str]:
        """The page of the session listens as this one does, on a port of its own."""
        told: list[tuple[str, object]] = [("host", self._web.host), ("port", 0), ("token_file", str(token))]
        told += [("home_port", self._home_port()), ("allowed_hosts", list(self._web.allowed_hosts))]
        if self._web.tls is not None:
            told += [("tls.certificate", str(self._web.tls.certificate)), ("tls.key", str(self._web.tls.key))]
        return [part for key, value in told for part in ("--set", f"web.{key}={json.dumps(value)}")]

    async def _started(self, name: str, file: Path, operator: str, arguments: Sequence[str]) -> Begun:
        program = [sys.executable, "-c", "from highside.cli.main import main; main()", "calibrate", "bench"]
        log = self._folder / f"{name}.log"
        with log.open("wb") as said:
            process = await asyncio.create_subprocess_exec(
                *program,
                "--config",
                str(file),
                "--web",
                "--plain",
                "--operator",
                operator,
                *arguments,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
            )
        end_s = time.monotonic() + BEGINS_WITHIN_S
        while (found := _ADDRESS.search(_text(log))) is None:
            if process.returncode is not None or time.monotonic() > end_s:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
                lines = [line for line in _text(log).splitlines() if line.strip()]
                self._forget(name)
                raise Refused(one_line(lines[-1].removeprefix("highside: "))[:600] if lines else "it did not begin")
            await asyncio.sleep(0.05)
        begun = Begun(name, process.pid, int(found.group(1)), file.name, operator, time.time())
        write_whole(self._folder / f"{name}.json", json.dumps(asdict(begun)).encode())
        self._own[process.pid] = process
        return begun

    async def running(self) -> list[Running]:
        """Those that answer, the newest first; what is left of others is taken away."""
        found = [begun for path in self._folder.glob("*.json") if (begun := _read(path)) is not None]
        answers = await asyncio.gather(*(asyncio.to_thread(self._snapshot, begun) for begun in found))
        out = []
        for begun, snapshot in zip(found, answers, strict=True):
            if snapshot is not None:
                out.append(Running(begun, snapshot))
            elif not self._alive(begun):
                self._forget(begun.id)
        return sorted(out, key=lambda one: one.begun.begun_s, reverse=True)

    def token_of(self, begun: Begun) -> str:
        """What opens the page of a session."""
        return _text(self._folder / f"{begun.id}.token").strip()

    async def end(self, name: str) -> None:
        """End the process as Ctrl-C does: what was measured is kept. Raises Refused for one that is not there."""
        one = next((one for one in await self.running() if one.begun.id == name), None)
        if one is None:
            raise Refused("that session does not run here any more")
        # it has just answered on its own port: the number is still its own
        os.kill(one.begun.pid, signal.SIGINT)
        for _ in range(100):
            if not self._alive(one.begun):
                self._forget(name)
                return
            await asyncio.sleep(0.1)
        raise Refused("it was told to end and has not yet: look again in a moment")

    def _snapshot(self, begun: Begun) -> dict[str, Any] | None:
        """What its page answers; None where it does not."""
        wide = self._web.host in ("0.0.0.0", "::")
        host = "127.0.0.1" if wide else self._web.host
        scheme = "http" if self._web.tls is None else "https"
        address = f"{scheme}://{f'[{host}]' if ':' in host else host}:{begun.port}/api/session/state"
        # our own process on this machine: its certificate is for the names that others call it by
        secure = urllib.request.HTTPSHandler(context=ssl._create_unverified_context())
        # not by way of a proxy that the environment may name
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), secure)
        try:
            with opener.open(address, timeout=ANSWERS_WITHIN_S) as answer:
                found = parse_json(answer.read(SAID_MAX), kind="answer", remedy="try again")
        except (OSError, ValueError, HighsideError):
            return None
        return found if isinstance(found, dict) and found.get("schema") == "highside.session/1" else None

    def _alive(self, begun: Begun) -> bool:
        own = self._own.get(begun.pid)
        if own is not None:
            return own.returncode is None
        try:
            os.kill(begun.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return False  # the number has gone to somebody else's
        return True

    def _forget(self, name: str) -> None:
        for suffix in ("json", "log", "token"):
            (self._folder / f"{name}.{suffix}").unlink(missing_ok=True)


def _read(path: Path) -> Begun | None:
    try:
        return Begun(**parse_json(read_bytes(path), kind="file", remedy="delete it"))
    except (HighsideError, TypeError):
        return None


def _text(path: Path) -> str:
    try:
        return read_bytes(path, max_bytes=SAID_MAX).decode(errors="replace")
    except HighsideError:
        return ""
