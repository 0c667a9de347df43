"""Pieces of work given out to a cluster's processes until each has its answer, whatever becomes of the processes.

A process that dies costs the piece that it was working on: its things are given out again one by one, and a thing that
ends every process it is given to is said to be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from highside.errors import HighsideError
from highside.fleet.policy import TASKS

__all__ = ["Lost", "answers", "pieces"]

T = TypeVar("T")


@dataclass(frozen=True)
class Lost(Generic[T]):
    """What has no answer: it ended all processes that it was given to, or none could begin with it."""

    thing: T
    error: BaseException | None

    @property
    def said(self) -> str:
        """In words."""
        from distributed import KilledWorker

        if self.error is not None and not isinstance(self.error, KilledWorker):
            return f"no process could work on it: {type(self.error).__name__}: {self.error}"
        return f"ended {TASKS.attempts} processes that worked on it (out of memory?)"


def pieces(things: Iterable[T], costs: Iterable[float], most_s: float) -> Iterator[list[T]]:
    """What is given out in one piece: things in their order that together take about `most_s`, at least one."""
    piece: list[T] = []
    seconds = 0.0
    for thing, cost in zip(things, costs, strict=True):
        if piece and seconds + cost > most_s:
            yield piece
            piece, seconds = [], 0.0
        piece.append(thing)
        seconds += cost
    if piece:
        yield piece


def answers(client: Any, given: Iterable[list[T]], submit: Callable[[list[T]], Any]) -> Iterator[Any | Lost[T]]:
    """The answers as they come: of a piece what its task gives, of a thing that cannot be worked on `Lost`.

    `submit` gives a piece to the cluster and returns its future. What waits for a process that dies counts as given to
    it, so that the last attempt with a thing is made when nothing else is given out. Raises a `HighsideError` of a task
    (its results cannot be written or read: no fault of what it worked on).
    """
    from distributed import as_completed

    out = {submit(piece): (piece, 1) for piece in given}
    last: list[list[T]] = []
    pending = as_completed(list(out))

    def give(piece: list[T], attempt: int) -> None:
        future = submit(piece)
        out[future] = (piece, attempt)
        pending.add(future)

    for future in pending:
        piece, attempt = out.pop(future)
        answer, error = _answer_of(future)
        if answer is not None:
            yield answer
        elif len(piece) > 1:
            for one in piece:
                give([one], 1)
        elif attempt >= TASKS.attempts:
            yield Lost(piece[0], error)
        elif attempt + 1 == TASKS.attempts:
            last.append(piece)
        else:
            give(piece, attempt + 1)
        if last and not out:
            give(last.pop(0), TASKS.attempts)
        future.release()


def _answer_of(future: Any) -> tuple[Any, BaseException | None]:
    """What a task gave, None where it gave nothing, and its error: an answer may be lost with its process before it is
    fetched, and the task with the next."""
    if future.status == "cancelled":
        return None, None
    try:
        return future.result(), None
    except HighsideError:
        raise
    except Exception as error:
        return None, error
