"""Which command may be given now, by whom, and which event it is: the rules that go beyond the table.

One operator holds a session: whoever started it, or resumed it last. Others may look; to take it over it has to be
paused. What the table refuses is refused first, then what makes no sense for want of a pose, a hold or a result.
"""

from __future__ import annotations

from highside.session.force import InForce, what_is_missing
from highside.session.hold import Hold
from highside.session.ledger import Ledger, PoseLine
from highside.session.machine import MEASURING, Event, Refuse, outcome
from highside.session.outcome import Solved
from highside.session.reasons import Refusal
from highside.session.snapshot import Command, CommandName, Reply, State

REPLIES_KEPT = 1000


def event_of(name: CommandName, state: State, ledger: Ledger) -> Event:
    """`accept` while a plan of no fixed length is measured means that the last pose is taken."""
    if name is CommandName.ACCEPT and ledger.plan.open_ended and state in MEASURING:
        return Event.FINISH
    return Event(name.value)


def line_for(name: CommandName, pose: str | None, ledger: Ledger, target: str | None) -> PoseLine | None:
    """The pose that redo (the last taken, if none is named) or skip (the one asked for) speaks of."""
    chosen = pose or (ledger.last_taken if name is CommandName.REDO else target)
    return ledger.lines.get(chosen) if chosen is not None else None


def refusal(
    name: CommandName,
    operator: str,
    pose: str | None,
    *,
    state: State,
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
    free = name in (CommandName.START, CommandName.RESUME) or ledger.operator is None
    if not free and operator != ledger.operator:
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
        case CommandName.ACCEPT if state is State.REVIEW and (solved is None or not solved.may_be_accepted):
            return Refusal.NOT_SOLVED
        case CommandName.ACTIVATE | CommandName.ROLLBACK:
            return what_is_missing(name, record, in_force or InForce())
        case _:
            pass
    return None


class Replies:
    """The answers given lately, by request id: a command that comes twice is answered as before."""

    def __init__(self) -> None:
        self._given: dict[str, Reply] = {}

    def before(self, command: Command) -> Reply | None:
        return self._given.get(command.request_id)

    def give(self, command: Command, refused: Refusal | None, detail: str, state: State, seq: int) -> Reply:
        reply = Reply(
            request_id=command.request_id,
            accepted=refused is None,
            reason=None if refused is None else refused.value,
            text="done" if refused is None else f"{refused.text} {detail}".strip(),
            state=state,
            seq=seq,
        )
        self._given[command.request_id] = reply
        while len(self._given) > REPLIES_KEPT:
            del self._given[next(iter(self._given))]
        return reply
