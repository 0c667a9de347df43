"""When the publisher connects again: two clients of one id at a pretended broker that ends the older connection."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest

from highside.service.reconnect import SHORT_S, STANDS_S, Reconnect, instance_word, read_instance


class Clock:
    """Time that is told."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def make(clock: Clock, instance: str = "aaaaaaaa", seed: int = 1) -> Reconnect:
    return Reconnect("highside-t1", instance, min_s=0.1, max_s=1.0, rng=random.Random(seed), clock=clock)


def lives(state: Reconnect, clock: Clock, seconds: float) -> float:
    state.connected()
    clock.now += seconds
    return state.pause_s()


def test_attempts_that_fail_double_the_pause_up_to_the_longest() -> None:
    clock = Clock()
    state = make(clock)
    pauses = [state.pause_s() for _ in range(8)]
    for pause, most in zip(pauses, (0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0, 1.0), strict=True):
        assert most / 2.0 <= pause <= most
    assert lives(state, clock, SHORT_S) <= 0.1


def test_a_short_connection_is_no_success() -> None:
    clock = Clock()
    state = make(clock)
    pauses = [lives(state, clock, 1.0) for _ in range(4)]
    assert pauses[3] >= 0.4
    assert state.taken is None
    pauses = [lives(state, clock, 1.0) for _ in range(6)]
    assert "5 connections" not in str(state.taken)
    assert "connections in a row ended within 5 s: another client uses highside-t1" in str(state.taken)
    assert 5.0 <= pauses[-1] <= 10.0
    assert state.short_connections == 10
    assert lives(state, clock, SHORT_S) <= 0.1
    clock.now += STANDS_S
    assert state.taken is None


def test_five_short_ones_in_a_row_raise_the_alarm_and_four_do_not() -> None:
    clock = Clock()
    state = make(clock)
    for _ in range(3):
        for _ in range(4):
            lives(state, clock, 4.9)
        lives(state, clock, 5.1)
    assert state.taken is None
    for _ in range(5):
        lives(state, clock, 4.9)
    assert state.taken is not None


def test_what_the_run_before_has_left_is_no_twin() -> None:
    clock = Clock()
    state = make(clock)
    state.connected()
    state.heard_instance(b"online bbbbbbbb", retained=True)
    state.heard_instance(b"offline bbbbbbbb", retained=False)
    state.heard_instance(b"online aaaaaaaa", retained=False)
    clock.now += 1.0
    assert state.pause_s() <= 0.1
    assert state.taken is None


@pytest.mark.parametrize("payload", [b"", b"online", b"\xff\xfe", b"online ", b" ", b"x" * 100_000])
def test_a_status_that_is_none_is_no_sign(payload: bytes) -> None:
    clock = Clock()
    state = make(clock)
    lives(state, clock, 1.0)
    state.connected()
    state.heard_instance(payload, retained=True)
    state.heard_instance(payload, retained=False)
    assert state.taken is None


def test_what_others_call_themselves_is_printable_and_short() -> None:
    clock = Clock()
    state = make(clock)
    lives(state, clock, 1.0)
    state.connected()
    state.heard_instance(b"online \x1b[2J" + b"y" * 1000, retained=True)
    text = str(state.taken)
    assert text.isprintable()
    assert len(text) < 200


def test_the_status_says_whose_word_it_is() -> None:
    assert read_instance(instance_word(b"online", "5f0c2a91")) == ("online", "5f0c2a91")


@dataclass
class Broker:
    """Ends the older of two connections; keeps the last status; counts them."""

    clock: Clock
    readable: bool = True
    status: bytes = b""
    statuses: int = 0
    holder: int | None = None
    log: list[tuple[float, int]] = field(default_factory=list)

    def publish(self, payload: bytes) -> None:
        self.status = payload
        self.statuses += 1


def fight(begins_s: tuple[float, float], until_s: float, *, readable: bool = True, seed: int = 0):
    """Two clients from their beginnings until `until_s`; returns the broker, their states, seconds each was there."""
    clock = Clock()
    zero = clock.now
    broker = Broker(clock, readable)
    names = ("aaaaaaaa", "bbbbbbbb")
    states = [make(clock, name, seed=10 * seed + i) for i, name in enumerate(names)]
    due = [zero + begin for begin in begins_s]
    there = [0.0, 0.0]
    while min(due) < zero + until_s:
        who = 0 if due[0] <= due[1] else 1
        if broker.holder is not None:
            there[broker.holder] += due[who] - clock.now
        clock.now = due[who]
        if broker.holder is not None:
            loser = broker.holder
            broker.publish(b"offline " + names[loser].encode())
            due[loser] = clock.now + max(states[loser].pause_s(), 0.001)
        states[who].connected()
        if broker.readable and broker.status:
            states[who].heard_instance(broker.status, retained=True)
        broker.publish(b"online " + names[who].encode())
        broker.holder, due[who] = who, float("inf")
        broker.log.append((clock.now - zero, who))
    if broker.holder is not None:
        there[broker.holder] += zero + until_s - clock.now
    return broker, states, there


@pytest.mark.parametrize("seed", range(20))
def test_two_of_one_id_do_not_fight_and_who_was_there_first_stays(seed: int) -> None:
    broker, states, there = fight((0.0, 6.0), 31.0, seed=seed)
    assert broker.statuses <= 13
    assert all("another client uses highside-t1" in str(state.taken) for state in states)
    assert there[0] > 28.0
    broker, states, there = fight((0.0, 6.0), 86_400.0, seed=seed)
    assert broker.statuses < 86_400 / 300 * 2 * 5
    assert there[0] > 0.99 * 86_400.0


@pytest.mark.parametrize("seed", range(20))
def test_two_that_begin_together_find_their_order(seed: int) -> None:
    broker, states, there = fight((0.0, 0.01), 25.0, seed=seed)
    assert broker.statuses <= 14
    assert all(state.taken is not None for state in states)
    assert max(there) + min(there) > 24.0


@pytest.mark.parametrize("seed", range(5))
def test_where_the_status_may_not_be_read_it_takes_longer_and_ends_as_well(seed: int) -> None:
    broker, states, _ = fight((0.0, 6.0), 31.0, readable=False, seed=seed)
    assert broker.statuses <= 50
    assert any(state.taken is not None for state in states)
