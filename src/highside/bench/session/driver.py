"""What drives a session for its faces: the interface between them and whoever owns link, journal and session.

Terminal, web page and MQTT face hold nothing but a `SessionDriver`. All of them may be used at the same time on one
session; the driver serialises their commands, and a command is on the disk before its reply is given. `subscribe` never
queues: a slow viewer sees the newest snapshot when it asks again and misses those in between, so that no viewer can
hold acquisition up.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Protocol

from highside.bench.session.commands import Origin
from highside.bench.session.snapshot import Command, Reply, Snapshot

REMARK_MAX = 500
"""Letters of one remark, as of a command's note."""
REMARKS_MAX = 200
"""Of one process: nobody fills the disk of a bench by a stuck key."""


@dataclass(frozen=True, slots=True)
class Kept:
    """Whether something was kept, and the answer in words."""

    done: bool
    text: str


class SessionDriver(Protocol):
    """Implemented by `highside.bench.driver.BenchDriver`."""

    def snapshot(self) -> Snapshot:
        """The present state, at once."""
        ...

    def subscribe(self, max_rate_hz: float = 10.0) -> AsyncIterator[Snapshot]:
        """The present state, then every newer one, at most `max_rate_hz` a second; ends when it is no longer open."""
        ...

    @property
    def open(self) -> bool:
        """Whether there will be more to see or to command."""
        ...

    async def command(self, command: Command, origin: Origin = Origin.HERE) -> Reply:
        """Do what an operator asks, or say why not; `origin`: where it came from. Never raises for its content."""
        ...

    async def remark(self, operator: str, text: str) -> Kept:
        """Keep a remark of an operator (`Name`) in the journal, `REMARK_MAX` letters at most."""
        ...

    async def photograph(self, operator: str, text: str, sent: bytes) -> Kept:
        """Keep a photograph (a file as a camera gives it) and what is said of it beside the journal."""
        ...

    @property
    def journal_path(self) -> str | None:
        """Where the session is written down; None where it is not kept."""
        ...
