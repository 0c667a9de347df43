"""Imports without searches for cycles of objects in between."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["loading", "own_process"]

_own = False
"""whether this process has begun as the command"""


def own_process() -> None:
    """To be called where the process begins as the command: what is loaded stays until its end."""
    global _own
    _own = True


@contextmanager
def loading() -> Iterator[None]:
    """Within it modules are imported that stay until the end.

    Python looks for cycles that nothing refers to each time that so many objects were made, more than a hundred times
    while a thousand modules are loaded, and finds next to none: a seventh of the time of a short command. What was
    loaded is not looked at afterwards either. In the work itself the search goes on as ever, since there the arrays of
    a long recording may hang on a cycle. In a process that others began (a test, a notebook) all is as they have it.
    """
    if not _own or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
