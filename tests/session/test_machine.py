"""The table of the bench session: complete, without dead ends, and what it says of every pair."""

from __future__ import annotations

import itertools

import pytest

from highside.bench.session.machine import (
    COMMANDS,
    LIVE,
    NOT_NOW,
    ONWARD,
    STAY,
    TABLE,
    Action,
    Go,
    Refuse,
    SessionEvent,
    onward,
    outcome,
)
from highside.bench.session.reasons import Fault, Refusal, Rejection
from highside.bench.session.snapshot import CommandName, SessionState

PAIRS = list(itertools.product(SessionState, SessionEvent))


@pytest.mark.parametrize(("state", "event"), PAIRS)
def test_every_event_has_a_defined_outcome_in_every_state(state: SessionState, event: SessionEvent) -> None:
    result = outcome(state, event)
    assert isinstance(result, Go | Refuse)
    if isinstance(result, Refuse):
        assert event in COMMANDS, "an observation cannot be refused: it has happened"
        assert isinstance(result.reason, Refusal) and result.reason.text
    else:
        assert result.to is None or result.to is ONWARD or isinstance(result.to, SessionState)
        assert isinstance(result.action, Action)


def test_the_table_names_no_state_and_no_event_that_is_not_there() -> None:
    assert set(TABLE) == set(SessionState)
    assert all(set(row) == set(SessionEvent) for row in TABLE.values())
    assert len(PAIRS) == len(SessionState) * len(SessionEvent) == sum(len(row) for row in TABLE.values())


@pytest.mark.parametrize("name", CommandName)
def test_every_command_is_an_event_and_is_of_use_somewhere(name: CommandName) -> None:
    event = SessionEvent(name.value)
    assert any(isinstance(outcome(state, event), Go) for state in SessionState)


@pytest.mark.parametrize("action", [action for action in Action if action is not Action.NONE])
def test_every_action_is_reached(action: Action) -> None:
    assert any(isinstance(o, Go) and o.action is action for row in TABLE.values() for o in row.values())


def successors(state: SessionState) -> set[SessionState]:
    found: set[SessionState] = set()
    for result in TABLE[state].values():
        if isinstance(result, Go) and result.to is not None:
            if result.to is ONWARD:
                found |= {SessionState.SOAKING, SessionState.GUIDING, SessionState.SOLVING, SessionState.REVIEW}
            else:
                found.add(SessionState(result.to))
    return found


@pytest.mark.parametrize("start", [state for state in SessionState if not state.ended])
def test_from_every_state_every_end_can_be_reached(start: SessionState) -> None:
    reached, todo = {start}, [start]
    while todo:
        for state in successors(todo.pop()) - reached:
            reached.add(state)
            todo.append(state)
    assert {SessionState.ACCEPTED, SessionState.REJECTED, SessionState.ABORTED} <= reached


@pytest.mark.parametrize("state", [state for state in SessionState if state.ended])
def test_nothing_leads_out_of_an_end(state: SessionState) -> None:
    assert successors(state) == set()
    store = {SessionEvent.ACTIVATE, SessionEvent.ROLLBACK} if state is SessionState.ACCEPTED else set()
    assert all(TABLE[state][event] == Go(None, Action.PUT_IN_FORCE) for event in store)
    assert all(TABLE[state][event] == NOT_NOW for event in COMMANDS - store)
    assert all(TABLE[state][event] == STAY for event in set(SessionEvent) - COMMANDS)


def test_only_operators_end_a_session_and_abort_is_always_open() -> None:
    for state, row in TABLE.items():
        for event, result in row.items():
            if isinstance(result, Go) and isinstance(result.to, SessionState) and result.to.ended:
                assert event in COMMANDS
        if not state.ended:
            assert row[SessionEvent.ABORT] == Go(SessionState.ABORTED, Action.END)


def test_a_pose_is_taken_only_after_its_check_and_a_hold_is_closed_only_when_full_or_told_to() -> None:
    takes = {
        (s, e) for s, row in TABLE.items() for e, o in row.items() if isinstance(o, Go) and o.action is Action.TAKE
    }
    assert takes == {(SessionState.CHECKING, SessionEvent.GOOD)}
    into = {
        (s, e)
        for s, row in TABLE.items()
        for e, o in row.items()
        if isinstance(o, Go) and o.to is SessionState.CHECKING
    }
    assert into == {(SessionState.CAPTURING, SessionEvent.FULL), (SessionState.CAPTURING, SessionEvent.CAPTURE)}


@pytest.mark.parametrize(
    "event",
    [SessionEvent.AWAY, SessionEvent.AT_POSE, SessionEvent.BROKEN, SessionEvent.DATA_LOST, SessionEvent.UNSTEADY],
)
def test_whatever_disturbs_a_hold_ends_it(event: SessionEvent) -> None:
    result = outcome(SessionState.CAPTURING, event)
    assert isinstance(result, Go) and result.to not in (None, SessionState.CAPTURING, SessionState.CHECKING)
    assert result.action is Action.REFUSE_HOLD


def test_waiting_long_never_leads_anywhere() -> None:
    for row in TABLE.values():
        result = row[SessionEvent.LONG_WAIT]
        assert isinstance(result, Go) and result.to is None


def test_loss_of_data_is_survived_in_all_states_that_measure() -> None:
    for state in {*LIVE, SessionState.SOAKING}:
        assert outcome(state, SessionEvent.DATA_LOST) == Go(SessionState.NO_DATA, Action.REFUSE_HOLD)
    assert outcome(SessionState.NO_DATA, SessionEvent.DATA_BACK) == Go(ONWARD)
    for state in (SessionState.IDLE, SessionState.REVIEW, SessionState.PAUSED, SessionState.SOLVING):
        assert outcome(state, SessionEvent.DATA_LOST) == STAY


@pytest.mark.parametrize(("soak", "open_", "solved"), list(itertools.product((False, True), repeat=3)))
def test_onward_is_decided_by_the_open_poses(soak: bool, open_: bool, solved: bool) -> None:
    state = onward(waits_for_temperature=soak, has_open=open_, solved=solved)
    if open_:
        assert state is (SessionState.SOAKING if soak else SessionState.GUIDING)
    else:
        assert state is (SessionState.REVIEW if solved else SessionState.SOLVING)


@pytest.mark.parametrize("kind", [Rejection, Refusal, Fault])
def test_every_reason_says_what_happened_in_a_sentence(kind: type) -> None:
    for member in kind:
        assert member.text and member.text[0].isupper() and member.text.endswith("."), member
        assert kind(member.value) is member
