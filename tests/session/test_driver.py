"""What the faces of a session are given by the driver, where the session itself does not move."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from highside.bench.driver import BenchDriver
from highside.bench.session.snapshot import Command, CommandName
from highside.codec.frame import Frame
from highside.config.bench import load_bench
from highside.errors import InputError
from highside.link.base import LinkReason, LinkState

FILE = """
[tool]
id = "tool-7"
[simulated]
speed = 1.0
[plan]
kind = "joint"
poses = 16
[bench]
name = "simulated bench"
[store]
directory = "calibrations"
sessions = "sessions"
"""


@pytest.fixture
def driver(tmp_path: Path) -> BenchDriver:
    (tmp_path / "bench.toml").write_text(FILE)
    return BenchDriver.begin(load_bench(tmp_path / "bench.toml"), operator="A. Operator")


def lying_still(driver: BenchDriver) -> None:
    frames = [Frame(k, k / 100, time.monotonic(), 0.5, 0.5, 0.7071) for k in range(200)]
    driver.session.readings(frames, time.monotonic())


def test_a_link_that_is_lost_shows_at_once_in_a_session_that_does_not_move(driver: BenchDriver) -> None:
    """Not begun, and looked at after the last reading: the numbers stood for a second more."""
    lying_still(driver)
    before = driver.snapshot()
    assert before.attitude is not None and not before.faults
    driver.on_state(LinkState.DOWN, LinkReason.END_OF_FILE, "ttyUSB0 is gone")
    after = driver.snapshot()
    assert after.seq > before.seq, "who looks again sees that it is another"
    assert after.attitude is None and [fault.code for fault in after.faults] == ["link_down"]


def test_a_reply_is_as_young_as_what_is_shown_after_it(driver: BenchDriver) -> None:
    """`seq` of both counts the same changes."""
    driver.on_state(LinkState.DOWN, LinkReason.END_OF_FILE, "ttyUSB0 is gone")
    shown = driver.snapshot().seq
    reply = asyncio.run(driver.command(Command(name=CommandName.START, request_id="1", operator="A. Operator")))
    assert reply.accepted and shown < reply.seq <= driver.snapshot().seq


def test_a_session_that_somebody_is_at_is_named_where_nothing_can_be_gone_on_with(
    driver: BenchDriver, tmp_path: Path
) -> None:
    """`--resume` beside it said that there is no session."""
    name = Path(driver.journal_path or "").name
    with pytest.raises(InputError, match=f"{name}.*: another process drives this session; end that one first"):
        BenchDriver.go_on(load_bench(tmp_path / "bench.toml"))
