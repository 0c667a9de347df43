"""The log of a process: to stderr, one line an event, and nothing in it that a terminal would obey."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable
from contextvars import ContextVar

from highside.printable import one_line, printable

SHORT = 300
"""Characters of a line that a library writes about a stranger; what he sent may be longer."""
QUIET_S = 60.0
"""Between two lines of one such library: a stranger who sends nonsense must not fill the disk or the screen."""


TOOL: ContextVar[str] = ContextVar("tool", default="")
"""Where a process has several tools: whose line it is."""


class PlainFormatter(logging.Formatter):
    """Every message one printable line; a traceback keeps its lines, each printable."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name of logging
        tool = TOOL.get()
        if tool:
            record.message = f"{tool}: {record.message}"
        return printable(super().formatMessage(record))

    def formatException(self, ei: object) -> str:  # noqa: N802 - the name of logging
        return _each_line(super().formatException(ei))  # type: ignore[arg-type]

    def formatStack(self, stack_info: str) -> str:  # noqa: N802 - the name of logging
        return _each_line(super().formatStack(stack_info))


class JournalFormatter(PlainFormatter):
    """Prefixes each line with its syslog priority (sd-daemon(3))."""

    def format(self, record: logging.LogRecord) -> str:
        priority = 3 if record.levelno >= logging.ERROR else 4 if record.levelno >= logging.WARNING else 6
        return f"<{priority}>{super().format(record)}"


def start_logging(level: str) -> None:
    """Log to stderr; under systemd with the priority prefix that journald understands. What libraries warn of goes the
    same way."""
    handler = logging.StreamHandler(sys.stderr)
    if os.environ.get("JOURNAL_STREAM"):
        handler.setFormatter(JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(PlainFormatter("%(asctime)s %(levelname)-7s %(message)s"))
    ours = logging.getLogger("highside")
    ours.setLevel(level.upper())
    for logger in (ours, logging.getLogger()):
        logger.handlers[:] = [handler]
    ours.propagate = False


class OneAMinute(logging.Filter):
    """Lets one record through a minute, short and without its traceback, and says how many were held back."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._next_s = -1e9
        self._held = 0

    def filter(self, record: logging.LogRecord) -> bool:
        now = self._clock()
        if now < self._next_s:
            self._held += 1
            return False
        text = one_line(record.getMessage())
        if record.exc_info and record.exc_info[1] is not None:
            text = f"{text}: {type(record.exc_info[1]).__name__}: {one_line(str(record.exc_info[1]))}"
        more = f" (and {self._held} more)" if self._held else ""
        record.msg, record.args = f"{text[:SHORT]}{more}", None
        record.exc_info = record.exc_text = record.stack_info = None
        self._next_s, self._held = now + QUIET_S, 0
        return True


def keep_short(*names: str) -> None:
    """The loggers of libraries that speak with strangers: one short line a minute each, by our own formatter.

    With HIGHSIDE_DEBUG set all they say, tracebacks too.
    """
    for name in names:
        logger = logging.getLogger(name)
        logger.handlers[:] = []
        logger.propagate = True
        logger.filters[:] = [] if os.environ.get("HIGHSIDE_DEBUG") else [OneAMinute()]


def _each_line(text: str) -> str:
    return "\n".join(printable(line) for line in text.splitlines())
