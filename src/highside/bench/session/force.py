"""Putting the calibration of a session in force, and taking that back: what the session asks of the store.

The session decides who may do it, and when: the operator who holds it, after the record was accepted, and only by
naming the record that is to be in force afterwards (`confirm`). The store does it, and has the last word: it refuses
what has expired, is of another tool, or has nothing before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from highside.bench.session.reasons import Refusal
from highside.bench.session.snapshot import Command, CommandName
from highside.calibration.record import CalibrationRecord

MIN_DIGITS = 6
"""Fewest digits by which a record may be named."""
NOTHING = "nothing"
"""In place of a record's id: a roll back leaves none in force, since there was none before."""
COMMANDS = (CommandName.ACTIVATE, CommandName.ROLLBACK)


@dataclass(frozen=True, slots=True)
class InForce:
    """Ids of the calibration in force for the tool, and of the one that a roll back would put there (or `NOTHING`)."""

    present: str | None = None
    before: str | None = None


class StoreError(Exception):
    """The store has refused; the text is its line."""


class Store(Protocol):
    """The calibration store, as far as a session goes."""

    def in_force(self, tool_id: str) -> InForce:
        """What is in force now. Never raises: nothing known is `InForce()`."""
        ...

    def activate(self, record: CalibrationRecord) -> InForce:
        """Put a record in force. Raises StoreError."""
        ...

    def rollback(self, tool_id: str, to: str) -> InForce:
        """Put the one before in force again, if that is `to`; with `NOTHING`, take the only one out. Raises
        StoreError."""
        ...


def meant(name: CommandName, record: str | None, force: InForce) -> str | None:
    """The record that is in force after the command."""
    return record if name is CommandName.ACTIVATE else force.before


def what_is_missing(name: CommandName, record: str | None, force: InForce) -> Refusal | None:
    """Why a command could not be done, whoever gives it."""
    if record is None:
        return Refusal.NO_RECORD
    if name is CommandName.ACTIVATE and force.present == record:
        return Refusal.IN_FORCE
    # who has put the first one in force may undo that; the first one of somebody else stays
    foreign = force.before == NOTHING and force.present != record
    if name is CommandName.ROLLBACK and (force.before is None or foreign):
        return Refusal.NOTHING_BEFORE
    return None


def not_confirmed(command: Command, record: str | None, force: InForce) -> str | None:
    """What has to be named, where a command does not name the record that it puts in force."""
    after, named = meant(command.name, record, force), command.confirm or ""
    if after is not None and len(named) >= MIN_DIGITS and after.startswith(named):
        return None
    return f"It is {(after or '')[:12]}."
