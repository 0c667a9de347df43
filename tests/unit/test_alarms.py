"""Alarms that outlast their cause, the log that says things once, and the answers' allowance."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import pytest

from highside.service.alarms import ALARMS, DROPPING_STANDS_S, Dropping, Growing
from highside.service.messages import schemas
from highside.service.quiet_log import REASONS, QuietLog
from highside.service.replies import BURST, RATE_PER_S, WAITING, QueuedReply, ReplyQueue

log = logging.getLogger("test.quiet")


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_one_line_of_a_reason_a_minute_and_the_next_says_how_many_were_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = Clock()
    quiet = QuietLog(log, clock=clock)
    for i in range(1000):
        quiet.say(logging.WARNING, "a", "fault %d", i)
        clock.now += 0.01
    assert quiet.say(logging.WARNING, "b", "another, 100 % sure")
    assert [record.getMessage() for record in caplog.records] == ["fault 0", "another, 100 % sure"]
    clock.now += 61.0
    quiet.say(logging.WARNING, "a", "fault %d", 1000)
    assert caplog.records[-1].getMessage() == "fault 1000 (and 999 more of this kind since the last such line)"
    clock.now += 61.0
    quiet.say(logging.WARNING, "a", "fault")
    assert caplog.records[-1].getMessage() == "fault"


def test_a_burst_of_lines_is_let_through_and_reasons_are_bounded(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    quiet = QuietLog(log, burst=3, clock=clock)
    assert [quiet.say(logging.WARNING, "a", "x") for _ in range(5)] == [True] * 3 + [False] * 2
    for i in range(10 * REASONS):
        quiet.say(logging.DEBUG, f"reason {i}", "x")
    assert len(quiet._reasons) == REASONS


def test_dropping_is_an_alarm_for_an_hour_and_one_line_a_reason_and_minute(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    alarm = Dropping(clock)
    assert not alarm.look({})
    for count in range(1, 400):
        assert alarm.look({"max_rows": count, "max_age": 7})
        clock.now += 0.1
    lines = [record.getMessage() for record in caplog.records]
    assert lines == [
        "outbox: messages are dropped (max_rows), 1 of them since the start",
        "outbox: messages are dropped (max_age), 7 of them since the start",
    ]
    clock.now += DROPPING_STANDS_S - 1.0
    assert alarm.look({"max_rows": 399, "max_age": 7})
    clock.now += 1.0
    assert not alarm.look({"max_rows": 399, "max_age": 7})
    assert alarm.look({"max_rows": 400, "max_age": 7})


def test_a_count_that_begins_anew_is_no_growth() -> None:
    clock = Clock()
    growing = Growing(60.0, clock)
    assert growing.look(5)
    clock.now += 61.0
    assert not growing.look(0)
    assert growing.look(1)


def test_every_alarm_has_its_meaning_and_the_schema_says_it() -> None:
    service = Path(__file__).parents[2] / "src" / "highside" / "service"
    table = (service / "health.py").read_text().split("stands = {")[1].split("return [")[0]
    raised = set(re.findall(r'^ +"([a-z_]+)": ', table, re.M))
    text = (service / "rig" / "rig.py").read_text()
    raised |= set(re.findall(r"found\.append\(\"([a-z_]+)\"\)", text))
    raised |= set(re.findall(r"found\.extend\(\"([a-z_]+)\"", text))
    assert len(raised) > 10
    assert raised <= set(ALARMS), raised - set(ALARMS)
    description = schemas()["health"]["properties"]["alarms"]["description"]
    assert all(f"`{name}`: {text}" in description for name, text in ALARMS.items())


def test_answers_have_an_allowance_of_each_kind_and_never_pile_up() -> None:
    clock = Clock()
    replies = ReplyQueue(clock)
    taken = [replies.put(QueuedReply("t", b"no"), done=False) for _ in range(1000)]
    assert taken.count(True) == BURST
    assert replies.put(QueuedReply("t", b"yes"), done=True)
    assert replies.dropped == 1000 - BURST
    waiting = 0
    while (first := replies.first) is not None:
        waiting += 1
        replies.sent(first)
    assert waiting == replies.made == BURST + 1
    clock.now += 10.0
    taken = [replies.put(QueuedReply("t", b"no"), done=False) for _ in range(1000)]
    assert taken.count(True) == min(int(10.0 * RATE_PER_S), BURST)
    for _ in range(100):
        clock.now += 10.0
        for done in (True, False):
            replies.put(QueuedReply("t", b""), done=done)
    count = 0
    while (first := replies.first) is not None:
        count += 1
        replies.sent(first)
    assert count == WAITING
