"""The hand-over from a reader thread: complete, in order, bounded, and never holding a thread that nobody wants."""

from __future__ import annotations

import asyncio
import itertools
import threading
import time

from highside.link.handover import Handover


async def test_everything_arrives_in_order_in_few_wake_ups() -> None:
    got: list[int] = []
    wakes = 0

    def take(items: list[int]) -> None:
        nonlocal wakes
        wakes += 1
        got.extend(items)

    handover: Handover[int] = Handover(asyncio.get_running_loop(), take, capacity=50)
    thread = threading.Thread(target=lambda: [handover.put(n) for n in range(5000)])
    thread.start()
    while len(got) < 5000:
        await asyncio.sleep(0.001)
    thread.join()
    assert got == list(range(5000))
    assert wakes < 5000


async def test_a_late_loop_makes_the_thread_wait_and_memory_stays_bounded() -> None:
    got: list[int] = []
    handover: Handover[int] = Handover(asyncio.get_running_loop(), got.extend, capacity=8)
    put = []

    def produce() -> None:
        for n in range(100):
            handover.put(n)
            put.append(n)

    thread = threading.Thread(target=produce)
    thread.start()
    deadline = time.monotonic() + 5.0
    while len(put) < 8 and time.monotonic() < deadline:
        stall(0.01)  # the loop does not run
    stall(0.1)
    assert len(put) == 8
    assert got == []
    while len(got) < 100:
        await asyncio.sleep(0.001)
    thread.join()
    assert got == list(range(100))


async def test_after_a_stall_others_have_their_turn_between() -> None:
    """All that had gathered was taken in one go: 64 batches of 256 CAN frames held the loop for 100 ms."""
    turns: list[str] = []
    handover: Handover[int] = Handover(asyncio.get_running_loop(), lambda items: turns.append(f"took {len(items)}"), 64)
    for n in range(64):
        assert handover.put(n)

    async def other() -> None:
        while len(turns) < 30:
            turns.append("other")
            await asyncio.sleep(0)

    await asyncio.wait_for(other(), 5.0)
    assert turns.count("took 4") >= 10
    assert max(len(list(run)) for word, run in itertools.groupby(turns) if word != "other") <= 2


async def test_closing_lets_a_waiting_thread_go_and_delivers_nothing_more() -> None:
    got: list[int] = []
    handover: Handover[int] = Handover(asyncio.get_running_loop(), got.extend, capacity=2)
    results: list[bool] = []
    thread = threading.Thread(target=lambda: results.extend(handover.put(n) for n in range(5)))
    thread.start()
    stall(0.1)
    handover.close()
    thread.join(5.0)
    assert not thread.is_alive()
    assert results == [True, True, False, False, False]
    await asyncio.sleep(0.02)
    assert got == []


def stall(seconds: float) -> None:
    """Hold the event loop, as a slow callback would."""
    time.sleep(seconds)
