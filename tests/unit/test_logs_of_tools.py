"""Where a process has several tools each line of the log says whose it is, whatever thread writes it."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from contextvars import copy_context
from io import StringIO
from pathlib import Path

import pytest

from highside.config.recorder import RecorderSettings
from highside.link.base import Chunk
from highside.service.logs import TOOL, PlainFormatter
from highside.service.outbox import Outbox
from highside.service.recorder import Recorder


@pytest.fixture
def lines() -> Iterator[StringIO]:
    """What the daemon's own log would show."""
    written = StringIO()
    handler = logging.StreamHandler(written)
    handler.setFormatter(PlainFormatter("%(levelname)s %(message)s"))
    log = logging.getLogger("highside")
    log.addHandler(handler)
    yield written
    log.removeHandler(handler)


def until(what: Callable[[], bool], timeout_s: float = 20.0) -> None:
    end = time.monotonic() + timeout_s
    while not what():
        assert time.monotonic() < end
        time.sleep(0.005)


def as_tool(name: str, work: Callable[[], None]) -> None:
    """As in the task of one tool's service."""

    def in_context() -> None:
        TOOL.set(name)
        work()

    copy_context().run(in_context)


def test_what_the_threads_of_a_tool_write_names_it(tmp_path: Path, lines: StringIO) -> None:
    def spoilt_outbox() -> None:
        outbox = Outbox(tmp_path / "outbox.sqlite", max_rows=100, max_age_s=1e6, max_bytes=1 << 20)
        outbox.start()
        # a name that no file can hold
        outbox.put("a\ud800b", b"{}", created_s=time.time())
        until(lambda: not outbox.stats.storage_ok)
        outbox.stop(10.0)

    def recorder_without_a_folder() -> None:
        (tmp_path / "recordings").write_text("in the way")
        recorder = Recorder(RecorderSettings(), tmp_path / "recordings", "rig-8")
        recorder.start()
        recorder.on_batch(Chunk(1.0, 2.0, b"12"))
        until(lambda: recorder.stats.reason is not None)
        recorder.stop(10.0)

    as_tool("rig-7", spoilt_outbox)
    as_tool("rig-8", recorder_without_a_folder)
    written = lines.getvalue().splitlines()
    of_outbox = [line for line in written if "outbox: " in line]
    of_recorder = [line for line in written if "record" in line]
    assert of_outbox
    assert of_recorder
    assert all(re.match(r"[A-Z]+ rig-7: ", line) for line in of_outbox), of_outbox
    assert all(re.match(r"[A-Z]+ rig-8: ", line) for line in of_recorder), of_recorder
