"""Who holds a session: a name that everybody can read is not enough to be its operator."""

from __future__ import annotations

import itertools
import json

import pytest
from pydantic import ValidationError
from rehearsal import Rehearsal

from highside.bench.session import plans
from highside.bench.session.commands import Origin
from highside.bench.session.journal import read_journal
from highside.bench.session.plans import Limits
from highside.bench.session.session import BenchSession
from highside.bench.session.snapshot import Command, CommandName, Reply, SessionState
from highside.bench.session.view import View

PLAN = plans.balance_plan([12.0], Limits(std_error_g=3e-5, min_hold_s=1.5, max_hold_s=4.0))
SECRET, OTHER = "a secret of Alice", "a secret of Mallory"
_ids = itertools.count()


def say(
    session: BenchSession,
    name: str,
    origin: Origin,
    *,
    operator: str = "Alice",
    secret: str | None = None,
    request: str = "",
) -> Reply:
    body = {"name": name, "request_id": request or f"r{next(_ids)}", "operator": operator, "secret": secret}
    return session.command(Command.model_validate(body), 1.0, origin)


@pytest.fixture
def session() -> BenchSession:
    return Rehearsal(PLAN).session


def test_a_session_taken_at_the_bench_obeys_nobody_at_the_broker(session: BenchSession) -> None:
    assert say(session, "start", Origin.HERE).accepted
    for secret in (None, SECRET):
        assert say(session, "abort", Origin.BROKER, secret=secret).reason == "held_by_other"
        assert say(session, "pause", Origin.BROKER, secret=secret).reason == "held_by_other"
    assert say(session, "pause", Origin.HERE, operator="Bob").reason == "held_by_other"
    assert say(session, "pause", Origin.HERE).accepted


def test_a_secret_chosen_at_the_start_is_asked_for_with_every_command(session: BenchSession) -> None:
    assert say(session, "start", Origin.BROKER, secret=SECRET).accepted
    for secret in (None, OTHER):
        assert say(session, "pause", Origin.BROKER, secret=secret).reason == "held_by_other"
    assert say(session, "pause", Origin.BROKER, operator="Bob", secret=SECRET).reason == "held_by_other"
    assert say(session, "pause", Origin.BROKER, secret=SECRET).accepted
    # paused, it is anybody's who resumes it
    assert say(session, "resume", Origin.BROKER, secret=OTHER, operator="Mallory").accepted
    assert say(session, "pause", Origin.BROKER, secret=SECRET).reason == "held_by_other"


def test_at_the_bench_it_can_always_be_paused_and_taken_over(session: BenchSession) -> None:
    assert say(session, "start", Origin.BROKER, secret=SECRET).accepted
    assert say(session, "abort", Origin.HERE).reason == "held_by_other"
    assert say(session, "pause", Origin.HERE, operator="Bob").accepted
    assert session.state is SessionState.PAUSED
    assert say(session, "resume", Origin.HERE, operator="Bob").accepted
    assert say(session, "pause", Origin.BROKER, secret=SECRET).reason == "held_by_other"


def test_what_the_holder_may_do_is_what_every_face_shows(session: BenchSession) -> None:
    assert say(session, "start", Origin.BROKER, secret=SECRET).accepted
    assert CommandName.ABORT in View(session).snapshot().allowed


def test_nobody_uses_up_the_request_ids_of_another(session: BenchSession) -> None:
    assert say(session, "pause", Origin.BROKER, request="terminal-1").reason == "not_now"
    assert say(session, "start", Origin.HERE, request="terminal-1").accepted


def test_the_secret_is_nowhere_to_be_read() -> None:
    rehearsal = Rehearsal(PLAN)
    session = rehearsal.session
    command = Command(name=CommandName.START, request_id="1", operator="Alice", secret=SECRET)  # type: ignore[arg-type]
    assert SECRET not in repr(command)
    assert session.command(command, 1.0, Origin.BROKER).accepted
    assert SECRET not in View(session).snapshot().to_json()
    journal = rehearsal.journal
    assert SECRET.encode() not in journal
    # but whoever knows it holds the session in the process that goes on with the journal
    assert read_journal(journal).ledger().holder == session.ledger.holder


def test_a_journal_of_before_knows_names_only(session: BenchSession) -> None:
    assert say(session, "start", Origin.HERE).accepted
    session.ledger.holder = None
    assert say(session, "pause", Origin.BROKER).accepted


@pytest.mark.parametrize("secret", ["short", "x" * 129, 7, ["x" * 20]])
def test_a_secret_that_is_none_is_wrong_input(secret: object) -> None:
    body = {"name": "start", "request_id": "1", "operator": "a", "secret": secret}
    with pytest.raises(ValidationError):
        Command.model_validate_json(json.dumps(body))


def test_another_command_under_a_used_id_is_refused_and_not_called_done(session: BenchSession) -> None:
    first = say(session, "start", Origin.HERE, request="1")
    assert first.accepted
    assert say(session, "start", Origin.HERE, request="1") == first
    again = say(session, "pause", Origin.HERE, request="1")
    assert (again.accepted, again.reason) == (False, "id_used")
    assert "start" in again.text
    assert session.state is not SessionState.PAUSED
    assert say(session, "pause", Origin.HERE, request="2").accepted
    assert session.state is SessionState.PAUSED
