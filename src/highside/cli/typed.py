"""What is typed at the terminal, as it is typed, without holding the event loop up.

Where a terminal is a descriptor that the loop can wait for, it does; on Windows a thread waits, which ends with the
process.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import threading
from collections.abc import AsyncGenerator, Callable, Iterator

try:
    import termios
    import tty
except ImportError:
    TERMINALS = False
else:
    TERMINALS = True


async def typed_lines() -> AsyncGenerator[str, None]:
    """Lines, each with its end; an empty one (end of the input) ends it, and it is empty where nobody can type."""
    queue: asyncio.Queue[str] = asyncio.Queue()
    listen = _by_the_loop if TERMINALS else _by_a_thread
    try:
        with listen(queue, sys.stdin.readline):
            while line := await queue.get():
                yield line
    except (OSError, ValueError):
        return  # a file or nothing at all: nobody types there


async def typed_keys() -> AsyncGenerator[str, None]:
    """Single keys, unechoed; Ctrl-C works as ever."""
    queue: asyncio.Queue[str] = asyncio.Queue()
    if TERMINALS:
        descriptor = sys.stdin.fileno()
        with (
            _single_keys(descriptor),
            _by_the_loop(queue, lambda: os.read(descriptor, 1).decode("ascii", "replace")),
        ):
            while key := await queue.get():
                yield key
        return
    import msvcrt  # of Windows alone

    with _by_a_thread(queue, msvcrt.getwch):  # type: ignore[attr-defined]
        while key := await queue.get():
            if key == "\x03":
                raise KeyboardInterrupt
            yield key


@contextlib.contextmanager
def _by_the_loop(queue: asyncio.Queue[str], take: Callable[[], str]) -> Iterator[None]:
    """Put what `take` gives into the queue whenever there is input. Raises OSError, ValueError: none can be."""
    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()

    def ready() -> None:
        typed = take()
        if not typed:
            loop.remove_reader(descriptor)
        queue.put_nowait(typed)

    loop.add_reader(descriptor, ready)
    try:
        yield
    finally:
        loop.remove_reader(descriptor)


@contextlib.contextmanager
def _by_a_thread(queue: asyncio.Queue[str], take: Callable[[], str]) -> Iterator[None]:
    loop, over = asyncio.get_running_loop(), threading.Event()

    def wait() -> None:
        while not over.is_set():
            typed = take()
            # the loop may have ended while the last was typed
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(queue.put_nowait, typed)
            if not typed:
                return

    threading.Thread(target=wait, name="typed", daemon=True).start()
    try:
        yield
    finally:
        over.set()


@contextlib.contextmanager
def _single_keys(descriptor: int) -> Iterator[None]:
    before = termios.tcgetattr(descriptor)
    try:
        # what was typed while the program started counts
        tty.setcbreak(descriptor, termios.TCSANOW)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
