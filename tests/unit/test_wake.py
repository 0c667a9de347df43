"""What wakes the threads that write: nothing is missed, and nothing is woken twice."""

from __future__ import annotations

import threading
import time

from highside.service.wake import Wake


def test_a_wake_up_is_kept_until_it_is_waited_for_and_several_are_one() -> None:
    wake = Wake()
    assert not wake.wait(0.0) and not wake.wait(-1.0)
    wake.set()
    wake.set()
    assert wake.wait(1e12) and not wake.wait(0.01)


def test_who_sleeps_is_woken_by_another_thread() -> None:
    wake, woken = Wake(), threading.Event()

    def sleeps() -> None:
        wake.wait()
        woken.set()

    thread = threading.Thread(target=sleeps, daemon=True)
    thread.start()
    time.sleep(0.05)
    assert not woken.is_set()
    wake.set()
    assert woken.wait(30.0)
    thread.join(30.0)


def test_whatever_two_threads_do_at_once_no_item_is_left_lying() -> None:
    """One puts and wakes, as the outbox and the recorder are woken; the other takes all that is there."""
    wake, lying, taken = Wake(), [], []

    def takes() -> None:
        while len(taken) < 20_000:
            assert wake.wait(60.0), "what was put had nobody to take it"
            while lying:
                taken.append(lying.pop())

    thread = threading.Thread(target=takes, daemon=True)
    thread.start()
    for i in range(20_000):
        lying.append(i)
        wake.set()
    thread.join(100.0)
    assert sorted(taken) == list(range(20_000))
