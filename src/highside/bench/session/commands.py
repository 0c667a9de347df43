"""Which command may be given now, by whom, and which event it is: the rules that go beyond the table.

One operator holds a session: whoever started it, or resumed it last. Others may look; to take it over it has to be
paused. A name is not enough to be that operator, for everybody can read it: a session belongs to where it was taken
(`Origin`: here, or at the broker) and, if its taker chose a secret, to who knows it. Here, at the terminal of the
process and on its page, one that was taken at the broker or with a secret may always be paused, so that a secret that
is lost holds nobody up; and what was accepted may be put in force, or taken back, by whoever may command here: that
is another decision than measuring, and where people sign in another role than the measurer's may be asked for.

What the table refuses is refused first, then what makes no sense for want of a pose, a hold or a result.
"""

from __future__ import annotations

import hashlib
import hmac
from enum import StrEnum

from highside.bench.session.force import InForce, what_is_missing
from highside.bench.session.hold import Hold
from highside.bench.session.ledger import Ledger, PoseLine
from highside.bench.session.machine import MEASURING, Refuse, SessionEvent, outcome
from highside.bench.session.outcome import Solved
from highside.bench.session.reasons import Refusal
from highside.bench.session.snapshot import Command, CommandName, Reply, SessionState

REPLIES_KEPT = 1000


class Origin(StrEnum):
    """Where a command came from, by how whoever gave it had to prove that they may."""

    HERE = "here"
    """at the terminal of the process, or on its page with the token"""
    BROKER = "broker"
    """by MQTT, as the broker's access list allows"""


def holder_of(command: Command, origin: Origin) -> str:
    """What a command proves of who gives it: where it came from, and the SHA-256 of its secret if it has one."""
    if command.secret is None:
        return origin.value
    return f"{origin.value}:{hashlib.sha256(command.secret.get_secret_value().encode()).hexdigest()}"


def holds(ledger: Ledger, operator: str, holder: str) -> bool:
    """Whether a command is of the operator who holds the session; while nobody does, everybody is."""
    if ledger.operator is None:
        return True
    return operator == ledger.operator and (
        ledger.holder is None or hmac.compare_digest(holder.encode(), ledger.holder.encode())
    )


def event_of(name: CommandName, state: SessionState, ledger: Ledger) -> SessionEvent:
    """`accept` while a plan of no fixed length is measured means that the last pose is taken."""
    if name is CommandName.ACCEPT and ledger.plan.open_ended and state in MEASURING:
        return SessionEvent.FINISH
    return SessionEvent(name.value)


def line_for(name: CommandName, pose: str | None, ledger: Ledger, target: str | None) -> PoseLine | None:
    """The pose that redo (the last taken, if none is named) or skip (the one requested) speaks of."""
    chosen = pose or (ledger.last_taken if name is CommandName.REDO else target)
    return ledger.lines.get(chosen) if chosen is not None else None


def refusal(
    name: CommandName,
    operator: str,
    pose: str | None,
    *,
    holder: str,
    state: SessionState,
    ledger: Ledger,
    target: str | None,
    hold: Hold | None,
    solved: Solved | None,
    record: str | None = None,
    in_force: InForce | None = None,
) -> Refusal | None:
    """Why a command would be refused now; None: it would be done."""
    result = outcome(state, event_of(name, state, ledger))
    if isinstance(result, Refuse):
        return result.reason
    free = name in (CommandName.START, CommandName.RESUME)
    # who has the name alone to prove can be asked; a secret, or a broker, may be out of reach
    paused = name is CommandName.PAUSE and ledger.holder != Origin.HERE
    forced = name in (CommandName.ACTIVATE, CommandName.ROLLBACK)
    here = holder.partition(":")[0] == Origin.HERE and (paused or forced)
    if not (free or here or holds(ledger, operator, holder)):
        return Refusal.HELD_BY_OTHER
    match name:
        case CommandName.REDO | CommandName.SKIP:
            line = line_for(name, pose, ledger, target)
            if line is None:
                return Refusal.UNKNOWN_POSE if pose is not None else Refusal.NOT_NOW
            if line.open is (name is CommandName.REDO):
                return Refusal.NOT_NOW
        case CommandName.UNDO if not ledger.can_undo:
            return Refusal.NOTHING_TO_UNDO
        case CommandName.CAPTURE if hold is None or not hold.long_enough:
            return Refusal.NOT_STILL
        case CommandName.ACCEPT if state is SessionState.REVIEW and (solved is None or not solved.may_be_accepted):
            return Refusal.NOT_SOLVED
        case CommandName.ACTIVATE | CommandName.ROLLBACK:
            return what_is_missing(name, record, in_force or InForce())
        case _:
            pass
    return None


class Replies:
    """The answers given lately: a command that comes twice is answered as before, another one under its id is refused
    (who hears "done" must not be told so of what was not done). Each who gives commands (`holder_of`) has request ids
    of their own, so that nobody can use up another's."""

    def __init__(self) -> None:
        self._given: dict[tuple[str, str, str], tuple[Command, Reply]] = {}

    def before(self, command: Command, holder: str, state: SessionState, seq: int) -> Reply | None:
        """The answer to a command whose id was used before; None: it is a new one."""
        given = self._given.get((holder, command.operator, command.request_id))
        if given is None:
            return None
        same, reply = given
        if same == command:
            return reply
        return _answer(command, Refusal.ID_USED, f"It was {same.name.value}.", state, seq)

    def give(
        self, command: Command, holder: str, refused: Refusal | None, detail: str, state: SessionState, seq: int
    ) -> Reply:
        reply = _answer(command, refused, detail, state, seq)
        self._given[holder, command.operator, command.request_id] = command, reply
        while len(self._given) > REPLIES_KEPT:
            del self._given[next(iter(self._given))]
        return reply


def _answer(command: Command, refused: Refusal | None, detail: str, state: SessionState, seq: int) -> Reply:
    return Reply(
        request_id=command.request_id,
        accepted=refused is None,
        reason=None if refused is None else refused.value,
        text="done" if refused is None else f"{refused.text} {detail}".strip(),
        state=state,
        seq=seq,
    )
