"""The bench session as a table: every state, every event, one defined outcome. All that decides a state is here.

Theory of operation. A session is always in one `SessionState`. Two kinds of events come in: what operators request (the
commands) and what is observed (readings judged window by window, checks of a pose, the solver's answer, data coming or
not). `TABLE[state][event]` is the outcome: `Go` (the next state and the `Action` that belongs to the step), `STAY`
(nothing happens; the usual answer to an observation that says nothing new), or `Refuse` (a command that makes no sense
now, with the reason for the operator). There is no other way from state to state, no hidden flag that changes an
outcome, and no pair without an entry: `_row` fills what a state does not name itself with STAY for observations and
`Refuse(NOT_NOW)` for commands, and the test of the table counts them all.

Where an outcome depends on data, the event says so: whoever looks at the data (`session`) raises STILL or AWAY, GOOD or
BAD, SOLVED or AGAIN. One target is not a state: `ONWARD` means "where the poses still open lead": SOAKING if the next
one waits for a temperature, GUIDING if one is open, REVIEW if the present poses are solved, else SOLVING. It is worked
out by `onward`, from three booleans.

                    start              still, at an open pose          good enough
    IDLE ----------> GUIDING <-------> SETTLING ---------> CAPTURING -----------> CHECKING
                     ^    ^  away                              | moved, left, data lost | good, bad
                     |    +------------------------------------+------------------------+
    SOAKING <--------+ steady / not steady                                              | none is open
                     | a pose is requested again                                        v
                     +---------------------------------------------------------------- SOLVING --> REVIEW --> ACCEPTED
                                                                                                         \\-> REJECTED
    PAUSED and NO_DATA may be entered from every state in which something is measured, and lead ONWARD again.
    Nothing ends for want of time: a wait that grows long is reported, and goes on. Only operators end a session.
    No step leads out of an end; an accepted calibration may still be put in force there, or that be taken back.

A hold under way is the only thing that is ever lost: by motion, pause, abort, loss of data, or the end of the process.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from highside.bench.session.reasons import Refusal
from highside.bench.session.snapshot import CommandName, SessionState


class SessionEvent(StrEnum):
    """What can happen. The commands carry the names of `CommandName`."""

    START = "start"
    CAPTURE = "capture"
    REDO = "redo"
    SKIP = "skip"
    UNDO = "undo"
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    ACCEPT = "accept"
    REJECT = "reject"
    ACTIVATE = "activate"
    ROLLBACK = "rollback"
    FINISH = "finish"
    """`accept` in a plan of no fixed length while it is measured: that was the last pose"""

    AWAY = "away"
    """not at an open pose"""
    AT_POSE = "at_pose"
    """at an open pose, not still"""
    STILL = "still"
    """at an open pose and still"""
    FULL = "full"
    """the hold is good enough, or as long as the plan allows"""
    BROKEN = "broken"
    """the hold is spoilt; the reason is with the event"""
    STEADY = "steady"
    """the temperature requested is reached and steady"""
    UNSTEADY = "unsteady"
    """the temperature has left the step"""
    GOOD = "good"
    """the pose agrees with the others"""
    BAD = "bad"
    """it does not; the reason is with the event"""
    SOLVED = "solved"
    """the solver has answered and nothing is to be requested again"""
    AGAIN = "again"
    """the solution calls for a pose to be measured again"""
    DATA_LOST = "data_lost"
    DATA_BACK = "data_back"
    DATA_ENDED = "data_ended"
    """a recording that is played has come to its end"""
    LONG_WAIT = "long_wait"
    """nothing has happened for a long time"""


COMMANDS = frozenset({*(SessionEvent(name.value) for name in CommandName), SessionEvent.FINISH})
OBSERVATIONS = frozenset(SessionEvent) - COMMANDS


class Action(StrEnum):
    """What is done with a step; `session` has one method each."""

    NONE = "none"
    BEGIN = "begin"
    """write down who began"""
    BEGIN_HOLD = "begin_hold"
    ADD = "add"
    """add the window to the hold"""
    CLOSE_HOLD = "close_hold"
    """average the hold and check it"""
    REFUSE_HOLD = "refuse_hold"
    """forget the hold and say why"""
    TAKE = "take"
    """write the pose down: from here on it cannot be lost"""
    REFUSE_POSE = "refuse_pose"
    REOPEN = "reopen"
    SKIP = "skip"
    UNDO = "undo"
    STAGE = "stage"
    """the temperature is right: its poses are open"""
    SHOW = "show"
    """keep the solution for review"""
    REQUEST_AGAIN = "request_again"
    CLOSE_PLAN = "close_plan"
    """a plan of no fixed length is complete"""
    PAUSE = "pause"
    RESUME = "resume"
    KEEP = "keep"
    """accepted: make the record"""
    END = "end"
    """rejected or aborted"""
    REMIND = "remind"
    PUT_IN_FORCE = "put_in_force"
    """ask the store to put the session's record in force, or the one before"""


class Onward(StrEnum):
    """The one target that is worked out."""

    ONWARD = "onward"


ONWARD = Onward.ONWARD


@dataclass(frozen=True, slots=True)
class Go:
    """A step: where to (None: where we are), and what is done."""

    to: SessionState | Onward | None
    action: Action = Action.NONE


@dataclass(frozen=True, slots=True)
class Refuse:
    """A command that makes no sense now."""

    reason: Refusal


Outcome = Go | Refuse
STAY = Go(None)
NOT_NOW = Refuse(Refusal.NOT_NOW)

