"""SIGKILL of a sending process at 30 random points: the outbox stays whole and loses one commit interval at most.

A third of the runs have no broker, so that rows wait in the file. Committed is what the file knows after the kill; it
must all arrive in the end, and a number that was handed to the broker must never come back with another content.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path

import pytest
from broker import Mosquitto, Subscriber, free_port

KILLS = 30
RATE_HZ = 300.0
COMMIT_INTERVAL_S = 0.05
SLACK_S = 0.25
"""For the commit in progress: an fsync on a busy machine, and the thread's turn."""
TOPIC = "highside/victim/attitude"


class Nursery:
    """The forking helper; reads what the present child says in a thread, so that its pipe never fills."""

    def __init__(self, path: Path) -> None:
        program = Path(__file__).with_name("outbox_child.py")
        self._process = subprocess.Popen(
            [sys.executable, str(program), str(path), str(RATE_HZ), str(COMMIT_INTERVAL_S)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.lines: list[bytes] = []
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self.lines.append(line)
                self._news.notify_all()

    def run(self, run: int, port: int) -> None:
        assert self._process.stdin is not None
        self.lines.clear()
        self._process.stdin.write(b"%d %d\n" % (run, port))
        self._process.stdin.flush()

    def wait_for(self, word: bytes, timeout_s: float = 60.0) -> bytes:
        with self._news:
            found = self._news.wait_for(lambda: [ln for ln in self.lines if ln.startswith(word)], timeout_s)
        assert found, (word, self.lines[-5:])
        return found[0]

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)


def committed(path: Path) -> tuple[int, dict[int, int]]:
    """The last number committed, and seq -> run of the rows that wait; the file is checked on the way."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        assert db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        (last,) = db.execute("SELECT last FROM sequence WHERE topic = ?", (TOPIC,)).fetchone() or (-1,)
        rows = {seq: json.loads(payload)["run"] for seq, payload in db.execute("SELECT seq, payload FROM outbox")}
    return last, rows


@pytest.mark.slow
async def test_a_kill_costs_one_commit_interval_at_most_and_nothing_that_was_committed(tmp_path: Path) -> None:
    rng = random.Random(20261121)
    path = tmp_path / "outbox.sqlite"
    nowhere = free_port()
    expected: dict[int, int] = {}
    tails: list[int] = []
    oldest_lost_s = 0.0
    with Mosquitto(tmp_path / "broker") as mosquitto:
        watcher = Subscriber(mosquitto.port, "highside/victim")
        async with watcher.running():
            nursery = await asyncio.to_thread(Nursery, path)
            before = -1
            for run in range(KILLS):
                nursery.run(run, nowhere if run % 3 == 1 else mosquitto.port)
                pid = int((await asyncio.to_thread(nursery.wait_for, b"ready")).split()[1])
                await asyncio.sleep(rng.uniform(0.005, 0.5))
                killed = time.monotonic()
                os.kill(pid, signal.SIGKILL)
                await asyncio.to_thread(nursery.wait_for, b"gone")
                last, waiting = committed(path)
                puts = [line.split() for line in nursery.lines if line[:1].isdigit()]
                times = {int(seq): float(t) for seq, t in puts}
                if times:
                    assert min(times) == before + 1, "the numbering goes on after the last that was committed"
                lost = [seq for seq in times if seq > last]
                tails.append(len(lost))
                if lost:
                    oldest_lost_s = max(oldest_lost_s, killed - times[min(lost)])
                for seq in range(before + 1, last + 1):
                    expected[seq] = run
                assert all(expected[seq] == owner for seq, owner in waiting.items())
                before = last
            nursery.run(-1, mosquitto.port)
            done = await asyncio.to_thread(nursery.wait_for, b"drained")
            assert done.split()[1] == b"0"
            await watcher.wait_for(lambda: {m["seq"] for _, m in watcher.messages} >= set(expected), 20.0)
            nursery.close()
    contents = defaultdict(set)
    for _, message in watcher.messages:
        contents[message["seq"]].add(message["run"])
    print(
        f"{KILLS} kills, {len(expected)} committed and delivered, lost tail {tails} rows,"
        f" the oldest of them put {oldest_lost_s * 1e3:.0f} ms before the kill"
    )
    assert len(expected) > 500
    assert sorted(contents) == list(range(len(expected))), "every number once, without a gap"
    assert {seq: runs for seq, runs in contents.items() if runs != {expected[seq]}} == {}
    assert oldest_lost_s <= COMMIT_INTERVAL_S + SLACK_S