_S, _E, _A = SessionState, SessionEvent, Action

_PAUSE = {_E.PAUSE: Go(_S.PAUSED, _A.PAUSE)}
_ABORT = {_E.ABORT: Go(_S.ABORTED, _A.END)}
_EDIT = {_E.REDO: Go(ONWARD, _A.REOPEN), _E.SKIP: Go(ONWARD, _A.SKIP), _E.UNDO: Go(ONWARD, _A.UNDO)}
_EDIT_HERE = {_E.REDO: Go(None, _A.REOPEN), _E.SKIP: Go(None, _A.SKIP), _E.UNDO: Go(None, _A.UNDO)}
_LOST = {_E.DATA_LOST: Go(_S.NO_DATA, _A.REFUSE_HOLD), _E.LONG_WAIT: Go(None, _A.REMIND)}
_FINISH = {
    _E.FINISH: Go(ONWARD, _A.CLOSE_PLAN),
    _E.DATA_ENDED: Go(ONWARD, _A.CLOSE_PLAN),
}
_MEASURING = _PAUSE | _ABORT | _EDIT | _LOST | _FINISH
_NOT_STILL = {_E.CAPTURE: Refuse(Refusal.NOT_STILL)}


def _row(entries: Mapping[SessionEvent, Outcome]) -> Mapping[SessionEvent, Outcome]:
    rest: dict[SessionEvent, Outcome] = {event: NOT_NOW if event in COMMANDS else STAY for event in SessionEvent}
    return MappingProxyType(rest | dict(entries))


TABLE: Mapping[SessionState, Mapping[SessionEvent, Outcome]] = MappingProxyType(
    {
        _S.IDLE: _row(_ABORT | {_E.START: Go(ONWARD, _A.BEGIN), _E.LONG_WAIT: Go(None, _A.REMIND)}),
        _S.SOAKING: _row(_MEASURING | _NOT_STILL | {_E.STEADY: Go(ONWARD, _A.STAGE)}),
        _S.GUIDING: _row(
            _MEASURING
            | _NOT_STILL
            | {
                _E.AT_POSE: Go(_S.SETTLING),
                _E.STILL: Go(_S.CAPTURING, _A.BEGIN_HOLD),
                _E.UNSTEADY: Go(_S.SOAKING, _A.STAGE),
            }
        ),
        _S.SETTLING: _row(
            _MEASURING
            | _NOT_STILL
            | {
                _E.AWAY: Go(_S.GUIDING),
                _E.STILL: Go(_S.CAPTURING, _A.BEGIN_HOLD),
                _E.UNSTEADY: Go(_S.SOAKING, _A.STAGE),
            }
        ),
        _S.CAPTURING: _row(
            _MEASURING
            | {
                _E.CAPTURE: Go(_S.CHECKING, _A.CLOSE_HOLD),
                _E.STILL: Go(None, _A.ADD),
                _E.FULL: Go(_S.CHECKING, _A.CLOSE_HOLD),
                _E.BROKEN: Go(_S.SETTLING, _A.REFUSE_HOLD),
                _E.AT_POSE: Go(_S.SETTLING, _A.REFUSE_HOLD),
                _E.AWAY: Go(_S.GUIDING, _A.REFUSE_HOLD),
                _E.UNSTEADY: Go(_S.SOAKING, _A.REFUSE_HOLD),
            }
        ),
        _S.CHECKING: _row(_ABORT | {_E.GOOD: Go(ONWARD, _A.TAKE), _E.BAD: Go(ONWARD, _A.REFUSE_POSE)}),
        _S.SOLVING: _row(_ABORT | {_E.SOLVED: Go(_S.REVIEW, _A.SHOW), _E.AGAIN: Go(ONWARD, _A.REQUEST_AGAIN)}),
        _S.REVIEW: _row(
            _PAUSE
            | _ABORT
            | _EDIT
            | {
                _E.ACCEPT: Go(_S.ACCEPTED, _A.KEEP),
                _E.REJECT: Go(_S.REJECTED, _A.END),
                _E.LONG_WAIT: Go(None, _A.REMIND),
            }
        ),
        _S.PAUSED: _row(_ABORT | _EDIT_HERE | {_E.RESUME: Go(ONWARD, _A.RESUME)}),
        _S.NO_DATA: _row(
            _PAUSE
            | _ABORT
            | _EDIT_HERE
            | _FINISH
            | {_E.DATA_BACK: Go(ONWARD), _E.LONG_WAIT: Go(None, _A.REMIND), _E.CAPTURE: Refuse(Refusal.NOT_STILL)}
        ),
        _S.ACCEPTED: _row({_E.ACTIVATE: Go(None, _A.PUT_IN_FORCE), _E.ROLLBACK: Go(None, _A.PUT_IN_FORCE)}),
        _S.REJECTED: _row({}),
        _S.ABORTED: _row({}),
    }
)

LIVE = frozenset({_S.GUIDING, _S.SETTLING, _S.CAPTURING})
"""States in which every window of readings is judged."""
MEASURING = LIVE | {_S.SOAKING, _S.NO_DATA}


def outcome(state: SessionState, event: SessionEvent) -> Outcome:
    """What `event` does in `state`; defined for every pair."""
    return TABLE[state][event]


def onward(*, waits_for_temperature: bool, has_open: bool, solved: bool) -> SessionState:
    """Where the poses still open lead."""
    if has_open:
        return SessionState.SOAKING if waits_for_temperature else SessionState.GUIDING
    return SessionState.REVIEW if solved else SessionState.SOLVING
